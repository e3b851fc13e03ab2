"""What may be filled between samples, and where a record falls apart."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

GAP = 4.0  # intervals between present samples that leave a gap, in the one that few exceed
_FEW = 0.95  # and not the median, which random sampling exceeds tenfold now and then


def reachable(t: np.ndarray, present: np.ndarray) -> np.ndarray:
    """Mark the present samples and those missing between near neighbours.

    Parameters
    ----------
    t : ndarray, shape (samples,)
    present : ndarray of bool, shape (samples,)

    Returns
    -------
    ndarray of bool, shape (samples,)
        False in gaps and beyond the first and the last present sample.
    """
    times = t[present]
    if times.size < 2:
        return present.copy()
    after = np.searchsorted(times, t)
    inside = (after > 0) & (after < times.size)
    after = np.clip(after, 1, times.size - 1)
    near = times[after] - times[after - 1] <= _longest(np.diff(times))
    return present | (inside & near)


def _longest(dt: np.ndarray) -> float:
    return GAP * float(np.quantile(dt, _FEW))


def fill(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Fill what is `reachable` by a cubic spline through the present samples.

    Parameters
    ----------
    t, y : ndarray, shape (samples,)
        NaN in y where missing.

    Returns
    -------
    ndarray, shape (samples,)
        NaN where not `reachable`.
    """
    present = np.isfinite(y)
    result = np.where(present, y, np.nan)
    for part in pieces(t, present):
        inside = np.arange(part.start, part.stop)
        known, wanted = inside[present[inside]], inside[~present[inside]]
        if wanted.size and known.size >= 4:
            result[wanted] = CubicSpline(t[known], y[known])(t[wanted])
        elif wanted.size:
            result[wanted] = np.interp(t[wanted], t[known], y[known])
    return result


def pieces(t: np.ndarray, present: np.ndarray) -> list[slice]:
    """Stretches of the record without a gap, each from a present sample to a present sample."""
    index = np.flatnonzero(present)
    if index.size == 0:
        return []
    dt = np.diff(t[index])
    breaks = np.flatnonzero(dt > _longest(dt)) if dt.size else np.array([], dtype=int)
    first = np.concatenate([index[:1], index[breaks + 1]])
    last = np.concatenate([index[breaks], index[-1:]])
    return [slice(int(a), int(b) + 1) for a, b in zip(first, last, strict=True)]
