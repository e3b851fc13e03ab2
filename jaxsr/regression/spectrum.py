"""Frequencies to start from: a wrong frequency inside a sine has no gradient to follow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array

if TYPE_CHECKING:
    from jaxsr.regression.problem import RegressionProblem


def residual_frequencies(
    problem: RegressionProblem, terms: Sequence[Term], variable: str, count: int = 3
) -> list[float]:
    r"""Return the frequencies w (rad per unit) at which the residual holds most of sin and cos.

    For each w of a grid the residual's share in span{A sin(w v), A cos(w v)} is taken by least
    squares, so samples need be neither uniform nor from one recording.

    Parameters
    ----------
    terms : sequence of Term
        What is fitted already.
    variable : str
        v, the argument of the sine: time, or an angle for a ripple.
    count : int
        Number of peaks returned, highest first.
    """
    values = problem.variables[variable]
    span = float(np.ptp(values))
    if not span > 0.0:
        return []
    residual = problem.residual(terms)
    grid = _grid(values, span)
    parts = np.array_split(grid, 1 + len(grid) // 100)
    power = np.concatenate([_power(problem, values, part, residual) for part in parts])
    inner = power[1:-1]
    peaks = 1 + np.flatnonzero((inner >= power[:-2]) & (inner >= power[2:]))
    best = peaks[np.argsort(-power[peaks])][:count]
    return [float(grid[k]) for k in best if power[k] > 0.0]


def _grid(values: Array, span: float) -> Array:
    """Space frequencies at half the resolution of the span, up to what the samples resolve."""
    steps = np.abs(np.diff(values))
    step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else span
    highest = min(np.pi / step, np.pi / span * 800)
    count = int(np.clip(highest / (np.pi / span) * 2, 8, 1600))
    return np.linspace(0.0, highest, count + 1)[1:]


def _power(problem: RegressionProblem, values: Array, grid: Array, residual: Array) -> Array:
    angle = np.outer(values, grid)
    waves = np.hstack([np.sin(angle), np.cos(angle)])
    if problem.view is not None:
        waves = problem.view(waves)
    n = len(grid)
    s, c = waves[:, :n], waves[:, n:]
    ss, cc, sc = (np.einsum("ij,ij->j", a, b) for a, b in ((s, s), (c, c), (s, c)))
    rs, rc = residual @ s, residual @ c
    determinant = ss * cc - sc**2
    valid = determinant > 1e-6 * ss * cc
    share = (cc * rs**2 - 2.0 * sc * rs * rc + ss * rc**2) / np.where(valid, determinant, 1.0)
    return np.where(valid, share, 0.0)
