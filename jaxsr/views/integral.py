"""Velocities and displacements from accelerations: integration with the drift taken off."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Legendre
from scipy.interpolate import CubicSpline

from jaxsr._result import InputError
from jaxsr.views.gaps import fill, pieces
from jaxsr.views.tikhonov import tikhonov

DRIFTS = ("constants", "bias", "highpass", "none")
_ORDER = 3  # of the penalty under the high-pass: a slope of six powers of frequency


def integrate(
    t: np.ndarray,
    y: np.ndarray,
    order: int = 1,
    drift: str = "constants",
    cutoff: float | None = None,
) -> np.ndarray:
    r"""Integrate a signal over time, once or twice, and take off the drift.

    The cubic spline through the samples is integrated exactly, which is an error of O(h^4). What
    an acceleration cannot tell, the values v(t_0) and x(t_0), is an unknown polynomial
    c_0 + c_1 (t - t_0) of degree order - 1 in the result. It is chosen by `drift`:

    - "constants": the least-squares polynomial of degree order - 1 is subtracted. Right for a
      motion about a fixed place over many periods; a part of a period at the end leaves an error
      of the order of the amplitude over the number of periods.
    - "bias": of degree `order`, which a constant error of the sensor adds too.
    - "highpass": everything slower than `cutoff` is subtracted, by the smoothing spline with gain
      1 / (1 + (f / cutoff)^6). No phase is shifted. For a sensor whose error wanders.
    - "none": the result starts at 0, the constants stay unknown. For a regression that fits them,
      as terms 1 and t.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds; need not be uniform.
    y : ndarray, shape (samples,) or (samples, columns)
        Signal, such as an acceleration. Missing samples (NaN) are filled by the spline.
    order : int
        1: velocity from acceleration; 2: displacement from acceleration.
    drift : str
        One of the four above.
    cutoff : float, optional
        Frequency in hertz, for "highpass" alone.

    Returns
    -------
    ndarray, of the shape of `y`
        NaN in gaps and beyond the ends. A gap parts the record: each part has its own constants.

    Raises
    ------
    InputError
        For another order or drift, a high-pass without `cutoff`, or fewer than 4 samples.
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if y.ndim == 2:
        columns = [integrate(t, column, order, drift, cutoff) for column in y.T]
        return np.stack(columns, axis=1)
    _check(y, order, drift, cutoff)
    filled = fill(t, y)
    result = np.full(y.shape, np.nan)
    for part in pieces(t, np.isfinite(y)):
        if part.stop - part.start >= 4:
            whole = CubicSpline(t[part], filled[part]).antiderivative(order)(t[part])
            result[part] = _without_drift(t[part], whole, order, drift, cutoff)
    return result


def _check(y: np.ndarray, order: int, drift: str, cutoff: float | None) -> None:
    if order not in (1, 2):
        raise InputError(f"integration of order {order}", remedy="Use 1 or 2")
    if drift not in DRIFTS:
        raise InputError(f"unknown drift '{drift}'", remedy=f"Use {', '.join(DRIFTS)}")
    if (drift == "highpass") != (cutoff is not None):
        raise InputError(
            f"drift '{drift}' and cutoff {cutoff}",
            remedy="Give a cutoff in hertz with 'highpass' and only with it",
        )
    if cutoff is not None and not 0.0 < cutoff < np.inf:
        raise InputError(f"cutoff={cutoff}", remedy="Give hertz above 0")
    if np.count_nonzero(np.isfinite(y)) < 4:
        raise InputError("fewer than 4 samples to integrate", remedy="Give at least 4")


def _without_drift(
    t: np.ndarray, x: np.ndarray, order: int, drift: str, cutoff: float | None
) -> np.ndarray:
    if drift == "none":
        return x
    if cutoff is not None:
        if t.size < 2 * _ORDER:
            return np.full(x.shape, np.nan)
        strength = (2.0 * np.pi * cutoff) ** (-2 * _ORDER)
        # the even polynomial first: what is left asks less of the spline at the ends
        x = x - _polynomial(t, x, order)
        return x - tikhonov(t, x, 0, _ORDER, strength=strength)
    return x - _polynomial(t, x, order - (drift == "constants"))


def _polynomial(t: np.ndarray, x: np.ndarray, degree: int) -> np.ndarray:
    """Least-squares polynomial, every second counting alike."""
    shares = np.empty(t.size)
    shares[1:-1] = t[2:] - t[:-2]
    shares[[0, -1]] = t[1] - t[0], t[-1] - t[-2]
    return Legendre.fit(t, x, degree, w=np.sqrt(shares))(t)
