"""Explicit Runge-Kutta steps of recorded formulas, with their derivatives, sample by sample.

Written for a compiler (`_machine_code`). Samples are taken a row at a time, few enough to stay in a
processor's cache from the first stage of a step to its derivatives; NumPy would send every
operation of every stage through memory. Calls for different samples may run side by side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from jaxsr.expressions.instructions import CODE
from jaxsr.expressions.sines import COSINES, FIRST, LARGEST, PER_STEP, SECOND, SINES, STEPS

Array = np.ndarray
(
    ADD, SUB, MUL, DIV, NEG, WHERE, SINE_COSINE, SINE, COSINE, TANH, ABS, SIGN, POWER, POWER_VALUE,
    POWER_SLOPE, LESS, LESS_EQUAL, GREATER, GREATER_EQUAL, EQUAL, NOT_EQUAL, AND, OR, NOT, MAXIMUM,
    MINIMUM, EXP, LOG, SQRT, TAN, SINH, COSH, ASIN, ACOS, ATAN, ATAN2, FLOOR, STEP,
) = range(len(CODE))  # fmt: skip
MASK = STEPS - 1


class Code(NamedTuple):
    """Two programs: rates, and rates with their derivatives.

    Attributes
    ----------
    instructions : ndarray of int, shape (instructions, 5)
        Of `expressions.instructions`: what of either program is calculated once, and what at every
        stage.
    bounds : ndarray of int, shape (5,)
        Where these four parts begin and end.
    preset : ndarray, shape (registers,)
    fixed_at : ndarray of int, shape (values,)
        Registers of constants.
    time_at, states_at, inputs_at : ndarray of int, shape (2, names)
        Registers in either program; -1 where a name does not occur.
    rates_at : ndarray of int, shape (2, states)
    by_state : ndarray of int, shape (entries, 3)
        State whose rate it is of, state it is by, register: the entries of J.
    by_parameter : ndarray of int, shape (entries, 4)
        State whose rate it is of, parameter it is by, register, and the row of
        `Course.input_rates` that it is to be multiplied by, or -1: the entries of P.
    """

    instructions: Array
    bounds: Array
    preset: Array
    fixed_at: Array
    time_at: Array
    states_at: Array
    inputs_at: Array
    rates_at: Array
    by_state: Array
    by_parameter: Array


class Course(NamedTuple):
    """Parts of steps, one after the other, and what comes from outside.

    Attributes
    ----------
    of : ndarray of int, shape (parts,)
        The step that each is a part of.
    times : ndarray, shape (2, steps, samples)
        Begin and length of a step.
    shares : ndarray, shape (2, parts, samples)
        Of it, at which a part begins and ends.
    inputs : ndarray, shape (3, inputs, steps, samples)
        At its begin, its middle and its end.
    input_rates : ndarray, shape (3, delays, steps, samples)
        The same of the derivatives of inputs by their delays.
    """

    of: Array
    times: Array
    shares: Array
    inputs: Array
    input_rates: Array


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
    instructions, bounds, preset, fixed_at, time_at, states_at, inputs_at = code[:7]
    rates_at, by_state, by_parameter = code[7:]
    whole_of, times, shares, inputs, input_rates = course
    steps, (start, stop) = len(whole_of), chosen
    n, m, tangents = states.shape[1], inputs.shape[1], slopes.shape[2] > 0
    entries, columns, count = len(by_state), len(by_parameter), slopes.shape[1]
    register = np.empty((len(preset), width))
    rate = np.empty((4, n, width))
    kept = np.empty((4, entries + columns, width))
    whole, total = np.empty((n, n, width)), np.empty((n, n, width))
    moved, pull = np.empty((n, n, width)), np.empty((n, n, width))
    by = np.empty((n, count - n if tangents else 0, width))
    half = np.array([0.0, 0.5, 0.5, 1.0])
    length, along = np.empty(width), np.empty((3, width))
    weight = np.array([1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0])
    once = tangents and steps == 1  # forwards and backwards are one evaluation
    forwards = 0 if once else 1 + 4 * steps
    rounds = forwards + (1 + 4 * steps if tangents else 0)
    for left in range(start, stop, width):
        size = min(width, stop - left)
        for r in range(len(preset)):
            for w in range(size):
                register[r, w] = preset[r]
        for f in range(len(fixed_at)):
            if fixed.shape[1] == 1:
                for w in range(size):
                    register[fixed_at[f], w] = fixed[f, 0]
            else:
                for w in range(size):
                    register[fixed_at[f], w] = fixed[f, left + w]
        for i in range(n):
            for j in range(n):
                for w in range(size):
                    whole[i, j, w] = 1.0 if i == j else 0.0
        for i in range(by.shape[0]):
            for j in range(by.shape[1]):
                for w in range(size):
                    by[i, j, w] = 0.0
        for number in range(rounds):
            program = 0 if number < forwards else 1
            place_in = number - 1 if program == 0 else number - forwards - 1
            first, last = bounds[2 * program], bounds[2 * program + 1]
            step, stage, out = 0, 0, 0
            if place_in >= 0:
                first, last = last, bounds[2 * program + 2]
                step, stage = place_in // 4, place_in % 4
                if program == 1:
                    step = steps - 1 - step
                out = whole_of[step]
                for w in range(size):
                    begin, end = shares[0, step, left + w], shares[1, step, left + w]
                    x = begin + half[stage] * (end - begin)
                    y, h = 1.0 - x, times[1, out, left + w]
                    length[w] = (end - begin) * h
                    # The parabola through the begin, the middle and the end of the step.
                    along[0, w], along[1, w], along[2, w] = y * (y - x), 4.0 * x * y, x * (x - y)
                    if time_at[program, 0] >= 0:
                        register[time_at[program, 0], w] = times[0, out, left + w] + x * h
                for i in range(m):
                    if inputs_at[program, i] >= 0:
                        for w in range(size):
                            register[inputs_at[program, i], w] = (
                                along[0, w] * inputs[0, i, out, left + w]
                                + along[1, w] * inputs[1, i, out, left + w]
                                + along[2, w] * inputs[2, i, out, left + w]
                            )
                for i in range(n):
                    if states_at[program, i] < 0:
                        continue
                    if stage == 0:
                        for w in range(size):
                            register[states_at[program, i], w] = states[step, i, left + w]
                    else:
                        for w in range(size):
                            register[states_at[program, i], w] = (
                                states[step, i, left + w]
                                + half[stage] * length[w] * rate[stage - 1, i, w]
                            )
            for k in range(first, last):
                operation, t = instructions[k, 0], instructions[k, 1]
                a, b, c = instructions[k, 2], instructions[k, 3], instructions[k, 4]
                if operation == ADD:
                    for w in range(size):
                        register[t, w] = register[a, w] + register[b, w]
                elif operation == SUB:
                    for w in range(size):
                        register[t, w] = register[a, w] - register[b, w]
                elif operation == MUL:
                    for w in range(size):
                        register[t, w] = register[a, w] * register[b, w]
                elif operation == DIV:
                    for w in range(size):
                        register[t, w] = register[a, w] / register[b, w]
                elif operation == NEG:
                    for w in range(size):
                        register[t, w] = -register[a, w]
                elif operation == WHERE:
                    for w in range(size):
                        register[t, w] = register[b, w] if register[a, w] != 0.0 else register[c, w]
                elif operation == SINE_COSINE or operation == SINE or operation == COSINE:
                    for w in range(size):
                        x = register[a, w]
                        if abs(x) < LARGEST:  # as `sines.sine_and_cosine`
                            turn = np.rint(x * PER_STEP)
                            d = turn * -FIRST + x - turn * SECOND
                            square = d * d
                            sine = ((square * (1.0 / 120.0) - 1.0 / 6.0) * square) * d + d
                            cosine = (square * (1.0 / 24.0) - 0.5) * square
                            at = np.int64(turn) & MASK
                            s, o = SINES[at], COSINES[at]
                            x = o * sine + s * cosine + s
                            cosine = cosine * o - sine * s + o
                        else:
                            x, cosine = math.sin(x), math.cos(x)
                        if operation == SINE_COSINE:
                            register[t, w], register[c, w] = x, cosine
                        elif operation == SINE:
                            register[t, w] = x
                        else:
                            register[t, w] = cosine
                elif operation == ABS:
                    for w in range(size):
                        register[t, w] = abs(register[a, w])
                elif operation == SIGN:
                    for w in range(size):
                        register[t, w] = np.sign(register[a, w])
                else:  # rarer, or dear in themselves: a branch each sample
                    for w in range(size):
                        x, y = register[a, w], register[b, w]
                        if operation == TANH:
                            z = math.tanh(x) if abs(x) < 20.0 else np.sign(x)
                        elif operation == POWER:
                            z = x * x if y == 2.0 else x if y == 1.0 else x**y
                        elif operation == POWER_VALUE:
                            z = x**y
                        elif operation == POWER_SLOPE:
                            z = y * x ** (y - 1.0)
                        elif operation == LESS:
                            z = 1.0 if x < y else 0.0
                        elif operation == LESS_EQUAL:
                            z = 1.0 if x <= y else 0.0
                        elif operation == GREATER:
                            z = 1.0 if x > y else 0.0
                        elif operation == GREATER_EQUAL:
                            z = 1.0 if x >= y else 0.0
                        elif operation == EQUAL:
                            z = 1.0 if x == y else 0.0
                        elif operation == NOT_EQUAL:
                            z = 1.0 if x != y else 0.0
                        elif operation == AND:
                            z = 1.0 if x != 0.0 and y != 0.0 else 0.0
                        elif operation == OR:
                            z = 1.0 if x != 0.0 or y != 0.0 else 0.0
                        elif operation == NOT:
                            z = 1.0 if x == 0.0 else 0.0
                        elif operation == MAXIMUM:
                            z = np.maximum(x, y)
                        elif operation == MINIMUM:
                            z = np.minimum(x, y)
                        elif operation == EXP:
                            z = math.exp(x)
                        elif operation == LOG:
                            z = np.log(x)
                        elif operation == SQRT:
                            z = np.sqrt(x)
                        elif operation == TAN:
                            z = math.tan(x)
                        elif operation == SINH:
                            z = math.sinh(x)
                        elif operation == COSH:
                            z = math.cosh(x)
                        elif operation == ASIN:
                            z = np.arcsin(x)
                        elif operation == ACOS:
                            z = np.arccos(x)
                        elif operation == ATAN:
                            z = math.atan(x)
                        elif operation == ATAN2:
                            z = math.atan2(x, y)
                        elif operation == FLOOR:
                            z = np.floor(x)
                        else:  # STEP
                            z = 0.0 if x < 0.0 else 1.0 if x > 0.0 else y if x == 0.0 else x
                        register[t, w] = z
            if place_in < 0:
                continue
            for i in range(n):
                for w in range(size):
                    rate[stage, i, w] = register[rates_at[program, i], w]
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
            for e in range(entries):
                for w in range(size):
                    kept[stage, e, w] = register[by_state[e, 2], w]
            for e in range(columns):
                delay = by_parameter[e, 3]
                for w in range(size):
                    kept[stage, entries + e, w] = register[by_parameter[e, 2], w]
                if delay >= 0:
                    for w in range(size):
                        kept[stage, entries + e, w] *= (
                            along[0, w] * input_rates[0, delay, out, left + w]
                            + along[1, w] * input_rates[1, delay, out, left + w]
                            + along[2, w] * input_rates[2, delay, out, left + w]
                        )
            if stage < 3:
                continue
            for i in range(n):
                for j in range(n):
                    for w in range(size):
                        total[i, j, w] = 0.0
            for back in range(4):
                s = 3 - back
                for i in range(n):
                    for j in range(n):
                        for w in range(size):
                            h = length[w]
                            value = h * weight[s] * whole[i, j, w]
                            if s < 3:
                                value += h * half[s + 1] * moved[i, j, w]
                            pull[i, j, w] = value
                for i in range(n):
                    for j in range(n):
                        for w in range(size):
                            moved[i, j, w] = 0.0
                for e in range(entries):
                    of, to = by_state[e, 0], by_state[e, 1]
                    for i in range(n):
                        for w in range(size):
                            moved[i, to, w] += pull[i, of, w] * kept[s, e, w]
                for e in range(columns):
                    of, to = by_parameter[e, 0], by_parameter[e, 1]
                    for i in range(n):
                        for w in range(size):
                            by[i, to, w] += pull[i, of, w] * kept[s, entries + e, w]
                for i in range(n):
                    for j in range(n):
                        for w in range(size):
                            total[i, j, w] += moved[i, j, w]
            for i in range(n):
                for j in range(n):
                    for w in range(size):
                        whole[i, j, w] += total[i, j, w]
        if tangents:
            for i in range(n):
                for j in range(n):
                    for w in range(size):
                        slopes[i, j, left + w] = whole[i, j, w]
                for j in range(n, count):
                    for w in range(size):
                        slopes[i, j, left + w] = by[i, j - n, w]
