"""The smoothing view: one entry to the methods, chosen from the data by default."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from jaxsr._result import InputError
from jaxsr.recordings.noise import noise_level
from jaxsr.views.gaps import fill, reachable
from jaxsr.views.noise_model import noise_by_sample
from jaxsr.views.penalised import gcv
from jaxsr.views.savitzky_golay import LocalFit, choose_fit, local_fit, savitzky_golay
from jaxsr.views.tikhonov import fit_adaptive, tikhonov
from jaxsr.views.total_variation import total_variation, total_variation_score

if TYPE_CHECKING:
    from jaxtyping import Float

CLEAN = 1e-6  # noise next to the signal's standard deviation up to which nothing is changed
VARIATIONS = (0, 1, 2)  # derivatives whose total variation is tried
_FEWEST = 8  # samples; fewer come back as they are

Noise = float | np.ndarray | None


class Smoother(Protocol):
    """One method: samples and noise in, the smoothed signal at every time out."""

    def __call__(
        self,
        t: Float[np.ndarray, " samples"],
        y: Float[np.ndarray, " samples *columns"],
        noise: Noise,
        **config: Any,
    ) -> Float[np.ndarray, " samples *columns"]: ...


def smooth(
    t: Float[np.ndarray, " samples"],
    y: Float[np.ndarray, " samples *columns"],
    method: str = "auto",
    noise: Noise = None,
    **config: Any,
) -> Float[np.ndarray, " samples *columns"]:
    """Smooth a signal or the columns of an array.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds; need not be uniform.
    y : ndarray, shape (samples,) or (samples, columns)
        NaN where missing.
    method : str
        A key of `SMOOTHERS`, or "auto", which decides for every column by itself
        (`choose_smoother`).
    noise : float or ndarray of the shape of `y`, optional
        Standard deviation of the noise, for each sample if it varies. Estimated by default, with
        a share that grows with the signal if there is one (`noise_by_sample`).
    **config
        Passed on to the method.

    Returns
    -------
    ndarray, of the shape of `y`
        Missing samples are filled where the nearest samples on both sides are at most four
        intervals apart (95th percentile), and stay NaN in longer gaps and beyond the ends. Clean
        data come back unchanged, filled by a cubic spline, under "auto".

    Raises
    ------
    InputError
        For an unknown method, and what the method raises.
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if y.ndim == 2:
        noises: list[Noise] = [noise] * y.shape[1]
        if isinstance(noise, np.ndarray) and noise.ndim == 2:
            noises = list(noise.T)
        columns = [smooth(t, c, method, s, **config) for c, s in zip(y.T, noises, strict=True)]
        return np.stack(columns, axis=1)
    if method == "auto":
        if _is_clean(t, y, noise):
            return fill(t, y)
        noise = noise_by_sample(t, y) if noise is None else noise
        method = choose_smoother(t, y, noise)
    if method not in SMOOTHERS:
        raise InputError(f"unknown smoother '{method}'", remedy=f"Use auto, {', '.join(SMOOTHERS)}")
    result = np.array(SMOOTHERS[method](t, y, noise, **config))
    result[~reachable(t, np.isfinite(y))] = np.nan
    return result


def choose_smoother(t: np.ndarray, y: np.ndarray, noise: Noise = None) -> str:
    """Name the method of the least generalised cross-validation score for one noisy signal.

    The score, rss / (n - 1.2 df)^2 with the residuals divided by the noise, estimates the error
    in samples that were not seen; df counts what a method fits: the trace of its matrix, or the
    jumps of total variation.

    Parameters
    ----------
    t, y : ndarray, shape (samples,)
    noise : float or ndarray, optional
        As for `smooth`.

    Returns
    -------
    str
        A key of `SMOOTHERS`.
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    noise = noise_by_sample(t, y) if noise is None else noise
    scores = {
        "adaptive_spline": fit_adaptive(t, y, noise=noise).score,
        "savitzky_golay": _local_score(t, y, noise),
        "total_variation": min(total_variation_score(t, y, noise, k) for k in VARIATIONS),
    }
    return min(scores, key=lambda name: scores[name])


def _is_clean(t: np.ndarray, y: np.ndarray, noise: Noise) -> bool:
    known = y[np.isfinite(y)]
    if known.size < _FEWEST or np.ptp(known) == 0.0:
        return True
    level = noise_level(t, y) if noise is None else float(np.sqrt(np.mean(np.square(noise))))
    return level <= CLEAN * float(np.std(known))


def _weights(y: np.ndarray, noise: Noise) -> np.ndarray:
    """Weights of mean 1, for present samples."""
    sigma = np.broadcast_to(np.asarray(1.0 if noise is None else noise), y.shape)[np.isfinite(y)]
    relative = (np.min(sigma) / sigma) ** 2
    return relative / np.mean(relative)


def _level(noise: Noise) -> float | None:
    return None if noise is None else float(np.sqrt(np.mean(np.square(noise))))


def _local_score(t: np.ndarray, y: np.ndarray, noise: Noise) -> float:
    fit = choose_fit(t, y, 0, noise=_level(noise))
    rest = (y - local_fit(t, y, fit, (0,))[0])[np.isfinite(y)]
    return gcv(float(np.mean(_weights(y, noise) * rest**2)), _local_freedom(t, y, fit), rest.size)


def _local_freedom(t: np.ndarray, y: np.ndarray, fit: LocalFit) -> float:
    """Trace of the local fits' matrix, from its answers to impulses a window apart."""
    times = t[np.isfinite(y)]
    combs = [np.arange(start, times.size, fit.window) for start in (0, fit.window // 2)]
    own = []
    for comb in combs:
        impulses = np.zeros(times.size)
        impulses[comb] = 1.0
        own.append(local_fit(times, impulses, fit, (0,))[0][comb])
    return float(times.size * np.mean(np.concatenate(own)))


def _savitzky_golay(t: np.ndarray, y: np.ndarray, noise: Noise, **config: Any) -> np.ndarray:
    return savitzky_golay(t, y, 0, noise=_level(noise), **config)


def _tikhonov(t: np.ndarray, y: np.ndarray, noise: Noise, **config: Any) -> np.ndarray:
    noise = noise_by_sample(t, y) if noise is None else noise
    return tikhonov(t, y, 0, noise=noise, **config)


def _adaptive(t: np.ndarray, y: np.ndarray, noise: Noise, **config: Any) -> np.ndarray:
    noise = noise_by_sample(t, y) if noise is None else noise
    return fit_adaptive(t, y, noise=noise, **config).spline(t)


def _total_variation(t: np.ndarray, y: np.ndarray, noise: Noise, **config: Any) -> np.ndarray:
    noise = noise_by_sample(t, y) if noise is None else noise
    if "order" not in config:
        scores = [total_variation_score(t, y, noise, k) for k in VARIATIONS]
        config = config | {"order": VARIATIONS[int(np.argmin(scores))]}
    return total_variation(t, y, 0, noise=noise, **config)


SMOOTHERS: Mapping[str, Smoother] = {
    "savitzky_golay": _savitzky_golay,
    "tikhonov": _tikhonov,
    "adaptive_spline": _adaptive,
    "total_variation": _total_variation,
}
