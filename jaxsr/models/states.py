"""States along a recording: read from the sensors where the model says how."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from jaxsr._deadline import ask
from jaxsr.expressions import Term, affine_slope, evaluate
from jaxsr.models.inputs import fill_missing
from jaxsr.models.model import FREE, Model
from jaxsr.recordings import Recording
from jaxsr.views import savitzky_golay
from jaxsr.views.gaps import fill, reachable

FEWEST = 4
"""Samples of a sensor from which it tells a state along a recording: enough for a cubic."""


@dataclass(frozen=True, eq=False)
class StateEstimate:
    """States at the samples of one recording.

    Attributes
    ----------
    values : ndarray, shape (samples, states)
    measured : dict of str to ndarray
        The unsmoothed signal of states a sensor reads, for the weak view; what is missing between
        near neighbours lies on a spline through them, NaN stands in longer gaps.
    hidden : frozenset of str
        States that no sensor reads and that are no derivative of one; a guess stands there.
    seen : dict of str to ndarray of bool
        Where the states that a sensor tells are known; everywhere without an entry.
    """

    values: np.ndarray
    measured: dict[str, np.ndarray]
    hidden: frozenset[str]
    seen: dict[str, np.ndarray] = field(default_factory=dict)


def role_channel(model: Model, recording: Recording, role: str) -> np.ndarray:
    """Return the column of a recording that plays `role`."""
    return np.asarray(recording.channel(model.column(role)), dtype=float)


def input_table(model: Model, recording: Recording) -> np.ndarray:
    """Return the inputs, shape (samples, inputs), missing samples filled along lines."""
    columns = [
        fill_missing(recording.time, role_channel(model, recording, u)) for u in model.inputs
    ]
    return np.stack(columns, axis=1) if columns else np.zeros((len(recording), 0))


def output_table(model: Model, recording: Recording) -> np.ndarray:
    """Return the measured outputs, shape (samples, outputs), NaN where missing.

    A sensor that one recording lacks is missing throughout it.

    Raises
    ------
    InputError
        If the recording has no sample of any output.
    """
    table = np.empty((len(recording), len(model.outputs)))
    for k, output in enumerate(model.outputs):
        absent = is_absent(recording, model.column(output))
        table[:, k] = np.nan if absent else role_channel(model, recording, output)
    if all(np.isnan(column).all() for column in table.T):
        for output in model.outputs:
            role_channel(model, recording, output)  # says what is wrong with it
    return table


def spread(outputs: np.ndarray) -> np.ndarray:
    """Standard deviation of every output over its samples; 1 where it is constant or missing.

    Parameters
    ----------
    outputs : ndarray, shape (samples, outputs)
        NaN where missing.
    """
    seen = np.isfinite(outputs)
    count = np.maximum(seen.sum(0), 1)
    mean = np.sum(outputs, axis=0, where=seen) / count
    deviation = np.sqrt(np.sum((outputs - mean) ** 2, axis=0, where=seen) / count)
    return np.where(deviation > 0.0, deviation, 1.0)


def is_absent(recording: Recording, column: str) -> bool:
    """Whether a recording has no such column, or none of its samples."""
    if column in recording.set_aside:
        return False
    return column not in recording.channels or bool(np.isnan(recording.channels[column]).all())


def estimate_states(model: Model, recording: Recording) -> StateEstimate:
    """Estimate every state at every sample from the sensors.

    A state is measured where an output reads an affine expression of it alone; the rate of a
    measured state is the derivative of a local polynomial fit. Other states are hidden and
    start from their [initial] number, or from the mean size of the outputs. At the first sample
    stands what [initial] says, whatever a sensor reads.
    """
    time = recording.time
    readable = {}
    table = output_table(model, recording)
    for output, column in zip(model.outputs, table.T, strict=True):
        state = _read_state(model, output)
        if state is None or state in readable or np.count_nonzero(np.isfinite(column)) < FEWEST:
            continue
        signal = _inverted(model, output, state, column)
        if signal is not None:
            readable[state] = signal
    smooth: dict[str, np.ndarray] = {}
    seen: dict[str, np.ndarray] = {}
    for state, signal in readable.items():
        ask()
        smooth[state] = savitzky_golay(time, signal, 0)
        seen[state] = reachable(time, np.isfinite(signal))
        child = _rate_state(model, state)
        if child is not None and child not in readable:
            smooth[child] = savitzky_golay(time, signal, 1)
            seen[child] = seen[state]
    guess = np.nanmean(np.abs(table))
    values = np.empty((len(recording), len(model.states)))
    for i, state in enumerate(model.states):
        fixed = model.initial.get(state, FREE)
        fallback = guess if fixed == FREE else float(fixed)
        values[:, i] = smooth.get(state, np.full(len(recording), fallback))
        if fixed != FREE:
            values[0, i] = float(fixed)  # a run from the first sample begins there
    for column in values.T:
        # Inside a gap a straight line serves: a segment may begin there.
        column[:] = fill_missing(time, column)
    hidden = frozenset(s for s in model.states if s not in smooth)
    measured = {state: fill(time, signal) for state, signal in readable.items()}
    return StateEstimate(values, measured, hidden, seen)


def _rate_state(model: Model, state: str) -> str | None:
    term = model.equation_terms.get(state)
    if term is not None and term.is_variable and term.name in model.states:
        return term.name if state not in model.inertia else None
    return None


def _read_state(model: Model, output: str) -> str | None:
    """Return the one state that `output` reads, if it reads exactly one and affinely."""
    term = model.reading_terms[output]
    states = [s for s in model.states if s in term.variables]
    if len(states) != 1 or term.variables & {*model.inputs, model.time}:
        return None
    if term.is_variable:
        return states[0]
    slope = affine_slope(term, states[0])
    flat = slope is None or (slope.is_constant and slope.value == 0.0)
    return None if flat else states[0]


def _inverted(model: Model, output: str, state: str, signal: np.ndarray) -> np.ndarray | None:
    """Solve output = slope*state + offset for the state, parameters as given.

    None where the reading does not depend on the state at these values.
    """
    term: Term = model.reading_terms[output]
    env = {n: p.value for n, p in model.parameters.items()}
    offset = float(evaluate(term, {**env, state: 0.0}))
    slope = float(evaluate(term, {**env, state: 1.0})) - offset
    return (signal - offset) / slope if np.isfinite(offset) and slope else None
