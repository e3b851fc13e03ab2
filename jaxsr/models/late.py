"""Readings that come late, or by a clock of their own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsr.expressions.slopes import evaluate_with_slopes
from jaxsr.models.delays import delay_of, smoothly_interpolated
from jaxsr.models.directions import Directions
from jaxsr.models.segments import Segments
from jaxsr.models.simulator import Simulator

Array = Any


def late_readings(
    simulator: Simulator,
    segments: Segments,
    values: Sequence[Array],
    to: Directions,
    read: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Shift readings by their delays and clocks.

    Parameters
    ----------
    read : tuple of ndarray
        Readings, shape (outputs, samples, segments), and their derivatives, shape (directions,
        outputs, samples, segments).
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
        y[k], by[:, k] = found[0], found[1:]
        for c, rate in at_rates.items():
            by[c, k] += slopes_in_time[0] * rate
    return y, by


def _clock(simulator: Simulator, output: str, env: dict, by: set[str]) -> tuple[Array, dict]:
    clock = simulator.model.term(simulator.model.clock[output])
    return evaluate_with_slopes(clock, env, by)
