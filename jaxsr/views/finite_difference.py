"""Derivatives by finite differences on any grid."""

from __future__ import annotations

from math import factorial

import numpy as np

from jaxsr._result import InputError

ACCURACIES = (2, 4, 6, 8)
_CHUNK = 20_000


def finite_difference(
    t: np.ndarray, y: np.ndarray, derivative: int = 1, accuracy: int = 4
) -> np.ndarray:
    """Differentiate through the polynomial of neighbouring samples.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds; need not be uniform.
    y : ndarray, shape (samples,)
        Signal. Missing samples (NaN) are left out of the stencils.
    derivative : int
        1 or 2.
    accuracy : int
        Order of accuracy in the sample time: 2, 4, 6 or 8, up to the ends, where one-sided
        stencils take one point more.

    Returns
    -------
    ndarray, shape (samples,)
        NaN where `y` is missing.

    Raises
    ------
    InputError
        For another derivative or accuracy, or with too few samples.

    References
    ----------
    Fornberg, "Generation of finite difference formulas on arbitrarily spaced grids",
    Math. Comp. 51 (1988); the weights are found here from the moment equations.
    """
    if derivative not in (1, 2) or accuracy not in ACCURACIES:
        raise InputError(
            f"finite difference of derivative {derivative} and accuracy {accuracy}",
            remedy=f"Use derivative 1 or 2 and an accuracy of {ACCURACIES}",
        )
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    present = np.flatnonzero(np.isfinite(y))
    one_sided = derivative + accuracy
    if present.size < one_sided:
        raise InputError(
            f"{present.size} samples, accuracy {accuracy} needs {one_sided}",
            remedy="Use a lower one",
        )
    result = np.full(y.shape, np.nan)
    result[present] = _differentiate(t[present], y[present], derivative, accuracy)
    return result


def _differentiate(t: np.ndarray, y: np.ndarray, derivative: int, accuracy: int) -> np.ndarray:
    n, one_sided = t.size, derivative + accuracy
    dt = np.diff(t)
    uniform = bool(np.ptp(dt) < 1e-6 * np.median(dt))
    # symmetry gives the last power of accuracy on a uniform grid only
    width = accuracy + 1 if uniform else one_sided + (one_sided + 1) % 2
    half = width // 2
    result = np.empty(n)
    inner = np.arange(half, n - half)
    if inner.size and uniform:
        weights = stencil_weights(np.arange(-half, half + 1.0)[None], derivative)[0]
        h = (t[-1] - t[0]) / (n - 1)
        result[inner] = np.convolve(y, weights[::-1], mode="valid") / h**derivative
    elif inner.size:
        for part in np.array_split(inner, -(-inner.size // _CHUNK)):
            result[part] = _apply(t, y, part, part - half, width, derivative)
    ends = np.setdiff1d(np.arange(n), inner)
    start = np.where(ends < n / 2, 0, n - one_sided)
    result[ends] = _apply(t, y, ends, start, one_sided, derivative)
    return result


def _apply(
    t: np.ndarray, y: np.ndarray, at: np.ndarray, start: np.ndarray, width: int, derivative: int
) -> np.ndarray:
    """Derivative at samples `at` from the `width` samples from `start` on."""
    columns = start[:, None] + np.arange(width)
    offsets = t[columns] - t[at, None]
    scale = np.abs(offsets).max(axis=1, keepdims=True)
    weights = stencil_weights(offsets / scale, derivative) / scale**derivative
    return np.einsum("ij,ij->i", weights, y[columns])


def stencil_weights(offsets: np.ndarray, derivative: int) -> np.ndarray:
    """Weights w with sum_j w_j f(x + offset_j) = f^(derivative)(x) for polynomials.

    Parameters
    ----------
    offsets : ndarray, shape (rows, width)
        Distances to the point of evaluation, scaled to about 1.
    derivative : int

    Returns
    -------
    ndarray, shape (rows, width)
    """
    width = offsets.shape[1]
    moments = offsets[:, None, :] ** np.arange(width)[None, :, None]
    wanted = np.zeros((offsets.shape[0], width, 1))
    wanted[:, derivative] = factorial(derivative)
    return np.linalg.solve(moments, wanted)[..., 0]
