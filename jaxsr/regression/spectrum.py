"""Frequencies to start from: a wrong frequency inside a sine has no gradient to follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array

if TYPE_CHECKING:
    from jaxsr.regression.problem import RegressionProblem, View


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
    waves = problem.waves(variable)
    if waves is None:
        return []
    power = waves.power(problem.residual(terms))
    inner = power[1:-1]
    peaks = 1 + np.flatnonzero((inner >= power[:-2]) & (inner >= power[2:]))
    best = peaks[np.argsort(-power[peaks])][:count]
    return [float(waves.grid[k]) for k in best if power[k] > 0.0]


@dataclass(frozen=True, slots=True)
class Waves:
    """Viewed sines and cosines of one variable at a grid of frequencies, made once.

    float32 is enough: only the place of a peak is read from them, a refinement follows.
    """

    grid: Array
    sines: NDArray[np.float32]
    cosines: NDArray[np.float32]
    products: tuple[Array, Array, Array]

    def power(self, residual: Array) -> Array:
        """Return the sum of squares that a sine and a cosine of each frequency take away."""
        ss, cc, sc = self.products
        scale = float(np.max(np.abs(residual))) or 1.0
        short = (residual / scale).astype(np.float32)
        rs, rc = (short @ self.sines).astype(float), (short @ self.cosines).astype(float)
        determinant = ss * cc - sc**2
        valid = determinant > 1e-4 * ss * cc
        share = (cc * rs**2 - 2.0 * sc * rs * rc + ss * rc**2) / np.where(valid, determinant, 1.0)
        return np.where(valid, share, 0.0)


def make_waves(values: Array, view: View, *, is_time: bool) -> Waves | None:
    """Return the waves of a variable's samples; None for a variable that does not move."""
    span = float(np.ptp(values))
    if not span > 0.0:
        return None
    grid = _grid(values, span, is_time)
    sines, cosines = [], []
    for part in np.array_split(grid, 1 + len(grid) // 100):
        angle = np.outer(values, part)
        for wave, kept in ((np.sin(angle), sines), (np.cos(angle), cosines)):
            kept.append(view(wave).astype(np.float32))
    s, c = np.hstack(sines), np.hstack(cosines)
    pairs = ((s, s), (c, c), (s, c))
    ss, cc, sc = (np.einsum("ij,ij->j", a, b).astype(float) for a, b in pairs)
    return Waves(grid, s, c, (ss, cc, sc))


def _grid(values: Array, span: float, is_time: bool) -> Array:
    """Space frequencies at half the resolution of the span.

    Time goes up to what the samples resolve, at most 400 cycles; a state to 20 cycles over its
    range, beyond which a ripple cannot be told from noise by eye or by test.
    """
    resolution = np.pi / span
    cycles = 20.0
    if is_time:
        steps = np.abs(np.diff(values))
        step = float(np.median(steps[steps > 0.0]))
        cycles = min(0.5 * span / step, 400.0)
    count = max(int(4 * cycles), 8)
    return np.asarray(resolution / 2.0 * np.arange(1, count + 1), dtype=np.float64)
