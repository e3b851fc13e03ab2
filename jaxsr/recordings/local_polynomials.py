"""Local polynomials through the samples of windows: noise averaged, slow motions left as they are.

A row for every block of samples could be their mean; but the mean of a curve is not its middle,
and what is left, a hundredth of the noise on every row, adds up over ten thousand rows to a term
of the law. A polynomial through a wider window, at the block's middle, averages as much noise (the
windows of degree 6 are `SPAN` blocks long for that), its errors are nearly those of independent
samples, and motions that are slow beside a block keep their values to the eighth order.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre

DEGREE = 6
SPAN = 5
"""Blocks of a window: the variance at its middle is 0.96 of that of the mean of a block."""
_WORST = 3.0  # variance over that of a block's mean from which a row counts as missing
_REACH = 2.0  # median widths of a window beyond which a sample is across a pause
_CELLS = 500_000  # samples of windows treated at once
_RIDGE = 1e-12  # of the Gram matrix: samples may coincide nearly


def at_blocks(t: np.ndarray, y: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean times of blocks of samples and a signal's values there.

    Near the ends of the recording the same window serves several blocks; across a pause none
    reaches.

    Parameters
    ----------
    t, y : ndarray, (samples,)
        Times need not be even; samples may be missing (NaN).
    size : int
        Samples of a block; what is left over after the last one is dropped.

    Returns
    -------
    centre, value : ndarray, (blocks,)
        NaN where more than half of a block's samples are missing, or the samples around tell
        little.

    References
    ----------
    Savitzky and Golay (1964), Analytical Chemistry 36, 1627-1639, for even times.
    """
    count = len(t) // size
    blocks = slice(0, count * size)
    centre = np.mean(t[blocks].reshape(count, size), axis=1)
    there = np.isfinite(y)
    present = np.count_nonzero(there[blocks].reshape(count, size), axis=1)
    width = min(SPAN * size, len(t))
    first = np.clip(np.arange(count) * size - (width - size) // 2, 0, len(t) - width)
    reach = _REACH * width * float(np.median(np.diff(t)))
    value = np.full(count, np.nan)
    many = max(1, _CELLS // width)
    for start in range(0, count, many):
        part = slice(start, start + many)
        rows = first[part, None] + np.arange(width)
        away = t[rows] - centre[part, None]
        known = there[rows] & (np.abs(away) <= reach)
        fit, variance = _at_zero(away, y[rows], known)
        value[part] = np.where(variance * size <= _WORST, fit, np.nan)
    return centre, np.where(2 * present >= size, value, np.nan)


def _at_zero(t: np.ndarray, y: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what polynomials through the known samples of windows are at t = 0.

    Parameters
    ----------
    t, y, known : ndarray, (windows, samples)

    Returns
    -------
    value, variance : ndarray, (windows,)
        The variance is relative to a sample's; inf where there are fewer samples than
        coefficients.
    """
    present = np.count_nonzero(known, axis=1)
    weight = known / np.maximum(present, 1)[:, None]
    level = np.sum(weight * np.where(known, y, 0.0), axis=1)  # an offset must not cost digits
    middle = np.sum(weight * t, axis=1)
    away = np.where(known, t - middle[:, None], 0.0)
    scale = np.maximum(np.max(np.abs(away), axis=1), np.finfo(float).tiny)
    basis = legendre.legvander(away / scale[:, None], DEGREE) * known[:, :, None]
    here = legendre.legvander(np.clip(-middle / scale, -1.0, 1.0), DEGREE)
    enough = present > DEGREE
    gram = basis.transpose(0, 2, 1) @ basis
    gram[~enough] = np.eye(DEGREE + 1)
    gram += _RIDGE * np.maximum(present, 1)[:, None, None] * np.eye(DEGREE + 1)
    weights = np.linalg.solve(gram, here[:, :, None])[:, :, 0]
    above = np.where(known, y - level[:, None], 0.0)
    moment = np.einsum("wsk,ws->wk", basis, above)
    value = level + np.sum(weights * moment, axis=1)
    return value, np.where(enough, np.sum(weights * here, axis=1), np.inf)
