"""Modes and evidences inside bounds, number by number, for several Gram matrices at once.

Written for a compiler (Numba): as Python they are slow. Sets of a few constants cost NumPy its
calls, not its arithmetic. `evidence.Gram.evidence` and `truncated` say the same with arrays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

Array = np.ndarray
NORMAL, TAIL = 1.959964, math.log(0.05)
"""Deviations of a normal distribution about its mean that 95 % of it lie within, and the log of
what is left."""
STEEP, ROUNDING, LEAST = 1e4, 1e-10, 0.5e-12
"""Slope, in the root of the curvature, from which a fall is exponential to any digit; slope at a
bound, in the largest that there is, that is none; least share of a distribution between bounds."""
SCALED = 1e-4
"""Relative step of the scale of the noise that ends its iteration: of N samples, its square times N
is what the log evidence errs by."""


class Beliefs(NamedTuple):
    """Normal priors cut off at bounds: a tuple of arrays to the compiler, shape (constants,)."""

    mean: Array
    deviation: Array
    low: Array
    high: Array


class Modes(NamedTuple):
    """What is filled: a tuple of arrays to the compiler.

    Attributes
    ----------
    log_evidence, noise : ndarray, shape (choices,)
    change, deviation : ndarray, shape (choices, constants)
    failed : ndarray of bool, shape (choices,)
        Where arrays have to find it: digits were lost, or sets of held constants went round.
    """

    log_evidence: Array
    noise: Array
    change: Array
    deviation: Array
    failed: Array


class Bounded(NamedTuple):
    """The density exp(-z'Mz/2 + r'z) inside bounds: a tuple of arrays to the compiler.

    Attributes
    ----------
    matrix, factor : ndarray, shape (constants, constants)
        M, and the Cholesky factor of its rows and columns that are free.
    right, low, high : ndarray, shape (constants,)
    mode : ndarray, shape (constants,)
        Inside the bounds.
    held : ndarray of bool, shape (constants,)
        What is at a bound, because the density is larger beyond.
    free : ndarray of int, shape (constants,)
        The others, first.
    """

    matrix: Array
    factor: Array
    right: Array
    low: Array
    high: Array
    mode: Array
    held: Array
    free: Array

    @staticmethod
    def of(size: int) -> Bounded:
        """Return room for so many constants."""
        matrix, factor = np.empty((2, size, size))
        right, low, high, mode = np.empty((4, size))
        held, free = np.zeros(size, bool), np.zeros(size, np.int64)
        return Bounded(matrix, factor, right, low, high, mode, held, free)


def fill_modes(
    products: Array,
    log_determinant: Array,
    factors: tuple[Array, Array],
    count: int,
    prior: Beliefs,
    steps: int,
    room: Bounded,
    found: Modes,
) -> None:
    """Fill the modes, and log evidences, of one set of constants beside several noises.

    Parameters
    ----------
    products : ndarray, shape (choices, 1 + constants, 1 + constants)
        Overwritten: scaled by the deviations of the prior.
    log_determinant : ndarray, shape (choices,)
    factors : (ndarray, ndarray), shape (choices,)
        Smallest and largest scale of the noise.
    count : int
    prior : Beliefs
        Means and bounds in their deviations.
    steps : int
        Fixed-point steps for the scale of the noise.
    room : Bounded
    found : Modes
    """
    size, mode = len(prior.mean), room.mode
    quietest, loudest = factors
    outside = 0.0  # log share of the prior inside the bounds
    for i in range(size):
        room.low[i], room.high[i] = prior.low[i], prior.high[i]
        outside += log_share(prior.low[i] - prior.mean[i], prior.high[i] - prior.mean[i])
    for choice in range(len(products)):
        whole = products[choice]
        for i in range(size):
            for j in range(1 + size):
                whole[1 + i, j] *= prior.deviation[i]
                whole[j, 1 + i] *= prior.deviation[i]
        noise, left, number = 1.0, np.nan, 0
        for _ in range(steps):
            number = settle(whole, prior.mean, noise, room)
            if number < 0:
                left = np.nan
                break
            left = whole[0, 0]
            for i in range(size):
                along = 2.0 * whole[1 + i, 0]
                for j in range(size):
                    along += whole[1 + i, 1 + j] * mode[j]
                left += along * mode[i]
            if not left > 0.0:
                break
            before, noise = noise, min(max(left / count, quietest[choice]), loudest[choice])
            if abs(noise - before) <= SCALED * noise:
                break
        found.failed[choice] = math.isnan(left)
        if not left > 0.0:  # rounding is all that is left of so large columns: no answer
            found.log_evidence[choice], found.noise[choice] = -np.inf, 1.0
            for i in range(size):
                found.change[choice, i] = prior.mean[i] * prior.deviation[i]
                found.deviation[choice, i] = prior.deviation[i]
            continue
        log = count * math.log(2.0 * math.pi * noise) + log_determinant[choice] + left / noise
        for i in range(size):
            log += (mode[i] - prior.mean[i]) ** 2
        log = spread(room, number, found.deviation[choice]) - 0.5 * log
        found.log_evidence[choice], found.noise[choice] = log - outside, noise
        for i in range(size):
            found.change[choice, i] = mode[i] * prior.deviation[i]
            found.deviation[choice, i] *= prior.deviation[i]


def settle(products: Array, mean: Array, noise: float, room: Bounded) -> int:
    """Fill the mode inside bounds beside some noise, by sets of constants that are held there.

    Returns
    -------
    int
        How many are free; -1 where there is no answer.
    """
    matrix, factor, right, low, high, mode, held, free = room
    size, number = len(mean), 0
    for i in range(size):
        right[i] = mean[i] - products[1 + i, 0] / noise
        for j in range(size):
            matrix[i, j] = products[1 + i, 1 + j] / noise
        matrix[i, i] += 1.0
        held[i], mode[i] = False, 0.0
    for turn in range(2 * size + 1):
        if turn > 0:
            if not hold(low, high, mode, held) and not let_go(room):
                return number
            for i in range(size):
                mode[i] = min(max(mode[i], low[i]), high[i])
        number = 0
        for i in range(size):
            if not held[i]:
                free[number] = i
                number += 1
        if not factored(matrix, free[:number], factor):
            return -1
        for a in range(number):
            i = free[a]
            mode[i] = right[i]
            for j in range(size):
                if held[j]:
                    mode[i] -= matrix[i, j] * mode[j]
        solve(factor, free[:number], mode)
        if turn == 0:
            inside = True
            for i in range(size):
                inside = inside and low[i] <= mode[i] <= high[i]
            if inside:
                return number
            if math.isnan(mode.sum()):
                break
    return -1


def hold(low: Array, high: Array, mode: Array, held: Array) -> bool:
    """Hold what is outside its bounds; whether anything is."""
    outside = False
    for i in range(len(mode)):
        if not held[i] and (mode[i] < low[i] or mode[i] > high[i]):
            held[i] = outside = True
    return outside


def let_go(room: Bounded) -> bool:
    """Let go of what is held and has more density inside, the steepest first; whether any is."""
    matrix, _, right, low, _, mode, held, _ = room
    worst, steepest, largest = -1, 0.0, 0.0
    for i in range(len(mode)):
        slope = -right[i]
        for j in range(len(mode)):
            slope += matrix[i, j] * mode[j]
        largest = max(largest, abs(slope))
        pulled = -slope if mode[i] <= low[i] else slope
        if held[i] and pulled > steepest:
            worst, steepest = i, pulled
    if steepest <= ROUNDING * (1.0 + largest):
        return False
    held[worst] = False
    return True


def factored(matrix: Array, free: Array, factor: Array) -> bool:
    """Fill the Cholesky factor of the rows and columns that are free; false where there is none."""
    for a in range(len(free)):
        for b in range(a + 1):
            total = matrix[free[a], free[b]]
            for k in range(b):
                total -= factor[a, k] * factor[b, k]
            if a > b:
                factor[a, b] = total / factor[b, b]
            elif total > 0.0:
                factor[a, a] = math.sqrt(total)
            else:
                return False
    return True


def solve(factor: Array, free: Array, right: Array) -> None:
    """Solve for the free constants in place: L L' x = r."""
    for a in range(len(free)):
        for k in range(a):
            right[free[a]] -= factor[a, k] * right[free[k]]
        right[free[a]] /= factor[a, a]
    for a in range(len(free) - 1, -1, -1):
        for k in range(a + 1, len(free)):
            right[free[a]] -= factor[k, a] * right[free[k]]
        right[free[a]] /= factor[a, a]


def spread(room: Bounded, number: int, deviation: Array) -> float:
    """Fill deviations about a mode; return the log of the integral inside the bounds.

    As `Truncated.deviation` and `Truncated.log_integral` have them.
    """
    matrix, factor, right, low, high, mode, held, every = room
    size, free, total = len(mode), every[:number], 0.0
    variance = np.zeros(number)
    inverse = np.zeros(number)
    for b in range(number):  # columns of the factor's inverse
        total -= math.log(factor[b, b])
        for a in range(b, number):
            value = 1.0 if a == b else 0.0
            for k in range(b, a):
                value -= factor[a, k] * inverse[k]
            inverse[a] = value / factor[a, a]
            variance[b] += inverse[a] ** 2
        own, i = math.sqrt(variance[b]), int(free[b])
        total += log_share(float((low[i] - mode[i]) / own), float((high[i] - mode[i]) / own))
    following = np.zeros(size)
    for k in range(size):
        if not held[k]:
            continue
        slope = -right[k]
        for j in range(size):
            slope += matrix[k, j] * mode[j]
        slope, curvature = abs(slope), matrix[k, k]
        for a in range(number):
            following[free[a]] = matrix[free[a], k]
        solve(factor, free, following)
        for a in range(number):
            curvature -= matrix[free[a], k] * following[free[a]]
        # At least that of the prior: sums over precise readings cancel up to rounding.
        curvature = max(curvature, 1.0)
        root = math.sqrt(curvature)
        near = slope / root
        far = near + (high[k] - low[k]) * root
        beyond = math.exp(-0.5 * (far - near) * (far + near)) * erfcx(far / math.sqrt(2.0))
        total += math.log(0.5 * (erfcx(near / math.sqrt(2.0)) - beyond)) - math.log(root)
        # An exponential fall is as wide as its slope says, a normal one as its curvature.
        own = 1.0 / max(curvature, slope**2)
        for a in range(number):
            variance[a] += following[free[a]] ** 2 * own
        reach = min(fall(min(near, STEEP)) / root, -TAIL / max(slope, 1e-300))
        deviation[k] = reach / NORMAL
    for a in range(number):
        deviation[free[a]] = math.sqrt(variance[a])
    return total


def log_share(low: float, high: float) -> float:
    """Return the log of the share of a standard normal distribution between bounds.

    By the tail on the side where it is small: a difference of two ones would be noise.
    """
    if high < 0.0:
        low, high = -high, -low
    if low <= 0.0:
        share = 0.5 * (math.erf(high / math.sqrt(2.0)) - math.erf(low / math.sqrt(2.0)))
        return math.log(max(share, LEAST))
    beyond = math.exp(-0.5 * (high - low) * (high + low)) * erfcx(high / math.sqrt(2.0))
    near = erfcx(low / math.sqrt(2.0))
    return math.log(0.5 * max(near - beyond, 2.0 * LEAST * near)) - 0.5 * low**2


def fall(near: float) -> float:
    """Return how far beyond a point 95 % of a normal distribution's tail lies, by Newton's steps.

    The log of the tail falls ever faster: behind the first they come down to the answer.
    """
    there, begun = 0.0, math.log(erfcx(near / math.sqrt(2.0)))
    for _ in range(50):
        left = erfcx((near + there) / math.sqrt(2.0))
        log = math.log(left) - begun - there * (near + 0.5 * there)
        step = (log - TAIL) * left * math.sqrt(0.5 * math.pi)
        there += step
        if abs(step) <= 1e-12 * there:
            break
    return there


def erfcx(x: float) -> float:
    """Return exp(x^2) erfc(x) of what is not below 0."""
    if x < 25.0:
        return math.exp(x * x) * math.erfc(x)
    y = 0.5 / (x * x)
    series = 1.0 - y * (1.0 - 3.0 * y * (1.0 - 5.0 * y * (1.0 - 7.0 * y)))
    return series / (x * math.sqrt(math.pi))
