"""The derivative view: one entry to the methods, chosen from the data by default."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from jaxsr._result import InputError
from jaxsr.recordings.noise import noise_level
from jaxsr.views.finite_difference import finite_difference
from jaxsr.views.savitzky_golay import savitzky_golay
from jaxsr.views.tikhonov import adaptive_spline, tikhonov
from jaxsr.views.total_variation import total_variation

DERIVATIVES: Mapping[str, Callable[..., np.ndarray]] = {
    "finite_difference": finite_difference,
    "savitzky_golay": savitzky_golay,
    "total_variation": total_variation,
    "tikhonov": tikhonov,
    "adaptive_spline": adaptive_spline,
}
_CLEAN = 1e-3  # noise of the finite difference, relative to the derivative


def derivative(
    t: np.ndarray, y: np.ndarray, method: str = "auto", order: int = 1, **config: Any
) -> np.ndarray:
    """Differentiate a signal or the columns of an array.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds; need not be uniform.
    y : ndarray, shape (samples,) or (samples, columns)
        NaN where missing.
    method : str
        A key of `DERIVATIVES`, or "auto", which decides for every column by itself
        (`choose_method`).
    order : int
        1 for the first derivative, 2 for the second.
    **config
        Passed on to the method.

    Returns
    -------
    ndarray, of the shape of `y`

    Raises
    ------
    InputError
        For an unknown method.
    """
    y = np.asarray(y, dtype=np.float64)
    if y.ndim == 2:
        columns = [derivative(t, column, method, order, **config) for column in y.T]
        return np.stack(columns, axis=1)
    if method == "auto":
        method = choose_method(t, y, order)
        if method == "finite_difference":
            config = {"accuracy": 6 if np.count_nonzero(np.isfinite(y)) > 16 else 2} | config
    if method not in DERIVATIVES:
        raise InputError(f"unknown derivative '{method}'", remedy=f"Use auto, {_names()}")
    return DERIVATIVES[method](t, y, derivative=order, **config)


def choose_method(t: np.ndarray, y: np.ndarray, order: int = 1) -> str:
    """Name the method for a signal: finite differences if clean, Savitzky-Golay if noisy.

    Clean means that the noise which a central difference passes on is below a thousandth of the
    derivative's root mean square.
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    estimate = finite_difference(t, y, derivative=order, accuracy=2)
    dt = np.diff(t[np.isfinite(y)])
    before, after = dt[:-1], dt[1:]
    both = before + after
    if order == 1:
        weights = (after / (before * both), (after - before) / (before * after))
        weights = (*weights, before / (after * both))
    else:
        weights = (2.0 / (before * both), 2.0 / (before * after), 2.0 / (after * both))
    gains = np.linalg.norm(weights, axis=0)
    gain = np.sqrt(np.mean(gains**2))
    size = float(np.sqrt(np.nanmean(estimate**2)))
    clean = noise_level(t, y) * gain <= _CLEAN * size
    return "finite_difference" if clean else "savitzky_golay"


def _names() -> str:
    return ", ".join(DERIVATIVES)
