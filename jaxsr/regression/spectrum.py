"""Frequencies to start from: a wrong frequency inside a sine has no gradient to follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from jaxsr.expressions.term import Term
from jaxsr.regression.digits import SINGLE_BITS, rounded
from jaxsr.regression.excerpt import Excerpt
from jaxsr.regression.gram import Array

_TOGETHER = 64  # frequencies


class Waving(Protocol):
    """A problem as far as its residual's frequencies are concerned, see `RegressionProblem`."""

    excerpt: Excerpt

    def waves(self, variable: str, factor: str = "") -> Waves | None: ...


def residual_frequencies(
    problem: Waving, terms: Sequence[Term], variable: str, count: int = 3
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
    return [w for _, w in residual_waves(problem, terms, variable, count)]


def residual_waves(
    problem: Waving,
    terms: Sequence[Term],
    variable: str,
    count: int,
    factors: Sequence[str] = ("",),
) -> list[tuple[str, float]]:
    """Return frequencies as `residual_frequencies` does, of waves times one of some variables.

    Parameters
    ----------
    factors : sequence of str
        Variables; "" for the waves alone.

    Returns
    -------
    list of (factor, frequency)
        Highest first.
    """
    residual, found = problem.excerpt.residual(terms), list[tuple[float, str, float]]()
    for factor in factors:
        waves = problem.waves(variable, factor)
        if waves is None:
            continue
        power = waves.power(residual)
        inner = power[1:-1]
        peaks = 1 + np.flatnonzero((inner >= power[:-2]) & (inner >= power[2:]))
        heights = rounded(power[peaks], SINGLE_BITS)
        found += [
            (-float(h), factor, float(waves.grid[k]))
            for h, k in zip(heights, peaks, strict=True)
            if power[k] > 0.0
        ]
    found.sort(key=lambda peak: peak[0])  # ties in order
    return [(factor, w) for _, factor, w in found[:count]]


@dataclass(frozen=True, slots=True)
class Waves:
    """Viewed sines and cosines of one variable at a grid of frequencies, made once.

    Some rows and float32 are enough: only the place of a peak is read from them, a refinement
    follows.

    Attributes
    ----------
    grid : ndarray, (frequencies,)
    sines, cosines : ndarray, (frequencies, rows)
    products : tuple of ndarray, (frequencies,)
        Of sine with sine, cosine with cosine, sine with cosine.
    """

    grid: Array
    sines: NDArray[np.float32]
    cosines: NDArray[np.float32]
    products: tuple[Array, Array, Array]

    @property
    def bytes(self) -> int:
        """Bytes that it takes."""
        return self.sines.nbytes + self.cosines.nbytes

    def power(self, residual: Array) -> Array:
        """Return the sum of squares that a sine and a cosine of each frequency take away."""
        ss, cc, sc = self.products
        scale = float(np.max(np.abs(residual))) or 1.0
        short = (residual / scale).astype(np.float32)
        rs, rc = ((waves @ short).astype(float) for waves in (self.sines, self.cosines))
        determinant = ss * cc - sc**2
        valid = determinant > 1e-4 * ss * cc
        share = (cc * rs**2 - 2.0 * sc * rs * rc + ss * rc**2) / np.where(valid, determinant, 1.0)
        return np.where(valid, share, 0.0)


def make_waves(
    values: Array, rows: Excerpt, *, is_time: bool, factor: Array | None = None
) -> Waves | None:
    """Return the waves of a variable's samples, times a factor; None for one that does not move.

    Frequencies are multiples of the first, so each wave is the last one turned by one angle.
    """
    span = float(np.ptp(values))
    if not span > 0.0:
        return None
    grid = _grid(values, span, is_time)
    turn = np.exp(1j * grid[0] * rows.of(values))
    wave = np.ones_like(turn)
    s, c = (np.empty((len(grid), len(rows.target)), np.float32) for _ in range(2))
    for first in range(0, len(grid), _TOGETHER):
        part = slice(first, min(first + _TOGETHER, len(grid)))
        turned = np.empty((part.stop - first, len(wave)), complex)
        for row in turned:
            np.multiply(wave, turn, out=row)
            wave = row
        turned = turned if factor is None else turned * rows.of(factor)
        s[part], c[part] = rows.seen(np.imag(turned).T).T, rows.seen(np.real(turned).T).T
    ss, cc, sc = (np.vecdot(a, b).astype(float) for a, b in ((s, s), (c, c), (s, c)))
    return Waves(grid, s, c, (ss, cc, sc))


def _grid(values: Array, span: float, is_time: bool) -> Array:
    """Space frequencies at half the resolution of the span.

    Up to what the samples resolve: of time at most 400 cycles, of a state from 20 over its range,
    beyond which the ripple of a short swing cannot be told from noise by eye or by test, to 100, as
    that of a rotor that turns several times.
    """
    resolution = np.pi / span
    steps = np.abs(np.diff(values))
    resolved = 0.5 * span / float(np.median(steps[steps > 0.0]))
    cycles = min(resolved, 400.0) if is_time else min(max(resolved, 20.0), 100.0)
    count = max(int(4 * cycles), 8)
    return np.asarray(resolution / 2.0 * np.arange(1, count + 1), dtype=np.float64)
