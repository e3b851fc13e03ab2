"""Lag between channels that measure the same motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from jaxsr._deadline import ask
from jaxsr.recordings.noise import noise_level

_ALIKE = 0.97  # correlation at the best lag that makes one channel the rate of another
_SCALE = (0.8, 1.25)  # a rate has the scale of the derivative; a proportional channel has not
_FURTHEST = 20  # samples
_BLOCKS = 8
_SIGNIFICANT = 5.0  # standard errors over the blocks
_SMALLEST = 0.1  # sample times
_MAX_SAMPLES = 20_000


@dataclass(frozen=True)
class Lag:
    """The channel `rate` measures d(`of`)/dt, late by `seconds` (early if negative)."""

    of: str
    rate: str
    seconds: float
    uncertainty: float


def find_lags(time: np.ndarray, channels: Mapping[str, np.ndarray]) -> list[Lag]:
    """Find pairs of a position and its rate, and the significant lags between them.

    The derivative of the one, by differences over an interval that suits its noise, and the same
    average of the other are correlated for the whole samples; the rest follows from a
    fit of b = scale * (a - lag * da/dt), its standard error from leaving out one eighth of the
    record at a time.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        In seconds. Only nearly uniform records are judged.
    channels : mapping of str to ndarray, shape (samples,)
        NaN where missing; a channel with more than a tenth missing is left out.

    Returns
    -------
    list of Lag
        Those of at least a tenth of a sample time and five standard errors.
    """
    dt = np.diff(time)
    median = float(np.median(dt))
    if time.size < 25 * _BLOCKS or np.max(np.abs(dt - median)) > 0.5 * median:
        return []
    grid = time[0] + median * np.arange(min(int((time[-1] - time[0]) / median), _MAX_SAMPLES))
    signals = {}
    for name, y in channels.items():
        known = np.isfinite(y)
        if np.mean(known) > 0.9 and np.ptp(y[known]) > 0.0:
            signals[name] = np.interp(grid, time[known], y[known])
    noise = {name: noise_level(grid, y) for name, y in signals.items()}
    lags = []
    for of, position in signals.items():
        for rate, speed in signals.items():
            if of == rate:
                continue
            lag = _lag_between(position, speed, median, noise[of])
            if lag is not None:
                lags.append(Lag(of, rate, *lag))
    return lags


def _lag_between(
    position: np.ndarray, speed: np.ndarray, dt: float, noise: float
) -> tuple[float, float] | None:
    ask()
    spread = float(np.std(speed))
    # long enough that noise is a tenth of the speed, and no longer
    half = int(np.clip(np.ceil(7.0 * noise / (spread * dt)), 1, 10))
    slope = (position[2 * half :] - position[: -2 * half]) / (2.0 * half * dt)
    # the mean of the rate over the same interval, by the trapezoid rule
    kernel = np.ones(2 * half + 1)
    kernel[[0, -1]] = 0.5
    mean = np.convolve(speed, kernel / (2.0 * half), mode="valid")
    start = _coarse_lag(slope, mean)
    if start is None or start[1] < _ALIKE:
        return None
    whole_samples = start[0]
    a = slope[max(-whole_samples, 0) : slope.size - max(whole_samples, 0)]
    b = mean[max(whole_samples, 0) : mean.size + min(whole_samples, 0)]
    fine, error, scale = _fine_lag(a, b)
    lag = whole_samples + fine
    if not _SCALE[0] < scale < _SCALE[1]:
        return None
    if abs(lag) < max(_SIGNIFICANT * error, _SMALLEST):
        return None
    return lag * dt, error * dt


def _coarse_lag(a: np.ndarray, b: np.ndarray) -> tuple[int, float] | None:
    """Whole samples by which b follows a, and the correlation there."""
    reach = min(_FURTHEST, a.size // 4)
    inner = a[reach : a.size - reach] - a[reach : a.size - reach].mean()
    windows = sliding_window_view(b, inner.size)
    # sums by prefix, so that windows are never copied
    total = np.concatenate([[0.0], np.cumsum(b - b.mean())])
    square = np.concatenate([[0.0], np.cumsum((b - b.mean()) ** 2)])
    size = inner.size
    variance = square[size:] - square[:-size] - (total[size:] - total[:-size]) ** 2 / size
    norm = np.linalg.norm(inner) * np.sqrt(np.maximum(variance, 0.0))
    if np.any(norm <= 0.0):
        return None
    alike = windows @ inner / norm
    top = int(np.argmax(alike))
    if top in (0, alike.size - 1):
        return None
    return top - reach, float(alike[top])


def _fine_lag(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Remaining lag of b behind a in samples, its standard error, and the scale b / a.

    To first order b = scale * (a - lag * da). The noise of da would draw a least-squares estimate
    to zero; b's own differences, whose noise is another, serve as instrument. Leaving out one
    block of samples at a time gives the error.
    """
    centre = np.ones(a.size - 2)
    columns = np.stack([centre, a[1:-1], (a[2:] - a[:-2]) / 2.0], axis=1)
    instruments = np.stack([centre, a[1:-1], (b[2:] - b[:-2]) / 2.0], axis=1)
    target = b[1:-1]
    grams, sides = [], []
    for part in np.array_split(np.arange(target.size), _BLOCKS):
        grams.append(instruments[part].T @ columns[part])
        sides.append(instruments[part].T @ target[part])
    gram, side = np.sum(grams, axis=0), np.sum(sides, axis=0)

    def solve(gram: np.ndarray, side: np.ndarray) -> tuple[float, float]:
        _, scale, moved = np.linalg.lstsq(gram, side, rcond=None)[0]
        return (-float(moved / scale) if scale else np.inf), float(scale)

    lag, scale = solve(gram, side)
    without = [solve(gram - g, side - s)[0] for g, s in zip(grams, sides, strict=True)]
    error = np.sqrt((_BLOCKS - 1) * np.mean((np.array(without) - lag) ** 2))
    return lag, float(error), scale
