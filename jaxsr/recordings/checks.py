"""Checks of a recording: findings about the data, reported and not repaired."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from jaxsr.recordings.data_check import DataCheck
from jaxsr.recordings.lag import Lag, find_lags
from jaxsr.recordings.noise import level_spacing, noise_level, quantisation_step
from jaxsr.recordings.recording import Recording

GAP = 1.5  # medians of the sample time
_UNEVEN = 0.01  # of the median interval
_VISIBLE = 1e-6  # of a channel's range: below it neither noise nor step is worth a word
_OUTLIER = 8.0  # standard deviations of the prediction from four neighbours
_LARGEST = 1e100  # no sensor reads it, and squares of larger values overflow
_RUN = 3  # equal samples that can be a clipped stretch


def check_recording(
    recording: Recording,
    channels: Sequence[str] | None = None,
    inputs: Sequence[str] = (),
) -> list[DataCheck]:
    """Look for what a measurement may have done to the data.

    Parameters
    ----------
    recording : Recording
    channels : sequence of str, optional
        Channels to look at; by default all that can be used.
    inputs : sequence of str
        Channels among them that are commanded, not measured: plateaus and jumps are natural
        there, so clipping and outliers are not looked for.

    Returns
    -------
    list of DataCheck
        Empty for a clean record.
    """
    if channels is None:
        usable = {k: ~np.isnan(v).all() & ~np.isinf(v).any() for k, v in recording.channels.items()}
        channels = [name for name, fit in usable.items() if fit]
    values = {name: recording.channel(name) for name in channels}
    found = [r for r in recording.remarks if r.channel in (*channels, "time", "file")]
    found += _time(recording)
    for name, y in list(values.items()):
        if np.nanmax(np.abs(y)) > _LARGEST:
            text = f"{name} reaches {y[np.nanargmax(np.abs(y))]:.3g}, which no sensor reads"
            found.append(DataCheck(recording.name, name, "outliers", text))
            del values[name]
            continue
        found += _channel(recording, name, y, name in inputs)
    moving = {name: y for name, y in values.items() if name not in inputs}
    found += [_lag(recording.name, lag) for lag in find_lags(recording.time, moving)]
    return found


def _time(recording: Recording) -> Iterator[DataCheck]:
    dt = np.diff(recording.time)
    median = float(np.median(dt))
    long = dt > GAP * median
    # on an irregular grid long intervals are the rule, not gaps
    gaps = long & bool(np.mean(long) < 0.05)
    uneven = float(np.max(np.abs(dt[~gaps] - median)))
    if uneven > _UNEVEN * median:
        yield DataCheck(
            recording.name,
            "time",
            "non_uniform_time",
            f"the interval between samples varies from {dt[~gaps].min():.4g} to "
            f"{dt[~gaps].max():.4g} s, median {median:.4g} s",
            float(dt[~gaps].std()),
        )
    if gaps.any():
        first = int(np.flatnonzero(gaps)[0])
        yield DataCheck(
            recording.name,
            "time",
            "gap",
            f"{np.count_nonzero(gaps)} gaps, the longest {dt.max():.4g} s, "
            f"the first after {recording.time[first]:.6g} s",
            float(dt.max()),
        )


def _channel(recording: Recording, name: str, y: np.ndarray, is_input: bool) -> list[DataCheck]:
    file = recording.name
    found = []
    known = np.isfinite(y)
    t, y = recording.time[known], y[known]
    missing = known.size - y.size
    if missing:
        text = f"{missing} of {known.size} samples of {name} are missing"
        found.append(DataCheck(file, name, "missing_samples", text, missing / known.size))
    spread = float(np.ptp(y))
    if spread == 0.0:
        text = f"{name} is constant at {y[0]:.6g}"
        return [*found, DataCheck(file, name, "constant", text, float(y[0]))]
    if y.size < 8:
        return found
    noise = noise_level(t, y)
    step = quantisation_step(y) or (None if is_input else level_spacing(y))
    if not is_input:
        found += _clipping(file, name, y, max(noise, step or 0.0))
        found += _outliers(file, name, t, y, noise)
    if step is not None and step > _VISIBLE * spread:
        text = f"{name} is stored in steps of {step:.4g}"
        found.append(DataCheck(file, name, "quantisation", text, step))
    if noise > _VISIBLE * spread and noise > 1.3 * (step or 0.0) / np.sqrt(12.0):
        text = f"{name} carries noise of about {noise:.3g} (standard deviation)"
        found.append(DataCheck(file, name, "noise", text, noise))
    return found


def _clipping(file: str, name: str, y: np.ndarray, grain: float) -> Iterator[DataCheck]:
    """Runs of exactly equal extreme values that the signal enters and leaves at full speed.

    A turning point, or a smooth approach to rest, has lost its speed before it stays on its
    highest level; a clipped signal has not.
    """
    for sign, word in ((1.0, "largest"), (-1.0, "smallest")):
        z = sign * y
        at_limit = np.concatenate([[False], z == z.max(), [False]]).astype(int)
        edges = np.diff(at_limit)
        starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
        long = stops - starts >= _RUN
        runs = list(zip(starts[long].tolist(), stops[long].tolist(), strict=True))
        cornered = [run for run in runs if _has_corner(z, *run, grain)]
        samples = sum(stop - start for start, stop in cornered)
        if len(cornered) < 2 and samples < 10:
            continue
        limit = float(sign * z.max())
        yield DataCheck(
            file,
            name,
            "clipping",
            f"{name} stays exactly at its {word} value {limit:.6g} in {len(cornered)} stretches "
            f"({samples} samples): it looks clipped",
            limit,
        )


def _has_corner(z: np.ndarray, start: int, stop: int, grain: float) -> bool:
    reach = stop - start
    sides = (z[:start][::-1], z[stop:])
    corners = []
    for side in sides:
        # how far the signal falls below the limit, going away from the run
        depth = z[start] - side[: max(4, min(reach, 20) // 2)]
        if depth.size < 4:
            continue
        speed = float(depth[-1] - depth[0]) / (depth.size - 1)
        half = depth.size // 2
        speed_near = float(depth[half] - depth[0]) / half
        corners.append(speed_near > 0.7 * speed and 0.5 * reach * speed > 5.0 * grain)
    return bool(corners) and all(corners)


def _outliers(
    file: str, name: str, t: np.ndarray, y: np.ndarray, noise: float
) -> Iterator[DataCheck]:
    """Single samples far from the cubic through four neighbours, and from the local motion."""
    if y.size < 12:
        return
    predicted = (-y[:-4] + 4.0 * y[1:-3] + 4.0 * y[3:-1] - y[4:]) / 6.0
    error = np.abs(y[2:-2] - predicted)
    steps = np.abs(np.diff(y))
    # steps between neighbours, without the two that touch the sample itself
    around = np.maximum.reduce([steps[:-3], steps[3:], np.abs(y[3:-1] - y[1:-3])])
    grain = max(noise * np.sqrt(1.0 + 34.0 / 36.0), 1e-9 * float(np.ptp(y)))
    dt = np.diff(t)
    even = np.maximum.reduce([dt[i : y.size - 4 + i] for i in range(4)]) < 3.0 * np.median(dt)
    spikes = np.flatnonzero((error > _OUTLIER * grain) & (error > 2.0 * around) & even) + 2
    # a spike spoils the prediction of its neighbours: keep the largest of each group
    if spikes.size == 0:
        return
    groups = np.split(spikes, np.flatnonzero(np.diff(spikes) > 2) + 1)
    worst = max(float(error[group - 2].max()) for group in groups)
    yield DataCheck(
        file,
        name,
        "outliers",
        f"{len(groups)} single samples of {name} lie apart from their neighbours, the first at "
        f"{t[groups[0][0]]:.6g} s, by up to {worst:.4g}",
        float(len(groups)),
    )


def _lag(file: str, lag: Lag) -> DataCheck:
    late, early = (lag.rate, lag.of) if lag.seconds > 0 else (lag.of, lag.rate)
    text = (
        f"{lag.rate} is the rate of {lag.of}, and {late} lags {early} by "
        f"{abs(lag.seconds):.3g} s (+-{lag.uncertainty:.1g})"
    )
    return DataCheck(file, lag.rate, "lag", text, lag.seconds)
