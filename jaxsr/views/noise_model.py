"""Noise that grows with the signal: its standard deviation at every sample."""

from __future__ import annotations

import numpy as np

from jaxsr.recordings.noise import noise_level
from jaxsr.views.tikhonov import fit_adaptive

SHARES = (0.25, 0.5, 0.75, 0.9)  # of the mean variance that is proportional to the signal squared
_LESS = 0.85  # differences of the residual show less noise than its size: there is signal left
_CERTAIN = 4.0  # gain in log likelihood that a share above zero must bring


def noise_by_sample(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    r"""Estimate the standard deviation of the noise at every sample.

    The residuals r of an adaptive spline x of order 3 are given the variance

        v_i = s^2 (1 - p + p x_i^2 / mean(x^2)),

    with the share p of noise proportional to the signal from `SHARES`. It is taken above zero only
    if the normal likelihood of r gains more than 4 in the logarithm. A floor of a tenth of the
    variance stays, because weights that trust samples near zero without limit make the fit
    follow them. s is set so that the mean variance is that of r, divided by 1 - df / n. If
    p = 0 and `noise_level` finds clearly less in r, that is taken: x could not follow a step.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds.
    y : ndarray, shape (samples,)
        NaN where missing.

    Returns
    -------
    ndarray, shape (samples,)
        In the unit of `y`; constant if the noise shows no such growth. Positive.
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    present = np.isfinite(y)
    fit = fit_adaptive(t, y, orders=(3,))
    x = fit.spline(t)
    rest = (y - x)[present]
    count = rest.size
    square = x**2 / (float(np.mean(x[present] ** 2)) or 1.0)
    best, chosen = np.inf, np.ones(y.shape)
    for share in (0.0, *SHARES):
        shape = 1.0 - share + share * square
        scale = float(np.mean(rest**2 / shape[present]))
        if not scale > 0.0:
            break
        lost = 0.5 * (count * np.log(scale) + np.sum(np.log(shape[present])))
        if share == 0.0 or lost < best - (_CERTAIN if np.all(chosen == 1.0) else 0.0):
            best, chosen = lost, shape
    left = max(1.0 - fit.freedom / count, 0.05)
    size = float(np.sqrt(np.mean(rest**2 / chosen[present]) / left))
    if np.all(chosen == 1.0):
        alone = noise_level(t[present], rest)
        size = alone if alone < _LESS * size else size
    return np.sqrt(chosen) * (size or noise_level(t, y) or 1.0)
