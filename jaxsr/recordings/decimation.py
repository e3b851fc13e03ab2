"""Recordings with fewer samples: every so many sensor readings, and inputs that act the same."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np
import scipy.linalg

from jaxsr.recordings.noise import quantisation_step
from jaxsr.recordings.recording import Recording

WHITE = 0.2
"""Correlation of neighbouring residuals up to which noise is white, and averaging it lowers it."""
UNIFORM = 1e-3
"""Departure of sample intervals from their median, relative to it, that counts as none."""


def decimated(recording: Recording, factor: int, inputs: Mapping[str, str]) -> Recording:
    """Return a recording with one in `factor` samples, for motions far slower than its samples.

    A sensor's reading is a parabola's value through the `factor` readings around it, where its
    noise is white and no converter's step shows; elsewhere it is the reading itself, so that what
    a sensor does (steps, limits, a filter of its own) stays what it is. An input keeps its
    integral against whatever changes slowly: a held one becomes its means, one that is drawn in
    straight lines becomes the nearest such lines (least squares). Neither is shifted in time.

    Parameters
    ----------
    recording : Recording
        Sampled uniformly, without missing inputs.
    factor : int
        Samples that become one.
    inputs : mapping
        Channel of an input to what it does between samples, "linear" or "zero"; all others are
        sensors.

    Returns
    -------
    Recording
        With times of the original.
    """
    if factor <= 1:
        return recording
    kept = np.arange(0, len(recording), factor)
    channels = {}
    for name, values in recording.channels.items():
        hold = inputs.get(name)
        if hold == "zero":
            channels[name] = _means(values, kept, factor)
        elif hold == "linear":
            channels[name] = _lines(values, kept, factor)
        else:
            channels[name] = _readings(values, kept, factor)
    return replace(recording, time=recording.time[kept], channels=channels)


def is_uniform(recording: Recording, complete: Collection[str]) -> bool:
    """Whether a recording has one sample interval, and no missing sample of some channels."""
    steps = np.diff(recording.time)
    typical = float(np.median(steps))
    if np.abs(steps - typical).max() > UNIFORM * typical:
        return False
    return all(np.isfinite(recording.channels[n]).all() for n in complete)


def _means(values: np.ndarray, kept: np.ndarray, factor: int) -> np.ndarray:
    """Means of a held input from each kept sample to the next."""
    sums = np.add.reduceat(values, kept)
    return sums / np.minimum(factor, values.size - kept)


def _lines(values: np.ndarray, kept: np.ndarray, factor: int) -> np.ndarray:
    """Knots of the straight lines that come nearest to an input, in the sum of squares."""
    place = np.arange(kept[-1] + 1)  # behind the last knot no line is drawn
    values, left = values[place], np.minimum(place // factor, max(kept.size - 2, 0))
    share, right = (place - kept[left]) / factor, np.minimum(left + 1, kept.size - 1)
    # normal equations of hat functions: three diagonals
    centre = np.bincount(left, (1 - share) ** 2, kept.size)
    centre += np.bincount(right, share**2, kept.size)
    beside = np.bincount(left, share * (1 - share), kept.size)[:-1]
    moment = np.bincount(left, (1 - share) * values, kept.size)
    moment += np.bincount(right, share * values, kept.size)
    banded = np.zeros((2, kept.size))
    banded[0, 1:], banded[1] = beside, centre
    return scipy.linalg.solveh_banded(banded, moment)


def _readings(values: np.ndarray, kept: np.ndarray, factor: int) -> np.ndarray:
    """Readings of a sensor at the kept samples, less noisy where that changes nothing else."""
    window = factor + (factor + 1) % 2
    if window < 5 or values.size < 3 * window or not np.isfinite(values).all():
        return values[kept]
    from scipy.signal import savgol_filter  # slow to load, and rarely asked for

    smooth = np.asarray(savgol_filter(values, window, 2))
    left = values - smooth
    power = float(np.mean(left**2))
    white = power > 0 and abs(float(np.mean(left[1:] * left[:-1]))) < WHITE * power
    if not white or quantisation_step(values) is not None:
        return values[kept]
    return smooth[kept]
