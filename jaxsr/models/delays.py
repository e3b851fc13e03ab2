"""Signals that come late: inputs and readings shifted in time, segment by segment, in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsr.models.directions import Stages
from jaxsr.models.model import Model
from jaxsr.models.segments import Segments

Array = Any
DIFFERENCE = 0.05
"""Step, in samples, by which a delay is moved to differentiate an input by it."""


def delay_of(model: Model, name: str, theta: Sequence[Array]) -> Array | None:
    """Return the delay of an input or an output, None where it has none."""
    value = model.delays.get(name)
    if value is None or (not isinstance(value, str) and value == 0.0):
        return None
    return theta[list(model.parameters).index(value)] if isinstance(value, str) else value


def interpolated(time: Array, values: Array, at: Array) -> tuple[Array, Array]:
    """Interpolate along axis -2 on lines, segment by segment, the ends held.

    Parameters
    ----------
    time : ndarray, shape (samples, segments)
    values : ndarray, shape (..., samples, segments)
    at : ndarray, shape (times, segments)

    Returns
    -------
    values, slopes : ndarray, shape (..., times, segments)
    """
    found = np.empty((*values.shape[:-2], *at.shape))
    slopes = np.zeros_like(found)
    for s in range(time.shape[1]):
        t, y, when = time[:, s], values[..., s], at[:, s]
        k = np.clip(np.searchsorted(t, when, side="right") - 1, 0, t.size - 2)
        gap = t[k + 1] - t[k]
        safe = np.where(gap > 0, gap, 1.0)
        share = np.where(gap > 0, np.clip((when - t[k]) / safe, 0.0, 1.0), 0.0)
        rise = y[..., k + 1] - y[..., k]
        inside = (when > t[0]) & (when < t[-1]) & (gap > 0)
        found[..., s] = y[..., k] + share * rise
        slopes[..., s] = np.where(inside, rise / safe, 0.0)
    return found, slopes


def cubic(nodes: Sequence[Array], at: Array) -> list[tuple[Array, Array]]:
    """Return, for each of four nodes, its weight in the cubic through all of them and the slope.

    Lagrange's form: l_i(t) is the product of (t - t_j)/(t_i - t_j) over j != i.
    """
    found = []
    for i, own in enumerate(nodes):
        a, b, c = (node for j, node in enumerate(nodes) if j != i)
        scale = (own - a) * (own - b) * (own - c)
        x, y, z = at - a, at - b, at - c
        found.append((x * y * z / scale, (y * z + x * z + x * y) / scale))
    return found


def smoothly_interpolated(time: Array, values: Array, at: Array) -> tuple[Array, Array]:
    """Interpolate along axis -2 on cubics through four neighbours, else like `interpolated`.

    What a simulation reads between two samples is then known to fourth order in their distance;
    a straight line would leave more than the noise of a good sensor.
    """
    found, slopes = interpolated(time, values, at)
    for s in range(time.shape[1]):
        t, when = time[:, s], at[:, s]
        size = 1 + np.count_nonzero(np.diff(t) > 0)  # padding repeats the last time
        if size < 4:
            continue
        inside = (when > t[0]) & (when < t[size - 1])
        k = np.searchsorted(t[:size], when[inside], side="right") - 1
        begin = np.clip(k - 1, 0, size - 4)
        weights = cubic([t[begin + i] for i in range(4)], when[inside])
        picked = [values[..., begin + i, s] for i in range(4)]
        found[..., inside, s] = sum(w * y for (w, _), y in zip(weights, picked, strict=True))
        slopes[..., inside, s] = sum(w * y for (_, w), y in zip(weights, picked, strict=True))
    return found, slopes


def delayed_stages(
    model: Model, segments: Segments, theta: Sequence[Array], active: Sequence[str]
) -> tuple[Array, dict[int, Array]]:
    """Return inputs at the stages of all steps, and derivatives by the delays in `active`.

    The arrays are like `Segments.stages`, those of one input without its axis.
    """
    stages, rates = segments.stages, {}
    for k, name in enumerate(model.inputs):
        delay = delay_of(model, name, theta)
        if delay is None:
            continue
        stages = stages.copy() if stages is segments.stages else stages
        delay = np.broadcast_to(delay, segments.time.shape[1:])
        stages[:, k] = _shifted(model, segments, k, delay)
        if model.delays[name] in active:
            step = DIFFERENCE * float(np.median(np.diff(segments.time[:, 0])[:10]))
            later, sooner = (_shifted(model, segments, k, delay + d) for d in (step, -step))
            rates[k] = (later - sooner) / (2.0 * step)
    return stages, rates


def _shifted(model: Model, segments: Segments, k: int, delay: Array) -> Array:
    """One input at the stages, shape (3, samples - 1, substeps, segments)."""
    h, u = segments.length, segments.inputs[k]
    begin = segments.time[:-1, None] + np.cumsum(h, axis=1) - h
    if model.input_hold == "zero":
        held = _mean_over_steps(segments, k, begin - delay, h)
        return np.where(h > 0, held, segments.stages[:, k])
    time, values = segments.time, u
    if model.input_hold == "bandlimited":
        time, values = _dense(segments, k, begin)
    result = np.empty_like(segments.stages[:, k])
    for s, share in enumerate((0.0, 0.5, 1.0)):
        at = (begin + share * h - delay).reshape(-1, h.shape[-1])
        found = interpolated(time, values, at)[0].reshape(h.shape)
        result[s] = np.where(h > 0, found, segments.stages[s, k])
    return result


def _mean_over_steps(segments: Segments, k: int, begin: Array, h: Array) -> Array:
    """Mean of a held input over every step: impulses are kept, whatever the delay."""
    time, u = segments.time, segments.inputs[k]
    first = u[:1]
    moved = (u - first)[:-1] * np.diff(time, axis=0)
    integral = np.concatenate([np.zeros_like(first), np.cumsum(moved, axis=0)])
    edges = begin.reshape(-1, h.shape[-1])
    edges = np.concatenate([edges, edges[-1:] + h[-1, -1:]])
    rise = np.diff(interpolated(time, integral, edges)[0], axis=0).reshape(h.shape)
    return first + rise / np.where(h > 0, h, 1.0)


def _dense(segments: Segments, k: int, begin: Array) -> tuple[Array, Array]:
    """Knots and values of a band-limited input at the starts and middles of all steps."""
    h, u = segments.length, segments.inputs[k]
    middle, start = (np.where(h > 0, segments.stages[s, k], u[:-1, None]) for s in (1, 0))
    at = np.stack([begin, begin + 0.5 * h], axis=2).reshape(-1, h.shape[-1])
    values = np.stack([start, middle], axis=2).reshape(-1, h.shape[-1])
    return np.concatenate([at, segments.time[-1:]]), np.concatenate([values, u[-1:]])


def stage_of(stages: Array, rates: dict[int, Array], substep: int) -> Stages:
    """Pick the inputs of one substep."""
    return Stages(stages[:, :, :, substep], {k: rate[:, :, substep] for k, rate in rates.items()})
