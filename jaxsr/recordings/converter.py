r"""Steps of a converter as noise: how large, how correlated, and how much readings tell.

A reading y of a signal h in steps of q (encoder, ADC, digits of a file) has the error y - h,
uniform over one step where the motion does not know the grid: variance :math:`q^2/12` (Bennett).
Two readings whose true values lie d apart have errors of the correlation

.. math:: \rho(d) = 6 \delta^2 - 6 \delta + 1, \qquad \delta = d/q - \lfloor d/q \rfloor,

the autocovariance :math:`(q^2/2) B_2(\delta)` of a sawtooth of random phase over its variance
(Sripad & Snyder's joint characteristic function, with a known difference). It is zero on average
over a step, but near 1 for readings of the same step: where the motion is slower than a step a
sample, these repeat one error, and together tell no more than one reading.

References
----------
Bennett, "Spectra of quantized signals", Bell System Technical Journal 27 (1948).
Sripad & Snyder, "A necessary and sufficient condition for quantization errors to be uniform and
white", IEEE Transactions on Acoustics, Speech and Signal Processing 25 (1977).
Widrow & Kollar, Quantization Noise (2008), chapters 4, 9 and 17 (noise before the steps).
"""

from __future__ import annotations

import numpy as np


def uniform_variance(step: float) -> float:
    """Return the variance q^2/12 of the error of one reading, in the square of its unit."""
    return step**2 / 12.0


def step_correlation(
    difference: float | np.ndarray, step: float, noise: float = 0.0, terms: int = 50
) -> np.ndarray:
    r"""Return the correlation of the errors of two readings, by how far apart their values are.

    With independent Gaussian noise of deviation s ahead of the converter, every harmonic k of
    the sawtooth loses :math:`\exp(-4 \pi^2 k^2 s^2 / q^2)`: noise of half a step whitens it.

    Parameters
    ----------
    difference : float or ndarray
        Between the true values, in the unit of the reading.
    step : float
    noise : float
        Standard deviation ahead of the converter, in the same unit. 0: the closed form.
    terms : int
        Harmonics that are added up where there is noise.
    """
    share = np.asarray(difference, dtype=float) / step
    if noise == 0.0:
        share = share - np.floor(share)
        return 6.0 * share * (share - 1.0) + 1.0
    k = np.arange(1, terms + 1)
    weights = np.exp(-((2.0 * np.pi * k * noise / step) ** 2)) / k**2
    return (6.0 / np.pi**2) * np.cos(2.0 * np.pi * np.multiply.outer(share, k)) @ weights


def step_variance(samples: np.ndarray, step: float) -> np.ndarray:
    """Return the variance of every reading, as if their errors were independent.

    Each of the m neighbouring readings on one level gets m q^2/12: together they weigh as one.

    Parameters
    ----------
    samples : ndarray, shape (samples,)
        Readings in their order; NaN where missing.
    step : float

    Returns
    -------
    ndarray, shape (samples,)
        In the square of the readings' unit; NaN where missing.
    """
    samples = np.asarray(samples, dtype=float)
    seen = np.isfinite(samples)
    run = _runs(samples[seen], step)
    variance = np.full(samples.shape, np.nan)
    variance[seen] = uniform_variance(step) * np.bincount(run)[run] if run.size else 0.0
    return variance


def effective_samples(samples: np.ndarray, step: float) -> int:
    """Return how many independent readings a recording of a converter holds: its runs on a level.

    That is the sum of (q^2/12) / `step_variance`. Noise wider than a step, or motion of a step
    a sample, makes every reading a run of its own.

    Parameters
    ----------
    samples : ndarray, shape (samples,)
        Readings in their order; NaN where missing.
    step : float
    """
    run = _runs(np.asarray(samples, dtype=float)[np.isfinite(samples)], step)
    return int(run[-1]) + 1 if run.size else 0


def _runs(samples: np.ndarray, step: float) -> np.ndarray:
    """Number the runs of neighbouring readings on one level."""
    if not samples.size:
        return np.zeros(0, dtype=int)
    return np.concatenate([[0], np.cumsum(np.abs(np.diff(samples)) > 0.5 * step)])
