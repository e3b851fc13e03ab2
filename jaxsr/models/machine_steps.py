"""Explicit Runge-Kutta steps of recorded formulas, with their derivatives, sample by sample.

Written for a compiler (`_machine_code`). Samples are taken a row at a time, few enough to stay in a
processor's cache from the first stage of a step to its derivatives; NumPy would send every
operation of every stage through memory. Calls for different samples may run side by side.
"""

from __future__ import annotations

import numpy as np

from jaxsr.models.machine_tables import Code, Course
from jaxsr.models.register_machine import executed

Array = np.ndarray
SHARES = np.array([0.0, 0.5, 0.5, 1.0])
WEIGHTS = np.array([1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0])


def rk4_steps(
    code: Code,
    fixed: Array,
    course: Course,
    states: Array,
    slopes: Array,
    width: int,
    chosen: tuple[int, int],
) -> None:
    r"""Fill the states after every part, and their derivatives, by the classical method.

    States are followed forwards by the first of two programs. Backwards, with J_s and P_s the
    derivatives of the rate of stage s by states and parameters (the second program),

    .. math:: V_s = h b_s F + h a_{s+1,s} V_{s+1} J_{s+1}, \quad
        F \leftarrow F + \sum_s V_s J_s, \quad G \leftarrow G + \sum_s V_s P_s

    are the derivatives F of the end by the states before a part, and G by the parameters.

    Parameters
    ----------
    code : Code
    fixed : ndarray, shape (values, samples or 1)
    course : Course
    states : ndarray, shape (parts + 1, states, samples)
        The first are given, the others filled.
    slopes : ndarray, shape (states, states + parameters, samples)
        Filled; of no samples where none are asked for.
    width : int
        Samples of a row.
    chosen : tuple of int
        The first sample to take, and the one behind the last.
    """
    instructions, bounds = code.instructions, code.bounds
    by_state, by_parameter = code.by_state, code.by_parameter
    steps, (start, stop) = len(course.of), chosen
    n, tangents = states.shape[1], slopes.shape[2] > 0
    entries, columns, count = len(by_state), len(by_parameter), slopes.shape[1]
    register = np.empty((len(code.preset) + 1, width))  # the last row is nobody's
    rate = np.empty((4, n, width))
    kept = np.empty((4, entries + columns, width))
    whole, total = np.empty((n, n, width)), np.empty((n, n, width))
    moved, pull = np.empty((n, n, width)), np.empty((n, n, width))
    by = np.empty((n, count - n if tangents else 0, width))
    length, along = np.empty(width), np.empty((3, width))
    once = tangents and steps == 1  # forwards and backwards are one evaluation
    forwards = 0 if once else 1 + 4 * steps
    rounds = forwards + (1 + 4 * steps if tangents else 0)
    for left in range(start, stop, width):
        size = min(width, stop - left)
        _begun(code, fixed, register, left, size)
        whole[:], by[:] = 0.0, 0.0
        for i in range(n):
            whole[i, i] = 1.0
        for number in range(rounds):
            program = 0 if number < forwards else 1
            place_in = number - 1 if program == 0 else number - forwards - 1
            if place_in < 0:
                first, last = bounds[2 * program], bounds[2 * program + 1]
                executed(instructions, first, last, register, size)
                continue
            first, last = bounds[2 * program + 1], bounds[2 * program + 2]
            step, stage = place_in // 4, place_in % 4
            if program == 1:
                step = steps - 1 - step
            at = program, step, stage
            _led_to(code, course, at, states, rate, register, length, along, left, size)
            executed(instructions, first, last, register, size)
            for i in range(n):
                source = code.rates_at[program, i]
                for w in range(size):
                    rate[stage, i, w] = register[source, w]
            if stage == 3 and (program == 0 or once):
                for i in range(n):
                    for w in range(size):
                        h = length[w]
                        states[step + 1, i, left + w] = (
                            states[step, i, left + w]
                            + h / 6.0 * rate[0, i, w]
                            + h / 3.0 * rate[1, i, w]
                            + h / 3.0 * rate[2, i, w]
                            + h / 6.0 * rate[3, i, w]
                        )
            if program == 0:
                continue
            _kept(code, course, step, register, along, kept[stage], left, size)
            if stage == 3:
                _carried(code, length, kept, whole, total, moved, pull, by, size)
        if tangents:
            for i in range(n):
                for j in range(n):
                    for w in range(size):
                        slopes[i, j, left + w] = whole[i, j, w]
                for j in range(n, count):
                    for w in range(size):
                        slopes[i, j, left + w] = by[i, j - n, w]


def _begun(code: Code, fixed: Array, register: Array, left: int, size: int) -> None:
    """Write what no step changes into the registers of a row."""
    for r in range(len(code.preset)):
        for w in range(size):
            register[r, w] = code.preset[r]
    for f in range(len(code.fixed_at)):
        target = code.fixed_at[f]
        if fixed.shape[1] == 1:
            for w in range(size):
                register[target, w] = fixed[f, 0]
        else:
            for w in range(size):
                register[target, w] = fixed[f, left + w]


def _led_to(
    code: Code,
    course: Course,
    at: tuple[int, int, int],
    states: Array,
    rate: Array,
    register: Array,
    length: Array,
    along: Array,
    left: int,
    size: int,
) -> None:
    """Write time, inputs and states of a stage of a part into the registers of a program.

    `length` and `along` are filled: the part's length, and the shares of what comes from outside at
    the begin, the middle and the end of its step.
    """
    program, step, stage = at
    out, half = course.of[step], SHARES[stage]
    for w in range(size):
        begin, end = course.shares[0, step, left + w], course.shares[1, step, left + w]
        x = begin + half * (end - begin)
        y = 1.0 - x
        length[w] = (end - begin) * course.times[1, out, left + w]
        # The parabola through the begin, the middle and the end of the step.
        along[0, w], along[1, w], along[2, w] = y * (y - x), 4.0 * x * y, x * (x - y)
    clock = code.time_at[program, 0]
    if clock >= 0:
        for w in range(size):
            begin, end = course.shares[0, step, left + w], course.shares[1, step, left + w]
            h = course.times[1, out, left + w]
            register[clock, w] = course.times[0, out, left + w] + (begin + half * (end - begin)) * h
    inputs = course.inputs
    for i in range(inputs.shape[1]):
        target = code.inputs_at[program, i]
        if target >= 0:
            for w in range(size):
                register[target, w] = (
                    along[0, w] * inputs[0, i, out, left + w]
                    + along[1, w] * inputs[1, i, out, left + w]
                    + along[2, w] * inputs[2, i, out, left + w]
                )
    for i in range(states.shape[1]):
        target = code.states_at[program, i]
        if target < 0:
            continue
        if stage == 0:
            for w in range(size):
                register[target, w] = states[step, i, left + w]
        else:
            for w in range(size):
                register[target, w] = (
                    states[step, i, left + w] + half * length[w] * rate[stage - 1, i, w]
                )


def _kept(
    code: Code,
    course: Course,
    step: int,
    register: Array,
    along: Array,
    kept: Array,
    left: int,
    size: int,
) -> None:
    """Keep the derivatives of a stage's rates."""
    entries, out, rates = len(code.by_state), course.of[step], course.input_rates
    for e in range(entries):
        source = code.by_state[e, 2]
        for w in range(size):
            kept[e, w] = register[source, w]
    for e in range(len(code.by_parameter)):
        source, delay = code.by_parameter[e, 2], code.by_parameter[e, 3]
        for w in range(size):
            kept[entries + e, w] = register[source, w]
        if delay >= 0:
            for w in range(size):
                kept[entries + e, w] *= (
                    along[0, w] * rates[0, delay, out, left + w]
                    + along[1, w] * rates[1, delay, out, left + w]
                    + along[2, w] * rates[2, delay, out, left + w]
                )


def _carried(
    code: Code,
    length: Array,
    kept: Array,
    whole: Array,
    total: Array,
    moved: Array,
    pull: Array,
    by: Array,
    size: int,
) -> None:
    """Carry the derivatives of the end back over a part: F is `whole`, G is `by`."""
    n, entries = len(whole), len(code.by_state)
    for back in range(4):
        s = 3 - back
        for i in range(n):
            for j in range(n):
                if s == 3:
                    for w in range(size):
                        pull[i, j, w] = length[w] * WEIGHTS[s] * whole[i, j, w]
                        total[i, j, w], moved[i, j, w] = whole[i, j, w], 0.0
                else:
                    for w in range(size):
                        h, own = length[w], moved[i, j, w]
                        pull[i, j, w] = h * WEIGHTS[s] * whole[i, j, w] + h * SHARES[s + 1] * own
                        total[i, j, w] += own
                        moved[i, j, w] = 0.0
        for e in range(entries):
            of, to = code.by_state[e, 0], code.by_state[e, 1]
            for i in range(n):
                for w in range(size):
                    moved[i, to, w] += pull[i, of, w] * kept[s, e, w]
        for e in range(len(code.by_parameter)):
            of, to = code.by_parameter[e, 0], code.by_parameter[e, 1]
            for i in range(n):
                for w in range(size):
                    by[i, to, w] += pull[i, of, w] * kept[s, entries + e, w]
    for i in range(n):
        for j in range(n):
            for w in range(size):
                whole[i, j, w] = total[i, j, w] + moved[i, j, w]
