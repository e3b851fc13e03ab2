"""Signs given back to readings that are absolute values: pulse counters, rectifiers, detectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr.expressions import Term, evaluate, to_text
from jaxsr.models.hidden import with_hidden
from jaxsr.models.model import Model
from jaxsr.models.states import StateEstimate, input_table
from jaxsr.recordings import Recording

SIGNS = np.array([1.0, -1.0])


def likely_signs(time: np.ndarray, values: np.ndarray, led: np.ndarray | None = None) -> np.ndarray:
    r"""Return the signs s with which absolute readings y turn least, and follow a model best.

    .. math:: \min_s \sum_k (d_k - d_{k-1})^2 / \sigma_d^2 + (s_k y_k - a m_k)^2 / \sigma_m^2,
        \quad d_k = \frac{s_{k+1} y_{k+1} - s_k y_k}{t_{k+1} - t_k},

    by dynamic programming over neighbouring pairs of signs. Where a reading turns at zero in a
    sharp corner, the motion went through. The model's reading m is taken at the scale a that its
    size has beside y; the deviations are those that either sum leaves by itself.

    Parameters
    ----------
    time : ndarray, shape (samples,)
        In s.
    values : ndarray, shape (samples,)
        NaN where missing; signs there are those of the sample before.
    led : ndarray, shape (samples,), optional
        The reading of a model; without it the first known sign is positive.

    Returns
    -------
    ndarray, shape (samples,)
        Of 1 and -1.
    """
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 3:
        return np.ones(len(values))
    t, y = time[known], values[known]
    beside = np.zeros((len(y), 2))
    beside[0, 1] = np.inf
    chosen, left = _least(t, y, beside)
    if led is not None and np.isfinite(led[known]).all() and np.any(led[known]):
        m = led[known]
        m = m * float(np.abs(m) @ np.abs(y)) / float(m @ m)
        variance = float(np.mean((np.abs(m) - np.abs(y)) ** 2)) + 1e-300
        scale = max(left, 1e-300) / len(y) / variance
        chosen, _ = _least(t, y, scale * (SIGNS * y[:, None] - m[:, None]) ** 2)
    at = np.maximum(np.searchsorted(known, np.arange(len(values)), side="right") - 1, 0)
    return SIGNS[chosen][at]


def _least(t: np.ndarray, y: np.ndarray, beside: np.ndarray) -> tuple[np.ndarray, float]:
    """Return which signs cost least, and that cost.

    Parameters
    ----------
    beside : ndarray, shape (samples, 2)
        Cost of either sign at a sample beside that of the turns.
    """
    # cost[a, b]: least sum up to a sample, the last two with signs a and b
    cost = beside[0][:, None] + beside[1][None, :]
    came = np.zeros((len(y), 2, 2), dtype=int)
    for k in range(2, len(y)):
        before = (SIGNS[None, :] * y[k - 1] - SIGNS[:, None] * y[k - 2]) / (t[k - 1] - t[k - 2])
        after = (SIGNS[None, :] * y[k] - SIGNS[:, None] * y[k - 1]) / (t[k] - t[k - 1])
        turned = cost[:, :, None] + (after[None] - before[:, :, None]) ** 2
        came[k] = np.argmin(turned, axis=0)
        cost = np.min(turned, axis=0) + beside[k]
    chosen = np.zeros(len(y), dtype=int)
    chosen[-2:] = np.unravel_index(np.argmin(cost), (2, 2))
    for k in range(len(y) - 1, 1, -1):
        chosen[k - 2] = came[k][chosen[k - 1], chosen[k]]
    return chosen, float(cost.min())


def absolute(reading: Term) -> Term | None:
    """Return what a reading takes the absolute value of; None where it takes none."""
    return reading.args[0] if reading.op == "abs" else None


def signed_readings(
    model: Model, recording: Recording, reading: Term, values: np.ndarray
) -> np.ndarray:
    """Return absolute readings with their signs.

    The motion with as few corners as can be, the way in which the inputs drive the model; without
    inputs it begins positive.

    Parameters
    ----------
    model : Model
    recording : Recording
    reading : Term
        What the sensor would read if it knew of signs.
    values : ndarray, shape (samples,)
        What it reads, NaN where missing.
    """
    led = _led(model, recording, reading) if model.inputs and model.formulas else None
    return likely_signs(recording.time, values, led) * values


def with_signs(model: Model, recording: Recording) -> tuple[Model, Recording]:
    """Return a model and a recording in which readings of absolute values have their signs."""
    inner = {y: absolute(reading) for y, reading in model.reading_terms.items()}
    readings, channels = dict(model.readings), dict(recording.channels)
    for output, reading in inner.items():
        column = model.column(output)
        if reading is not None and column in channels:
            readings[output] = to_text(reading)
            channels[column] = signed_readings(model, recording, reading, channels[column])
    if readings == dict(model.readings):
        return model, recording
    return replace(model, readings=readings), replace(recording, channels=channels)


def _led(model: Model, recording: Recording, reading: Term) -> np.ndarray:
    """Return a reading along the motion that the inputs lead to from rest."""
    time, inputs = recording.time, input_table(model, recording)
    rest = np.zeros((len(time), len(model.states)))
    nothing = StateEstimate(rest, {}, frozenset(model.states))
    start = np.zeros(len(model.states))
    moved = with_hidden(model, nothing, time, inputs, start).values
    columns = zip(model.states, moved.T, strict=True)
    known = {n: p.value for n, p in model.parameters.items()} | dict(columns)
    known |= dict(zip(model.inputs, inputs.T, strict=True)) | {model.time: time}
    return np.broadcast_to(np.asarray(evaluate(reading, known), dtype=float), time.shape)


__all__ = ["absolute", "likely_signs", "signed_readings", "with_signs"]
