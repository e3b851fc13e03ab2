"""How noisy, and how coarsely stored, a channel is."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from jaxsr._deadline import ask

DIFFERENCE_ORDERS = (2, 4, 6, 8, 10)
_TRIM = 3.0  # residuals beyond this many robust standard deviations are not noise
_TRIMMED_STD = 0.98658  # standard deviation of a unit normal cut at +-3
_LEVELS = 6  # from which their spacing tells a grid
_SAME = 1e-9  # of the range, within which two levels are one
_MAX_ROWS = 20_000  # differences that suffice on long non-uniform records


def noise_level(t: np.ndarray, y: np.ndarray) -> float:
    r"""Estimate the standard deviation of white measurement noise.

    The k-th divided difference of k + 1 neighbours removes every polynomial of degree below k;
    with coefficients c of unit norm its standard deviation is that of the noise. The orders
    2, 4, ..., 10 are tried in turn and a higher one is taken where it lowers the estimate by a
    tenth, because a signal left over can only raise it. The spread is taken robustly, so jumps,
    kinks and outliers do not count.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Time, strictly increasing, in seconds.
    y : ndarray, shape (samples,)
        Signal; NaN samples are left out.

    Returns
    -------
    float
        In the unit of `y`; at least ``quantisation_step(y) / sqrt(12)``. 0 for a constant.

    References
    ----------
    Hall, Kay and Titterington, "Asymptotically optimal difference-based estimation of variance
    in nonparametric regression", Biometrika 77 (1990), for the principle.
    """
    ask()
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    kept = np.isfinite(y)
    t, y = t[kept], y[kept]
    if y.size < 4 or np.ptp(y) == 0.0:
        return 0.0
    size = float(np.max(np.abs(y)))  # keeps squares inside the range of floats
    estimate = np.inf
    for order in DIFFERENCE_ORDERS:
        if y.size < 3 * order and np.isfinite(estimate):
            break
        candidate = size * _spread(_differences(t, y / size, order))
        if candidate < 0.9 * estimate:
            estimate = candidate
    step = quantisation_step(y)
    return float(max(estimate, (step or 0.0) / np.sqrt(12.0)))


def _differences(t: np.ndarray, y: np.ndarray, order: int) -> np.ndarray:
    """Divided differences of y with unit-norm coefficients, away from gaps."""
    size = min(order, y.size - 2) + 1
    dt = np.diff(t)
    if np.ptp(dt) < 1e-6 * np.median(dt):
        weights = np.poly(np.ones(size - 1))
        return np.convolve(y, weights / np.linalg.norm(weights), mode="valid")
    times = sliding_window_view(t, size)
    span = np.ptp(times, axis=1)
    near = np.flatnonzero(span <= 3.0 * np.median(span))
    near = near[:: max(1, near.size // _MAX_ROWS)]
    local = (times[near] - times[near].mean(axis=1, keepdims=True)) / span[near, None]
    apart = local[:, :, None] - local[:, None, :]
    apart[:, np.arange(size), np.arange(size)] = 1.0
    weights = 1.0 / np.prod(apart, axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return np.einsum("ij,ij->i", weights, sliding_window_view(y, size)[near])


def _spread(residual: np.ndarray) -> float:
    """Standard deviation of the bulk of normally distributed residuals."""
    scale = 1.4826 * np.median(np.abs(residual))
    if scale == 0.0:
        return 0.0
    bulk = residual[np.abs(residual) <= _TRIM * scale]
    return float(np.sqrt(np.mean(bulk**2)) / _TRIMMED_STD)


def quantisation_step(y: np.ndarray) -> float | None:
    """Find the step of the grid on which the values of a channel lie.

    Parameters
    ----------
    y : ndarray, shape (samples,)
        Signal; NaN samples are left out.

    Returns
    -------
    float or None
        Step in the unit of `y`. None if the values lie on no grid coarser than the resolution
        of float64, or if there are fewer than six different values.

    Notes
    -----
    The most common smallest spacing is tried first and allows 2 % of the samples to lie off the
    grid (replaced or interpolated values); a grid too fine for neighbouring levels to occur is
    found as the common divisor of the spacings.
    """
    y = np.asarray(y, dtype=np.float64)
    y = y[np.isfinite(y)]
    levels = np.unique(y)
    if levels.size < _LEVELS:
        return None
    resolution = 64.0 * np.finfo(np.float64).eps * float(np.max(np.abs(levels)))
    gaps = np.diff(levels)
    gaps = gaps[gaps > resolution]
    if gaps.size < 5:
        return None
    for step in (float(np.median(gaps)), float(np.quantile(gaps, 0.1))):
        step = _refined(levels, step)
        if step > 1e3 * resolution and on_grid(y, step) and _levels_used(levels, step):
            return step
    step = _refined(levels, _common_divisor(gaps, resolution))
    return step if step > 1e3 * resolution and on_grid(y, step) else None


def level_spacing(y: np.ndarray) -> float | None:
    """Return the spacing of a sensor that reads two to five levels, too few to tell a grid by.

    A body that moves passes every value in between; the sensor does not tell them. None where
    the levels lie on no common grid, or are more, or one.
    """
    y = np.asarray(y, dtype=np.float64)
    y = y[np.isfinite(y)]
    levels = np.unique(y)
    if levels.size < 2:
        return None
    apart = np.diff(levels) > _SAME * np.ptp(levels)  # differences of readings are rounded
    levels = levels[np.concatenate([[True], apart])]
    if not 2 <= levels.size < _LEVELS:
        return None
    step = _refined(levels, float(np.diff(levels).min()))
    return step if on_grid(y, step) else None


def _refined(levels: np.ndarray, step: float) -> float:
    """Least-squares step through the levels, as far as the counts are certain."""
    counts = np.cumsum(np.round(np.diff(levels) / step))
    rise = levels[1:] - levels[0]
    used = counts > 0
    if not used.any():
        return step
    return float(np.sum(counts[used] * rise[used]) / np.sum(counts[used] ** 2))


def on_grid(y: np.ndarray, step: float) -> bool:
    """Whether values, but for one in fifty, lie on a grid, wherever its origin."""
    phase = np.exp(2j * np.pi * (y - np.median(y)) / step)
    centre = np.angle(np.mean(phase))
    off = np.abs(np.angle(phase * np.exp(-1j * centre))) / (2 * np.pi)
    return bool(np.mean(off < 0.05) >= 0.98)


def _levels_used(levels: np.ndarray, step: float) -> bool:
    """Chance puts few values on a grid: ask for eight neighbouring levels, or nearly all."""
    neighbours = np.mean(np.abs(np.diff(levels) / step - 1.0) < 0.1)
    return bool(levels.size >= 8 and neighbours > 0.5)


def _common_divisor(gaps: np.ndarray, resolution: float) -> float:
    """Euclid's algorithm on the smallest spacings at once, down to the given resolution."""
    gaps = np.sort(gaps)[:64]
    divisor = float(gaps[0])
    while divisor > 1e3 * resolution:
        counts = np.round(gaps / divisor)
        rest = np.abs(gaps - divisor * counts)
        rest = rest[rest > resolution * (1.0 + counts)]
        if rest.size == 0:
            break
        divisor = float(rest.min())
    return divisor
