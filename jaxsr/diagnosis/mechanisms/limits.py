"""Limits of a sensor: where readings stand still at one end or at both, they are clipped."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED, Candidate
from jaxsr.diagnosis.mechanisms.site import Threshold

CLIPPING = "clipping"
GRAIN = 1e-9
"""Share of all that is read within which readings are equal."""
FLAT = 3
"""Equal neighbouring readings at an end that show a sensor at its limit."""
NEVER = 1e-2
"""Share of equal neighbours below which a sensor never stands still but at its limit."""
BAND = 8.0
"""Depth below an end, in standard deviations of the noise, in which to look."""
TOP, BOTTOM = "Min({old}, {ymax})", "Max({old}, {ymin})"
MIRRORED, APART = "Max(Min({old}, {ymax}), -{ymax})", "Max(Min({old}, {ymax}), {ymin})"
"""Readings of a sensor that is limited at one end, at both ends alike, and at both."""


def clipping(output: str, unit: str | None, values: np.ndarray | None) -> Iterator[Candidate]:
    """Yield the limits of a sensor at which its readings stand still, if any.

    One limit stands for both ends as long as no reading lies beyond it at the other.

    Parameters
    ----------
    values : ndarray, optional
        Its readings; a limit of one at both ends without.
    """
    low, high = (-1.0, 1.0) if values is None else _ends(values[np.isfinite(values)])
    most = Threshold("ymax", unit, neutral=UNLIMITED, seed=high or 0.0)
    least = Threshold("ymin", unit, neutral=-UNLIMITED, seed=low or 0.0)
    if low is None and high is None:
        return
    if high is None:
        limits, reading = (least,), BOTTOM
    elif low is None:
        limits, reading = (most,), TOP
    elif low == -high:
        most = Threshold("ymax", unit, low=0.0, neutral=UNLIMITED, seed=high)
        limits, reading = (most,), MIRRORED
    else:
        limits, reading = (most, least), APART
    yield Candidate(
        CLIPPING,
        "measurement",
        f"output:{output}",
        limits,
        "Sensor {site} reads no further than its limit.",
        readings=((output, reading),),
        source="Ljung, System Identification (1999), section 14.1",
    )


def _ends(values: np.ndarray) -> tuple[float | None, float | None]:
    """Return the least and the largest reading at which a sensor stands still, if it does."""
    if values.size < 8 or not np.ptp(values) > 0.0:
        return None, None
    high, low = _limit(values, values), _limit(values, -values)
    low = None if low is None else -low
    if high is not None and low is not None:
        exact = high == values.max() and low == values.min()
        apart = GRAIN * float(np.ptp(values)) if exact else _noise(values)
        return (-high, high) if abs(high + low) <= apart else (low, high)
    if high is None and low is None:
        size = _limit(values, np.abs(values))
        return (None, None) if size is None else (-size, size)
    size, other = (high, -values.min()) if high is not None else (-(low or 0.0), values.max())
    return (-size, size) if other <= size else (low, high)


def _limit(values: np.ndarray, size: np.ndarray) -> float | None:
    """Return the size at which readings stand still, exactly or up to noise, more than once.

    A free turning point of the motion passes its largest value at once, or in a parabola that is
    wider than the noise; a sensor that stands at rest there does so once, and elsewhere too.
    """
    spread = float(np.ptp(size))
    if not spread > 0.0:
        return None
    grain = GRAIN * spread
    flat = [run.size for run in _near_top(size, grain) if run.size >= FLAT]
    # At its other end it may be limited as well.
    below = (size[1:] < size.max() - grain) & (size[1:] > size.min() + grain)
    equal = (np.diff(values) == 0.0) & below
    standing = float(np.mean(equal[below])) if below.any() else 1.0
    # A coarse converter repeats readings where the motion turns, but briefly.
    moving = np.flatnonzero(np.concatenate([[True], ~equal, [True]]))
    longest = int(np.diff(moving).max())
    if len(flat) >= 2 or (flat and (standing < NEVER or flat[0] > 2 * longest)):
        return float(size.max())
    noise = _noise(values)
    runs = _near_top(size, BAND * noise)
    still = [run for run in runs if run.size >= 2 * FLAT and run.std() < 1.5 * noise]
    return float(max(run.mean() for run in still)) if len(still) >= 2 else None


def _noise(values: np.ndarray) -> float:
    """Return the deviation of white noise: third differences have 20 times its variance."""
    return float(np.median(np.abs(np.diff(values, 3)))) / (0.6745 * np.sqrt(20.0))


def _near_top(size: np.ndarray, depth: float) -> list[np.ndarray]:
    """Return runs of neighbouring readings less than `depth` below the largest."""
    at = np.concatenate([[False], size > size.max() - depth, [False]]).astype(int)
    starts, ends = np.flatnonzero(np.diff(at) == 1), np.flatnonzero(np.diff(at) == -1)
    return [size[a:b] for a, b in zip(starts, ends, strict=True)]
