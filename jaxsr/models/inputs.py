"""Inputs between samples: held, linear, or band-limited."""

from __future__ import annotations

import numpy as np

from jaxsr._result import InputError
from jaxsr.models.model import Hold


def fill_missing(time: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Fill missing input samples along straight lines; an input must be known everywhere."""
    missing = ~np.isfinite(u)
    if not missing.any():
        return u
    return np.interp(time, time[~missing], u[~missing])


def stage_inputs(
    time: np.ndarray, u: np.ndarray, hold: Hold, substeps: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the input at start, middle and end of every substep.

    Parameters
    ----------
    time : ndarray, shape (samples,)
    u : ndarray, shape (samples,)
    hold : {"linear", "zero", "bandlimited"}
    substeps : int
        Steps between two samples.

    Returns
    -------
    three ndarrays, shape (samples - 1, substeps)

    Notes
    -----
    Band-limited means the signal whose spectrum ends at half the sampling rate: upsampling by
    the Fourier method, the record mirrored oddly about its ends so that it may start and end
    anywhere.
    """
    samples = time.size
    fractions = np.arange(2 * substeps + 1) / (2 * substeps)
    if hold == "zero":
        fine = np.repeat(u[:-1, None], fractions.size, axis=1)
    elif hold == "linear":
        fine = u[:-1, None] + (u[1:] - u[:-1])[:, None] * fractions
    else:
        steps = np.diff(time)
        if np.ptp(steps) > 0.05 * np.median(steps):
            raise InputError("input_hold 'bandlimited' needs uniform time", remedy="Use 'linear'")
        pad = min(samples - 1, 512)
        before = 2 * u[0] - u[pad:0:-1]
        after = 2 * u[-1] - u[-2 : -2 - pad : -1]
        extended = np.concatenate([before, u, after])
        size = extended.size
        # Resample needs a periodic record: the trend between its ends is put back afterwards.
        trend = np.linspace(extended[0], extended[-1], size)
        factor = 2 * substeps
        from scipy.signal import resample  # slow to load, and rarely asked for

        dense = np.asarray(resample(extended - trend, size * factor))
        grid = np.arange(size * factor) / factor
        dense = dense + np.interp(grid, np.arange(size), trend)
        start = pad * factor
        index = start + np.arange(samples - 1)[:, None] * factor + np.arange(factor + 1)
        fine = dense[np.minimum(index, dense.size - 1)]
    return fine[:, :-1:2], fine[:, 1::2], fine[:, 2::2]
