"""Readings that come late, or by a clock of their own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsr.expressions.slopes import evaluate_with_slopes
from jaxsr.models.delays import cubic, delay_of, smoothly_interpolated
from jaxsr.models.directions import Directions
from jaxsr.models.segments import Segments, values_over
from jaxsr.models.simulator import Simulator

Array = Any


def late_readings(
    simulator: Simulator,
    segments: Segments,
    values: Sequence[Array],
    to: Directions,
    read: tuple[Array, Array],
    live: bool = False,
) -> tuple[Array, Array]:
    """Shift readings by their delays and clocks.

    Parameters
    ----------
    read : tuple of ndarray
        Readings, shape (outputs, samples, segments), and their derivatives, shape (directions,
        outputs, samples, segments).
    live : bool
        Whether a sensor may have been live before a segment begins; else it shows its first value
        until its delay has passed.
    """
    model, (y, by) = simulator.model, read
    time = segments.time
    for k, name in enumerate(model.outputs):
        delay = delay_of(model, name, values)
        if delay is None and name not in model.clock:
            continue
        at, at_rates = time, {}
        if delay is not None:
            at = at - delay
            if model.delays[name] in to.columns:
                at_rates[to.columns[str(model.delays[name])]] = -np.ones_like(time)
        if name in model.clock:
            env = dict(zip(model.parameters, values, strict=True))
            scale, slopes = _clock(simulator, name, env, set(to.columns))
            at_rates = {c: rate * scale for c, rate in at_rates.items()}
            for parameter, slope in slopes.items():
                c = to.columns[parameter]
                at_rates[c] = at_rates.get(c, 0.0) + at * slope
            at = at * scale
        both = np.concatenate([y[None, k], by[:, k]])
        found, slopes_in_time = smoothly_interpolated(time, both, at)
        if live:
            _continue_backwards(segments, k, both, at, (found, slopes_in_time))
        y[k], by[:, k] = found[0], found[1:]
        for c, rate in at_rates.items():
            by[c, k] += slopes_in_time[0] * rate
    return y, by


def samples_late(
    simulator: Simulator, segments: Segments, theta: np.ndarray
) -> dict[int, np.ndarray]:
    """Return by how many samples each late sensor's readings are older than their time stamps.

    Returns
    -------
    dict of int to ndarray of int, shape (samples, segments)
        Output to the age of its readings, to the nearest sample; below 0 of a clock that is ahead.
        Outputs that are nowhere late by a sample are left out.
    """
    model, found = simulator.model, {}
    values = values_over(theta, segments.override)
    time = segments.time
    last = time[segments.count - 1, np.arange(segments.number)]
    interval = (last - time[0]) / np.maximum(segments.count - 1, 1)
    for k, name in enumerate(model.outputs):
        delay, scale = delay_of(model, name, values), 1.0
        if name in model.clock:
            env = dict(zip(model.parameters, values, strict=True))
            scale = _clock(simulator, name, env, set())[0]
        age = time - (time - (0.0 if delay is None else delay)) * scale
        late = np.rint(age / np.where(interval > 0.0, interval, np.inf)).astype(int)
        if late.any():
            found[k] = late
    return found


def _continue_backwards(
    segments: Segments, output: int, values: Array, at: Array, held: tuple[Array, Array]
) -> None:
    """Continue values to times before a segment, where that is nearer to the recorded readings.

    A recording begins while its sensors are live, or with them: its readings say which. The values
    go on along the cubic through four of their own, as far apart as the times lie before the first.

    Parameters
    ----------
    values : ndarray, shape (1 + directions, samples, segments)
        Readings of a path, and their derivatives.
    at : ndarray, shape (samples, segments)
    held : tuple of ndarray
        The values at these times and their slopes, changed in place.
    """
    found, slopes = held
    for s in range(at.shape[1]):
        time = segments.time[: int(segments.count[s]), s]
        before = at[: time.size, s] < time[0]
        reach = int(np.searchsorted(time, 2.0 * time[0] - at[: time.size, s].min()))
        nodes = min(reach, (time.size - 1) // 3) * np.arange(4)
        if not before.any() or not nodes[-1]:
            continue
        weights = cubic([time[i] for i in nodes], at[: time.size, s][before])
        picked = [values[:, i, s, None] for i in nodes]
        on = np.sum([w * y for (w, _), y in zip(weights, picked, strict=True)], axis=0)
        rates = np.sum([w * y for (_, w), y in zip(weights, picked, strict=True)], axis=0)
        rows = np.flatnonzero(before)
        seen = segments.outputs[output, rows, s]
        if np.nansum((seen - on[0]) ** 2) < np.nansum((seen - found[0, rows, s]) ** 2):
            found[:, rows, s], slopes[:, rows, s] = on, rates


def _clock(simulator: Simulator, output: str, env: dict, by: set[str]) -> tuple[Array, dict]:
    clock = simulator.model.term(simulator.model.clock[output])
    return evaluate_with_slopes(clock, env, by)
