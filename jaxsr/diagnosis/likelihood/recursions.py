"""The recursions of a Kalman filter and smoother, lane by lane and number by number.

Written for a compiler (Numba), number by number: as Python they are slow. Thousands of steps with
matrices of a few rows cost NumPy its calls, not its arithmetic.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

Array = np.ndarray
WIDE = 16
"""States from which products of matrices are the library's: its calls cost less than they save."""


class Choices(NamedTuple):
    """Constants of the noises, chosen in several ways: a tuple of arrays to the compiler.

    Attributes
    ----------
    decay, start, process : ndarray, shape (choices, size)
    noise : ndarray, shape (choices, outputs)
    """

    decay: Array
    start: Array
    process: Array
    noise: Array


def filtered(
    transition: Array,
    entering: Array,
    reading: Array,
    measured: Array,
    seen: Array,
    chosen: Choices,
    span: tuple[int, int],
    rows: Array,
    log_determinant: Array,
) -> None:
    """Fill the innovations of unit variance of lanes, and the logarithms of variances.

    Readings of a sample are taken in one after the other. Spread and means lie side by side in
    `both`; entries of a transition that are zero are passed over. All choices of a sample are gone
    through before the next: what they share is read once.

    Parameters
    ----------
    transition, entering, reading, measured, seen : ndarray
        Of a `System`.
    chosen : Choices
    span : tuple of int
        First of the pieces that are gone through, and the one behind the last.
    rows : ndarray, shape (choices, pieces, samples, outputs, width)
        Zero before; filled.
    log_determinant : ndarray, shape (choices, pieces)
        Zero before; filled.
    """
    decay, start, process, noise = chosen
    times, _, outputs, width = measured.shape
    choices, size = start.shape
    whole = (size + width + WIDE - 1) // WIDE * WIDE
    wide = max(size, WIDE)
    every, moved = np.zeros((choices, size, whole)), np.zeros((size, whole))
    read, gain = np.zeros(whole), np.zeros(size)
    turned, ahead = np.zeros((size, wide)), np.zeros((size, wide))
    count, place = np.zeros(size, np.int64), np.zeros((size, size), np.int64)
    for piece in range(span[0], span[1]):
        every[:] = 0.0
        for choice in range(choices):
            for i in range(size):
                every[choice, i, i] = start[choice, i]
        for t in range(times):
            if t + 1 < times:
                for i in range(size):
                    count[i] = 0
                    for k in range(size):
                        if transition[t, piece, i, k] != 0.0:
                            place[i, count[i]] = k
                            count[i] += 1
            for choice in range(choices):
                both = every[choice]
                for k in range(outputs):
                    if not seen[t, piece, k]:
                        continue
                    for j in range(whole):
                        read[j] = 0.0
                    for i in range(size):
                        a = reading[t, piece, k, i]
                        if a != 0.0:
                            for j in range(whole):
                                read[j] += a * both[i, j]
                    variance = noise[choice, k]
                    for i in range(size):
                        variance += reading[t, piece, k, i] * read[i]
                    if not variance > 0.0:  # digits were lost: no answer
                        variance = np.nan
                    log_determinant[choice, piece] += np.log(variance)
                    for i in range(size):
                        gain[i] = read[i] / variance
                    scale = -1.0 / np.sqrt(variance)
                    for j in range(width):
                        read[size + j] -= measured[t, piece, k, j]
                        rows[choice, piece, t, k, j] = scale * read[size + j]
                    for i in range(size):
                        a = gain[i]
                        for j in range(whole):
                            both[i, j] -= a * read[j]
                if t + 1 == times:
                    continue
                move = transition[t, piece]
                if size < WIDE:
                    for i in range(size):
                        for j in range(whole):
                            moved[i, j] = 0.0
                        for n in range(count[i]):
                            k = place[i, n]
                            a = move[i, k]
                            for j in range(whole):
                                moved[i, j] += a * both[k, j]
                else:
                    np.dot(move, both, moved)
                for i in range(size):
                    for j in range(size):
                        turned[j, i] = moved[i, j]
                if size < WIDE:
                    for i in range(size):
                        for j in range(wide):
                            ahead[i, j] = 0.0
                        for n in range(count[i]):
                            k = place[i, n]
                            a = move[i, k]
                            for j in range(wide):
                                ahead[i, j] += a * turned[k, j]
                else:
                    np.dot(move, turned, ahead)
                for i in range(size):
                    shrunk = decay[choice, i]
                    for j in range(width):
                        both[i, size + j] = shrunk * moved[i, size + j] + entering[t, piece, i, j]
                    for j in range(i, size):
                        both[i, j] = shrunk * decay[choice, j] * ahead[i, j]
                        both[j, i] = both[i, j]
                    both[i, i] += process[choice, i]


def returned(
    transition: Array,
    entering: Array,
    reading: Array,
    measured: Array,
    seen: Array,
    chosen: Choices,
    span: tuple[int, int],
    result: Array,
) -> None:
    """Fill the smoothed deviations of pieces: forth as `filtered`, and back.

    Readings are taken in one after the other (univariate treatment): with v an innovation of
    variance F, k its gain and h what is read, the score goes back by r -> r + h (v / F - k' r).

    Parameters
    ----------
    transition, entering, reading, measured, seen : ndarray
        Of a `System`, as `filtered` has them; of `entering` and `measured` the first column.
    chosen : Choices
        One.
    span : tuple of int
        First of the pieces that are gone through, and the one behind the last.
    result : ndarray, shape (states, samples, pieces)
        Filled; the first states of the system.

    References
    ----------
    Durbin and Koopman, Time Series Analysis by State Space Methods (2012), 6.4.
    """
    decay, start = chosen.decay[0], chosen.start[0]
    process, noise = chosen.process[0], chosen.noise[0]
    times, _, outputs, _ = measured.shape
    size, states = len(start), len(result)
    mean, spread = np.zeros(size), np.zeros((size, size))
    moved, score, before = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    ahead = np.zeros((size, size))
    means, spreads = np.zeros((times, size)), np.zeros((times, size, size))
    gains, lefts = np.zeros((times, outputs, size)), np.zeros((times, outputs))
    for piece in range(span[0], span[1]):
        for i in range(size):
            mean[i] = 0.0
            for j in range(size):
                spread[i, j] = 0.0
            spread[i, i] = start[i]
        for t in range(times):
            for i in range(size):
                means[t, i] = mean[i]
                for j in range(size):
                    spreads[t, i, j] = spread[i, j]
            for k in range(outputs):
                if not seen[t, piece, k]:
                    continue
                left, variance = measured[t, piece, k, 0], noise[k]
                for j in range(size):
                    before[j] = 0.0
                for i in range(size):
                    a = reading[t, piece, k, i]
                    if a != 0.0:
                        left -= a * mean[i]
                        for j in range(size):
                            before[j] += a * spread[i, j]
                for i in range(size):
                    variance += reading[t, piece, k, i] * before[i]
                if not variance > 0.0:  # digits were lost: no answer
                    variance = np.nan
                for i in range(size):
                    a = before[i] / variance
                    gains[t, k, i] = a
                    mean[i] += a * left
                    for j in range(size):
                        spread[i, j] -= a * before[j]
                lefts[t, k] = left / variance
            if t + 1 == times:
                break
            move = transition[t, piece]
            for i in range(size):
                total = 0.0
                for k in range(size):
                    total += move[i, k] * mean[k]
                before[i] = decay[i] * total + entering[t, piece, i, 0]
            if size < WIDE:
                for i in range(size):
                    for j in range(size):
                        moved[i, j] = 0.0
                    for k in range(size):
                        a = move[i, k]
                        if a != 0.0:
                            for j in range(size):
                                moved[i, j] += a * spread[k, j]
                for i in range(size):
                    for j in range(i, size):
                        total = 0.0
                        for k in range(size):
                            total += moved[i, k] * move[j, k]
                        ahead[i, j] = total
            else:
                np.dot(move, spread, moved)
                np.dot(moved, move.T, ahead)
            for i in range(size):
                mean[i] = before[i]
                for j in range(i, size):
                    spread[i, j] = decay[i] * decay[j] * ahead[i, j]
                    spread[j, i] = spread[i, j]
                spread[i, i] += process[i]
        for i in range(size):
            score[i] = 0.0
        for t in range(times - 1, -1, -1):
            if t + 1 < times:
                for j in range(size):
                    before[j] = 0.0
                for i in range(size):
                    a = decay[i] * score[i]
                    for j in range(size):
                        before[j] += a * transition[t, piece, i, j]
                for j in range(size):
                    score[j] = before[j]
            for k in range(outputs - 1, -1, -1):
                if seen[t, piece, k]:
                    pulled = lefts[t, k]
                    for i in range(size):
                        pulled -= gains[t, k, i] * score[i]
                    for i in range(size):
                        score[i] += pulled * reading[t, piece, k, i]
            for i in range(states):
                total = means[t, i]
                for j in range(size):
                    total += spreads[t, i, j] * score[j]
                result[i, t, piece] = total
