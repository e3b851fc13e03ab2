"""The machine that runs recorded formulas (`expressions.instructions`) on a row of samples.

Written for a compiler (`_machine_code`). Loops over a row have no calls and no branches where that
can be had, so that several samples are taken at once: a library's tangent takes five times as
long.
"""

from __future__ import annotations

import math

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
SATURATED = 40.0
"""Twice an angle beyond which its hyperbolic tangent is 1."""
PER_LOG = 1.0 / math.log(2.0)
# log 2 = first + second; the first part has 30 bits.
LOG_FIRST, LOG_SECOND = 744261118 * 2.0**-30, -4.2009150726810846e-11
TWOS, FEW = 2.0 ** np.arange(64), 63
"""Powers of two, and a mask that keeps any number among them."""


def executed(instructions: Array, first: int, last: int, register: Array, size: int) -> None:
    """Run instructions on a row of samples."""
    spare = len(register) - 1
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
        elif operation == SINE_COSINE:
            _sines(register, a, t, c, size)
        elif operation == SINE:
            _sines(register, a, t, spare, size)
        elif operation == COSINE:
            _sines(register, a, spare, t, size)
        elif operation == TANH:
            _tangents(register, a, t, size)
        elif operation == ABS:
            for w in range(size):
                register[t, w] = abs(register[a, w])
        elif operation == SIGN:
            for w in range(size):
                register[t, w] = np.sign(register[a, w])
        elif operation == POWER:
            _powers(register, a, b, t, size)
        elif operation == MAXIMUM:
            for w in range(size):
                register[t, w] = np.maximum(register[a, w], register[b, w])
        elif operation == MINIMUM:
            for w in range(size):
                register[t, w] = np.minimum(register[a, w], register[b, w])
        elif operation == LESS:
            for w in range(size):
                register[t, w] = 1.0 if register[a, w] < register[b, w] else 0.0
        elif operation == LESS_EQUAL:
            for w in range(size):
                register[t, w] = 1.0 if register[a, w] <= register[b, w] else 0.0
        elif operation == GREATER:
            for w in range(size):
                register[t, w] = 1.0 if register[a, w] > register[b, w] else 0.0
        elif operation == GREATER_EQUAL:
            for w in range(size):
                register[t, w] = 1.0 if register[a, w] >= register[b, w] else 0.0
        elif operation == SQRT:
            for w in range(size):
                register[t, w] = np.sqrt(register[a, w])
        else:
            _rarer(operation, register, (a, b, t), size)


def _sines(register: Array, a: int, sine: int, cosine: int, size: int) -> None:
    """Fill in sines and cosines, as `sines.sine_and_cosine`."""
    large = 0
    for w in range(size):
        large += 0 if abs(register[a, w]) < LARGEST else 1
    if large:
        for w in range(size):
            angle = register[a, w]
            register[sine, w], register[cosine, w] = math.sin(angle), math.cos(angle)
        return
    for w in range(size):
        turn = np.rint(register[a, w] * PER_STEP)
        d = turn * -FIRST + register[a, w] - turn * SECOND
        square = d * d
        first = ((square * (1.0 / 120.0) - 1.0 / 6.0) * square) * d + d
        second = (square * (1.0 / 24.0) - 0.5) * square
        at = np.int64(turn) & MASK
        s, o = SINES[at], COSINES[at]
        register[sine, w] = o * first + s * second + s
        register[cosine, w] = second * o - first * s + o


def _tangents(register: Array, a: int, t: int, size: int) -> None:
    r"""Fill in hyperbolic tangents, within two units of the last place.

    With :math:`2|x| = n \log 2 + d` and :math:`|d| \le \log(2)/2`,

    .. math:: e = 2^n (\exp d - 1) + 2^n - 1, \quad \tanh |x| = e/(e + 2),

    where exp(d) - 1 is the begin of its series.
    """
    for w in range(size):
        twice = 2.0 * abs(register[a, w])
        twice = SATURATED if twice > SATURATED else twice
        turn = np.rint(twice * PER_LOG)
        d = turn * -LOG_FIRST + twice - turn * LOG_SECOND
        series = 1.0 / 479001600.0 + d * (1.0 / 6227020800.0)
        series = 1.0 / 39916800.0 + d * series
        series = 1.0 / 3628800.0 + d * series
        series = 1.0 / 362880.0 + d * series
        series = 1.0 / 40320.0 + d * series
        series = 1.0 / 5040.0 + d * series
        series = 1.0 / 720.0 + d * series
        series = 1.0 / 120.0 + d * series
        series = 1.0 / 24.0 + d * series
        series = 1.0 / 6.0 + d * series
        series = 0.5 + d * series
        power = TWOS[np.int64(turn) & FEW]
        e = power * (d + d * d * series) + (power - 1.0)
        register[t, w] = np.copysign(e / (e + 2.0), register[a, w])


def _powers(register: Array, a: int, b: int, t: int, size: int) -> None:
    """Fill in powers; whole ones that all samples have are products."""
    exponent, other = register[b, 0], 0
    for w in range(size):
        other += 0 if register[b, w] == exponent else 1
    if other == 0 and exponent == 1.0:
        for w in range(size):
            register[t, w] = register[a, w]
    elif other == 0 and exponent == 2.0:
        for w in range(size):
            register[t, w] = register[a, w] * register[a, w]
    elif other == 0 and exponent == 3.0:
        for w in range(size):
            register[t, w] = register[a, w] * register[a, w] * register[a, w]
    else:
        for w in range(size):
            register[t, w] = register[a, w] ** register[b, w]


def _rarer(operation: int, register: Array, at: tuple[int, int, int], size: int) -> None:
    """Run an instruction that is rare, or dear in itself: a branch each sample."""
    a, b, t = at
    for w in range(size):
        x, y = register[a, w], register[b, w]
        if operation == POWER_VALUE:
            z = x**y
        elif operation == POWER_SLOPE:
            z = y * x ** (y - 1.0)
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
        elif operation == EXP:
            z = math.exp(x)
        elif operation == LOG:
            z = np.log(x)
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
