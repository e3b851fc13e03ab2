"""Where to split: the threshold that lets two linear fits leave the least (section 5, step c)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr._deadline import ensure, never

_POSITIONS = 100  # thresholds tried on each guard, evenly spaced in rank, then once finer
_RIDGE = 1e-11  # damping of columns of mean square one
_LEAST = 1e-200  # sum of squares of a target at rest, whose logarithm is taken
_EXACT = 1e-13  # share of a target's sum of squares below which fits differ by rounding alone


@dataclass(frozen=True, slots=True)
class Split:
    """One threshold on one guard variable.

    Attributes
    ----------
    guard : int
        Number of the guard variable.
    threshold : float
    below, above : int
        Samples on either side.
    gain : float
        Fall of the log of the mean square that is left, averaged over the targets.
    level : float
        Log of what is left, relative to the target's sum of squares.
    sharpness : float
        Least rise of that log where the threshold is moved by a twentieth of the samples.
    """

    guard: int
    threshold: float
    below: int
    above: int
    gain: float
    level: float
    sharpness: float


def best_splits(
    columns: np.ndarray,
    targets: np.ndarray,
    guards: Sequence[np.ndarray],
    least: int,
    expired: Callable[[], bool] = never,
) -> list[Split]:
    r"""Return the best threshold of every guard variable, the largest gain first.

    For samples sorted by a guard variable g, and every threshold c, both sides are fitted by
    least squares from the same columns; c minimises the sum of what both leave,

    .. math:: \min_c \sum_{g \le c} |y - \Theta\xi_1|^2 + \sum_{g > c} |y - \Theta\xi_2|^2.

    The products of columns are summed up once along the sorted samples, so a threshold costs two
    small solves.

    Parameters
    ----------
    columns : ndarray, (samples, terms)
        Weighted, of mean square about one.
    targets : ndarray, (samples, states)
        Weighted like the columns.
    guards : sequence of ndarray, (samples,)
    least : int
        Samples that a side must have.
    expired : callable
        Whether the time is over.

    Raises
    ------
    OutOfTime
        Once it is.
    """
    total = np.maximum(np.sum(targets**2, axis=0), _LEAST)
    everywhere = _left(columns.T @ columns, columns.T @ targets, total, total)
    splits = []
    for number, values in enumerate(guards):
        ensure(expired)
        order = np.argsort(values, kind="stable")
        found = _of_guard(columns[order], targets[order], values[order], least, total)
        if found is None:
            continue
        place, level, sharpness = found
        gain = float(np.mean(np.log(everywhere)) - level)
        threshold = 0.5 * (values[order][place - 1] + values[order][place])
        relative = level - float(np.mean(np.log(total)))
        sides = place, len(values) - place
        splits.append(Split(number, float(threshold), *sides, gain, relative, sharpness))
    return sorted(splits, key=lambda split: -split.gain)


def _of_guard(
    columns: np.ndarray, targets: np.ndarray, values: np.ndarray, least: int, total: np.ndarray
) -> tuple[int, float, float] | None:
    """Return place, mean log of what is left, and sharpness, of sorted samples."""
    count = len(values)
    if count < 2 * least:
        return None
    coarse = np.unique(np.linspace(least, count - least, _POSITIONS).astype(int))
    levels = _levels(columns, targets, coarse, total)
    levels[values[coarse - 1] == values[coarse]] = np.inf
    if not np.any(np.isfinite(levels)):
        return None
    best = int(np.argmin(levels))
    low, high = coarse[max(best - 1, 0)], coarse[min(best + 1, len(coarse) - 1)]
    fine = np.unique(np.linspace(low, high, 40).astype(int))
    finer = _levels(columns, targets, fine, total)
    finer[values[fine - 1] == values[fine]] = np.inf
    place, level = int(fine[np.argmin(finer)]), float(np.min(finer))
    shift = max(count // 20, 2)
    known = np.isfinite(levels)
    moved = [np.interp(place + s, coarse[known], levels[known]) for s in (-shift, shift)]
    return place, level, float(min(moved) - level)


def _levels(
    columns: np.ndarray, targets: np.ndarray, places: np.ndarray, total: np.ndarray
) -> np.ndarray:
    """Return the mean log of what two fits leave, split before each of the places (places,)."""
    edges = np.concatenate([[0], places, [len(columns)]])
    pieces = [slice(a, b) for a, b in itertools.pairwise(edges)]
    grams = np.cumsum([columns[p].T @ columns[p] for p in pieces], axis=0)
    products = np.cumsum([columns[p].T @ targets[p] for p in pieces], axis=0)
    squares = np.cumsum([np.sum(targets[p] ** 2, axis=0) for p in pieces], axis=0)
    out = np.empty(len(places))
    for k in range(len(places)):
        below = _left(grams[k], products[k], squares[k], 0.0)
        above = _left(
            grams[-1] - grams[k], products[-1] - products[k], squares[-1] - squares[k], 0.0
        )
        out[k] = np.mean(np.log(below + above + _EXACT * total))
    return out


def _left(
    gram: np.ndarray, product: np.ndarray, square: np.ndarray, scale: np.ndarray | float
) -> np.ndarray:
    """Return the sum of squares that a least-squares fit leaves (targets,)."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size) + _RIDGE * np.eye(len(gram))
    known = product / size[:, None]
    explained = np.sum(known * np.linalg.solve(scaled, known), axis=0)
    return np.maximum(square - explained, 0.0) + _EXACT * np.asarray(scale)
