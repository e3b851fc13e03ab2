"""Smoothing and derivatives by local polynomial fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre

from jaxsr._result import InputError
from jaxsr.recordings.noise import noise_level

DEGREES = (2, 4, 6)
_CHUNK = 2_000_000  # weights made at once
_CENTRES = 400  # points at which a window is judged on a non-uniform grid
_GROWTH = 1.3  # ratio of neighbouring windows tried


@dataclass(frozen=True)
class LocalFit:
    """A window in samples (odd), a degree, and the error they are expected to leave.

    `error` is the root mean square of noise and bias of the derivative they were chosen for.
    """

    window: int
    degree: int
    error: float = np.nan


def savitzky_golay(
    t: np.ndarray,
    y: np.ndarray,
    derivative: int = 1,
    window: int | None = None,
    degree: int | None = None,
    noise: float | None = None,
) -> np.ndarray:
    """Smooth or differentiate by a polynomial fitted around every sample.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds; need not be uniform.
    y : ndarray, shape (samples,)
        Signal. Missing samples (NaN) are left out of the fits and filled by them, except in gaps
        longer than half a window.
    derivative : int
        0, 1 or 2.
    window : int, optional
        Samples in a fit, odd and greater than `degree`. By default the balance of noise and bias
        (`choose_fit`).
    degree : int, optional
        Degree of the polynomial, at least `derivative`; chosen with the window by default.
    noise : float, optional
        Standard deviation of the noise for that choice; `noise_level` by default.

    Returns
    -------
    ndarray, shape (samples,)

    Raises
    ------
    InputError
        If the window is even, too small for the degree or longer than the record.

    References
    ----------
    Savitzky and Golay, Analytical Chemistry 36 (1964).
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if window is None:
        fit = choose_fit(t, y, derivative, degree=degree, noise=noise)
    else:
        fit = LocalFit(window, max(2, derivative) if degree is None else degree)
    return local_fit(t, y, fit, (derivative,))[0]


def smooth_states(
    t: np.ndarray, q: np.ndarray, noise: float | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate position, velocity and acceleration from one local quartic fit.

    The window is the best one for the acceleration, the hardest of the three.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds.
    q : ndarray, shape (samples,)
        Measured position; NaN where missing.
    noise : float, optional
        Standard deviation of its noise; `noise_level` by default.

    Returns
    -------
    q_hat, v_hat, a_hat : ndarray, shape (samples,)
    """
    t, q = np.asarray(t, dtype=np.float64), np.asarray(q, dtype=np.float64)
    fit = choose_fit(t, q, derivative=2, degree=4, noise=noise)
    position, velocity, acceleration = local_fit(t, q, fit, (0, 1, 2))
    return position, velocity, acceleration


def choose_fit(
    t: np.ndarray,
    y: np.ndarray,
    derivative: int,
    degree: int | None = None,
    noise: float | None = None,
) -> LocalFit:
    r"""Choose window and degree by the balance of noise and bias.

    A fit with weights c leaves noise of variance noise^2 sum(c^2). Its squared bias is taken from
    the difference to the fit of degree + 2 in the same window,
    mean((c - c') y)^2 - noise^2 sum((c - c')^2), not below zero. The sum is minimised.

    Parameters
    ----------
    t, y : ndarray, shape (samples,)
    derivative : int
        The derivative whose error counts.
    degree : int, optional
        Tried are `DEGREES` by default.
    noise : float, optional
        Standard deviation; `noise_level` by default.

    Returns
    -------
    LocalFit
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    known = np.isfinite(y)
    times, values = t[known], y[known]
    if times.size < derivative + 2:
        raise InputError(
            f"{times.size} samples are too few for derivative {derivative}",
            remedy=f"Give at least {derivative + 2}",
        )
    noise = noise_level(times, values) if noise is None else noise
    judge = _judge_uniform if _is_uniform(times) else _judge_any
    degrees = DEGREES if degree is None else (degree,)
    best = LocalFit(0, 0, np.inf)
    for p in degrees:
        floor = 0.0  # bias that a shorter window has shown for certain
        for window in _windows(p, times.size) if p >= derivative else []:
            gain, bias, doubt = judge(times, values, LocalFit(window, p), derivative, noise)
            floor = max(floor, bias - doubt)
            error = float(np.sqrt(noise**2 * gain + max(bias, floor)))
            if error < best.error:
                best = LocalFit(window, p, error)
            if floor > 10.0 * best.error**2:
                break
    if best.window == 0:
        p = max(derivative, degrees[0])
        window = min(p + 1 + p % 2, times.size - 1 + times.size % 2)
        best = LocalFit(window, min(p, window - 1))
    return best


def local_fit(
    t: np.ndarray, y: np.ndarray, fit: LocalFit, derivatives: Sequence[int]
) -> list[np.ndarray]:
    """Evaluate derivatives of the polynomials fitted around every sample.

    Parameters
    ----------
    t, y : ndarray, shape (samples,)
    fit : LocalFit
    derivatives : sequence of int

    Returns
    -------
    list of ndarray, shape (samples,)
        One for each derivative.
    """
    known = np.isfinite(y)
    times, values = t[known], y[known]
    _check(fit, max(derivatives), times.size)
    if known.all() and _is_uniform(t):
        return _uniform_fit(t, y, fit, derivatives)
    result = [np.full(t.size, np.nan) for _ in derivatives]
    near = np.flatnonzero(_within_reach(t, times, fit.window))
    for part in np.array_split(near, max(1, -(-near.size * fit.window // _CHUNK))):
        weights, columns = _weights(times, t[part], fit, derivatives)
        for out, weight in zip(result, weights, strict=True):
            out[part] = np.einsum("ij,ij->i", weight, values[columns])
    return result


def _uniform_fit(
    t: np.ndarray, y: np.ndarray, fit: LocalFit, derivatives: Sequence[int]
) -> list[np.ndarray]:
    """One set of weights slides over the inside; samples near an end share its window."""
    half, window = fit.window // 2, fit.window
    h = (t[-1] - t[0]) / (t.size - 1)
    inner = _centre_weights(fit, h, derivatives)
    first = _in_one_window(y[:window], h, np.arange(half), fit, derivatives)
    last = _in_one_window(y[-window:], h, np.arange(half + 1, window), fit, derivatives)
    middles = [np.convolve(y, weight[::-1], mode="valid") for weight in inner]
    return [np.concatenate(parts) for parts in zip(first, middles, last, strict=True)]


def _in_one_window(
    values: np.ndarray, h: float, at: np.ndarray, fit: LocalFit, derivatives: Sequence[int]
) -> list[np.ndarray]:
    """Derivatives of the polynomial fitted to one uniform window, at samples of it."""
    scale = h * (fit.window - 1) / 2.0
    places = np.linspace(-1.0, 1.0, fit.window)
    basis = legendre.legvander(places, fit.degree)
    coefficients = _solved((basis.T @ basis)[None], (basis.T @ values)[None])[0]
    return [
        legendre.legval(places[at], legendre.legder(coefficients, d)) / scale**d
        for d in derivatives
    ]


def _check(fit: LocalFit, derivative: int, samples: int) -> None:
    if fit.window % 2 == 0 or fit.window <= fit.degree:
        good = fit.degree + 1 + fit.degree % 2
        raise InputError(
            f"`window` must be odd and greater than `degree`={fit.degree}, got {fit.window}",
            remedy=f"Try window={good}",
        )
    if fit.window > samples:
        raise InputError(f"window={fit.window} is longer than the {samples} samples")
    if not 0 <= derivative <= fit.degree:
        raise InputError(f"derivative {derivative} of a polynomial of degree {fit.degree}")


def _is_uniform(t: np.ndarray) -> bool:
    """Whether every time lies within a thousandth of an interval of a uniform grid."""
    grid = np.linspace(t[0], t[-1], t.size)
    return bool(np.max(np.abs(t - grid)) <= 1e-3 * (t[-1] - t[0]) / (t.size - 1))


def _windows(degree: int, samples: int) -> list[int]:
    """Odd windows, growing geometrically, that can tell `degree` from `degree` + 2."""
    longest = max(samples // 2, degree + 5)
    windows, size = [], float(degree + 4 + (degree + 1) % 2)
    while size <= min(longest, samples):
        windows.append(int(size) // 2 * 2 + 1)
        size = max(size * _GROWTH, size + 2.0)
    return [w for w in windows if w <= samples]


Judgement = tuple[float, float, float]  # gain on noise variance; squared bias; its doubt


def _judge_uniform(
    t: np.ndarray, y: np.ndarray, fit: LocalFit, derivative: int, noise: float
) -> Judgement:
    h = (t[-1] - t[0]) / (t.size - 1)
    (low,) = _centre_weights(fit, h, (derivative,))
    (high,) = _centre_weights(LocalFit(fit.window, fit.degree + 2), h, (derivative,))
    apart = np.convolve(y, (low - high)[::-1], mode="valid")
    expected = noise**2 * float(np.sum((low - high) ** 2))
    return float(np.sum(low**2)), *_bias(apart, expected, y.size / fit.window)


def _judge_any(
    t: np.ndarray, y: np.ndarray, fit: LocalFit, derivative: int, noise: float
) -> Judgement:
    half = fit.window // 2
    inner = np.arange(half, t.size - half)
    inner = inner[:: max(1, inner.size // _CENTRES)]
    windows = _Windows.about(t, t[inner], LocalFit(fit.window, fit.degree + 2))
    low, high = (windows.weights(p, derivative) for p in (fit.degree, fit.degree + 2))
    difference = low - high
    # on an irregular grid a few dense places dominate the mean: compare place by place
    gains = np.sum(low**2, axis=1)
    expected = noise**2 * np.sum(difference**2, axis=1)
    apart = np.einsum("ij,ij->i", difference, y[windows.columns])
    places = min(inner.size, t.size / fit.window)
    bias = float(np.mean(apart**2 - expected))
    doubt = 3.0 * float(np.sqrt(2.0 * np.mean(expected**2) / places))
    return float(np.mean(gains)), max(bias, 0.0), doubt


def _bias(apart: np.ndarray, expected: float, places: float) -> tuple[float, float]:
    """Squared bias and its doubt: three standard errors of the mean over independent places."""
    bias = float(np.mean(apart**2)) - expected
    return max(bias, 0.0), 3.0 * expected * float(np.sqrt(2.0 / places))


def _centre_weights(fit: LocalFit, h: float, derivatives: Sequence[int]) -> list[np.ndarray]:
    """Weights for the middle of a uniform window."""
    return [_middle_weights(fit.window, fit.degree, d) / h**d for d in derivatives]


@lru_cache(maxsize=1024)
def _middle_weights(window: int, degree: int, derivative: int) -> np.ndarray:
    """Weights for the middle of a window of unit steps: sensors and windows are asked again."""
    times = np.arange(float(window))
    weights, _ = _weights(times, times[[window // 2]], LocalFit(window, degree), (derivative,))
    return weights[0][0]


def _within_reach(t: np.ndarray, times: np.ndarray, window: int) -> np.ndarray:
    """Times no further than half a window from the nearest present sample."""
    place = np.clip(np.searchsorted(times, t), 1, times.size - 1)
    nearest = np.minimum(np.abs(t - times[place - 1]), np.abs(t - times[place]))
    return nearest <= 0.25 * window * np.median(np.diff(times))


def _weights(
    times: np.ndarray, at: np.ndarray, fit: LocalFit, derivatives: Sequence[int]
) -> tuple[list[np.ndarray], np.ndarray]:
    """Weights of the samples `columns` in the derivatives at the times `at`."""
    windows = _Windows.about(times, at, fit)
    return [windows.weights(fit.degree, d) for d in derivatives], windows.columns


@dataclass(frozen=True)
class _Windows:
    """Windows of samples and the Legendre polynomials over each.

    Not powers (as in scipy.signal.savgol_coeffs), with which a window of 53 samples and degree 8
    has already lost two digits of the bias.

    Attributes
    ----------
    columns : ndarray of int, shape (windows, samples of one)
    basis : ndarray, shape (windows, samples of one, polynomials)
    gram : ndarray, shape (windows, polynomials, polynomials)
        Of a lower degree it is the corner.
    point, scale : ndarray, shape (windows,)
        Where in each the fit is evaluated, between -1 and 1, and half its length in seconds.
    """

    columns: np.ndarray
    basis: np.ndarray
    gram: np.ndarray
    point: np.ndarray
    scale: np.ndarray

    @classmethod
    def about(cls, times: np.ndarray, at: np.ndarray, fit: LocalFit) -> _Windows:
        """Return the windows about the times `at`, for the degree of `fit` and those below."""
        nearest = np.clip(np.searchsorted(times, at), 0, times.size - 1)
        start = np.clip(nearest - fit.window // 2, 0, times.size - fit.window)
        columns = start[:, None] + np.arange(fit.window)
        local = times[columns]
        centre = (local[:, 0] + local[:, -1]) / 2.0
        scale = (local[:, -1] - local[:, 0]) / 2.0
        basis = legendre.legvander((local - centre[:, None]) / scale[:, None], fit.degree)
        gram = basis.swapaxes(1, 2) @ basis
        return cls(columns, basis, gram, (at - centre) / scale, scale)

    def weights(self, degree: int, derivative: int) -> np.ndarray:
        """Return the weights of the samples, shape (windows, samples of one)."""
        form = legendre.legder(np.eye(degree + 1), derivative)
        rows = legendre.legval(self.point, form).T
        solved = _solved(self.gram[:, : degree + 1, : degree + 1], rows)
        weights = (self.basis[:, :, : degree + 1] @ solved[..., None])[..., 0]
        return weights / self.scale[:, None] ** derivative


def _solved(gram: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Solve the normal equations; the least solution where samples lie in too few places.

    A window across a pause holds two clusters of samples, which tell no polynomial of its degree.
    """
    try:
        return np.linalg.solve(gram, rows[..., None])[..., 0]
    except np.linalg.LinAlgError:
        return (np.linalg.pinv(gram, rcond=1e-12, hermitian=True) @ rows[..., None])[..., 0]
