"""One free run of a model as a table, integrated finely enough to be trusted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.models.free_run import free_run
from jaxsr.models.hidden import with_hidden
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import closed, liftable, readings_along
from jaxsr.models.model import FREE, Model
from jaxsr.models.rollout import Stepping, outputs, states
from jaxsr.models.segments import Prepared, Segments, build_segments, unbroken
from jaxsr.models.shooting import fit
from jaxsr.models.simulator import Simulator, width_scales
from jaxsr.models.states import StateEstimate, estimate_states, input_table, output_table, spread
from jaxsr.recordings import Recording, as_written

# Tried in turn: the cheap method first, the L-stable one where steps cannot resolve the model.
ATTEMPTS = (
    *(Stepping("rk4", n) for n in (1, 4, 16, 64)),
    *(Stepping("rodas3", n) for n in (4, 16, 64, 256)),
)
REFINEMENT, ORDERS = 4, {"rk4": 4, "rodas3": 3}
TOLERANCE = 1e-6
"""Largest estimated error, relative to the size of an output."""
START_SHARE, START_SAMPLES = 0.05, 50  # as in the free runs that a diagnosis reports
LEADING = 2_000
"""First samples in which a start is sought that no sensor reads."""
MOST_SAMPLES = 5_000_000
INTERPRETED = 10_000
"""Steps that take less time one by one, in numbers, than the compilation of a program for them."""
_SWITCHED = frozenset({"piecewise"})


@dataclass(frozen=True, eq=False)
class Run:
    """States (states, samples) and outputs (outputs, samples) of one run."""

    states: np.ndarray
    outputs: np.ndarray


def simulate_to_csv(
    simulator: Simulator,
    recording: Recording | None = None,
    duration: float | None = None,
    dt: float | None = None,
) -> pd.DataFrame:
    """Run a model freely and return the table that ``jaxsr simulate`` writes.

    Each sample interval is cut into finer and finer steps until the error of an output,
    estimated from two runs (Richardson), is below `TOLERANCE` of its size.
    A start that [initial] leaves free is estimated on the first 5 % of the recording, at least
    50 samples; parameters stay as they are.

    Parameters
    ----------
    simulator : Simulator
    recording : Recording, optional
        Time and inputs; its outputs serve for free starts alone.
    duration, dt : float, optional
        Length and interval of the rows in seconds, where there is no recording.

    Returns
    -------
    DataFrame
        Time, inputs and outputs under the names of [columns], then the states not among them.

    Raises
    ------
    InputError
        Inputs or starts are unknown, or no step resolves the model: it diverges, or is chaotic
        over this length.
    """
    model = simulator.model
    item = _grid(model, duration, dt) if recording is None else _prepared(model, recording)
    theta = np.array(simulator.values(), dtype=float)
    start = _start(simulator, item, theta)
    filled, rows = _filled(model, item) if model.events else (item, slice(None))
    run = _resolved(simulator, filled, theta, start)
    run = Run(run.states[:, rows], run.outputs[:, rows])
    table = time_column(model, item.time)
    table |= {model.column(u): item.inputs[:, k] for k, u in enumerate(model.inputs)}
    table |= {model.column(y): run.outputs[k] for k, y in enumerate(model.outputs)}
    for k, state in enumerate(model.states):
        table.setdefault(state, run.states[k])
    return pd.DataFrame(table)


def time_column(model: Model, seconds: np.ndarray) -> dict[str, np.ndarray]:
    """Return the column of time under its name of [columns], in the unit that the name states."""
    name = model.column(model.time)
    return {name: as_written(name, seconds)}


def start_on(simulator: Simulator, recording: Recording) -> tuple[Prepared, np.ndarray]:
    """Return a recording ready to be followed, and the states at its first sample.

    A start that [initial] leaves free is estimated as in `simulate_to_csv`.
    """
    item = _prepared(simulator.model, recording)
    return item, _start(simulator, item, np.array(simulator.values(), dtype=float))[:, 0]


def start_told(model: Model, recording: Recording | None) -> str:
    """Return how a run starts, in words: which states as given, which as estimated on what."""
    free = [s for s in model.states if model.initial.get(s, FREE) == FREE]
    given = [s for s in model.states if s not in free]
    parts = [f"{', '.join(given)} given in [initial]"] if given else []
    if free:
        names = ", ".join(free) if given else "all states"
        if recording is None:  # only a robot has a place of its own to start from
            parts.append(f"{names} at rest, where the file puts them")
        else:
            count = _start_samples(len(recording))
            parts.append(f"{names} estimated on the first {count} samples of {recording.name}")
    return f"start: {'; '.join(parts)}"


def _start_samples(samples: int) -> int:
    """Return how many samples a free start is estimated on."""
    return min(samples, max(START_SAMPLES, int(np.ceil(START_SHARE * samples))))


def _filled(model: Model, item: Prepared) -> tuple[Prepared, np.ndarray | slice]:
    """Add rows where others are missing, so that no step between two rows is a long one.

    Returns
    -------
    item : Prepared
    rows : ndarray of int or slice
        Where the recording's own rows are.
    """
    if len(unbroken(item.time)) == 1:
        return item, slice(None)
    intervals = np.diff(item.time)
    parts = np.maximum(np.round(intervals / np.median(intervals)), 1).astype(int)
    if parts.sum() > MOST_SAMPLES:
        return item, slice(None)
    rows = np.concatenate([[0], np.cumsum(parts)])
    time = np.interp(np.arange(rows[-1] + 1), rows, item.time)
    before = np.searchsorted(item.time, time, side="right") - 1
    held = model.input_hold == "zero"
    columns = [u[before] if held else np.interp(time, item.time, u) for u in item.inputs.T]
    inputs = np.stack(columns, axis=1) if columns else np.zeros((time.size, 0))
    values = np.stack([np.interp(time, item.time, x) for x in item.states.values.T], axis=1)
    measured = np.full((time.size, item.outputs.shape[1]), np.nan)
    measured[rows] = item.outputs
    recording = Recording(item.recording.name, time, {})
    return Prepared(recording, time, inputs, measured, replace(item.states, values=values)), rows


def _grid(model: Model, duration: float | None, dt: float | None) -> Prepared:
    """Return empty samples for a run without a recording."""
    if duration is None or dt is None:
        raise InputError("no recording to follow", model.name, "Give one, or duration and dt")
    if model.inputs:
        raise InputError(
            f"the inputs {', '.join(model.inputs)} are unknown", model.name, "Give a recording"
        )
    free = [s for s in model.states if model.initial.get(s, FREE) == FREE]
    if free:
        raise InputError(
            f"the start of {', '.join(free)} is free",
            f"{model.name} [initial]",
            "Give a number in [initial], or a recording to estimate it on",
        )
    if not (dt > 0 and duration >= 2 * dt and duration / dt <= MOST_SAMPLES):
        raise InputError(
            f"duration {duration:g} s and dt {dt:g} s", model.name, "Give 3 to 5,000,000 rows"
        )
    time = np.arange(int(np.floor(duration / dt * (1 + 1e-12))) + 1) * dt
    recording = Recording("simulation", time, {})
    return _without_sensors(model, recording, np.full((time.size, len(model.outputs)), np.nan))


def _prepared(model: Model, recording: Recording) -> Prepared:
    """Read the inputs, and the outputs as far as free starts need them."""
    if all(model.initial.get(s, FREE) != FREE for s in model.states):
        columns = [model.column(y) for y in model.outputs]
        nothing = np.full(len(recording), np.nan)
        measured = [recording.channels.get(column, nothing) for column in columns]
        return _without_sensors(model, recording, np.stack(measured, axis=1))
    measured, inputs = output_table(model, recording), input_table(model, recording)
    states, first = estimate_states(model, recording), slice(0, LEADING)
    told = replace(states, values=states.values[first])
    led = with_hidden(model, told, recording.time[first], inputs[first], outputs=measured[first])
    states.values[first] = led.values
    return Prepared(recording, recording.time, inputs, measured, states)


def _without_sensors(model: Model, recording: Recording, measured: np.ndarray) -> Prepared:
    values = np.tile([float(model.initial[s]) for s in model.states], (len(recording), 1))
    estimate = StateEstimate(values, {}, frozenset(model.states))
    return Prepared(recording, recording.time, input_table(model, recording), measured, estimate)


def _start(simulator: Simulator, item: Prepared, theta: np.ndarray) -> np.ndarray:
    """Return the states at the first sample, shape (states, 1)."""
    model = simulator.model
    free = np.array([model.initial.get(s, FREE) == FREE for s in model.states])
    given = [0.0 if f else float(model.initial[s]) for s, f in zip(model.states, free, strict=True)]
    guess = np.where(free, item.states.values[0], given)[:, None]
    if not free.any():
        return guess
    count = _start_samples(item.time.size)
    widths = _widths(simulator, item, item.states.values.T, theta)
    stepping = Stepping("rodas3", 4, widths)
    segments = build_segments(model, [item], [(0, 0, count)], stepping.substeps)
    problem = Problem(simulator, stepping, segments, spread(item.outputs))
    nothing = np.zeros(0, dtype=int)
    return fit(problem, theta, nothing, (theta, theta), x0=guess).x0


def _resolved(simulator: Simulator, item: Prepared, theta: np.ndarray, start: np.ndarray) -> Run:
    """Refine the steps until two runs agree, see `simulate_to_csv`."""
    # Fixed steps across a break in the rows may agree on what is wrong.
    broken = len(unbroken(item.time)) > 1
    adaptive = _adaptive(simulator, item, start, always=broken)
    if adaptive is not None:
        return adaptive
    widths = _widths(simulator, item, item.states.values.T, theta)
    previous: tuple[str, Run] | None = None
    finite = False
    for attempt in ATTEMPTS:
        run = _run(simulator, item, replace(attempt, widths=widths), theta, start)
        if not np.isfinite(run.outputs).all():
            previous = None
            continue
        if not finite:
            # Now it is known how far the states go, and how sharp a smoothed sign must be.
            finite, widths = True, _widths(simulator, item, run.states, theta)
            run = _run(simulator, item, replace(attempt, widths=widths), theta, start)
        if previous is not None and previous[0] == attempt.method:
            size = np.maximum(np.abs(run.outputs).max(1), 1e-300)
            difference = (np.abs(run.outputs - previous[1].outputs).max(1) / size).max()
            if difference / (REFINEMENT ** ORDERS[attempt.method] - 1) <= TOLERANCE:
                return run
        previous = (attempt.method, run)
    # Rows at uneven distances may ask for steps of their own as well.
    adaptive = None if broken or not finite else _adaptive(simulator, item, start, always=True)
    if adaptive is not None:
        return adaptive
    length = item.time[-1] - item.time[0]
    what = "two runs with finer steps do not agree" if finite else "the simulation diverges"
    raise InputError(
        f"{what} over {length:g} s",
        simulator.model.name,
        "Simulate a shorter time, or check the equations and parameters",
    )


def _adaptive(
    simulator: Simulator, item: Prepared, start: np.ndarray, always: bool = False
) -> Run | None:
    """Run laws that switch, or `always`, with steps of their own: small across a guard.

    Fixed steps of any size meet a jump of a law somewhere inside. Jumps of states, [[events]], are
    located by the fixed steps.
    """
    model = simulator.model
    switched = any(t.uses(_SWITCHED) for t in model.equation_terms.values())
    if model.events or not (switched or always):
        return None
    run = free_run(simulator, item.recording if model.inputs else item.time, start[:, 0])
    if not run.success or not np.all(np.isfinite(run.outputs)):
        return None
    return Run(run.states.T, run.outputs.T)


def _run(
    simulator: Simulator,
    item: Prepared,
    stepping: Stepping,
    theta: np.ndarray,
    start: np.ndarray,
) -> Run:
    whole: Segments = build_segments(
        simulator.model, [item], [(0, 0, item.time.size)], stepping.substeps
    )
    few = stepping.method == "rk4" and whole.length.size <= INTERPRETED and liftable(simulator)
    # Events follow a state that comes to rest, as a diagnosis does.
    if simulator.model.events or few:
        path = whole.course.copy()
        path[:, 0] = start
        near = bool(simulator.model.events)
        x = closed(simulator, stepping, whole, theta, path, near=near)
        if x is None:
            nothing = np.full((1, item.time.size), np.nan)
            return Run(nothing, nothing)
    else:
        x = states(simulator, stepping, whole, theta, start)
    if liftable(simulator) and np.isfinite(x).all():
        y, _ = readings_along(simulator, stepping, whole, theta, x, late=True)
    else:
        y = outputs(simulator, stepping, whole, theta, start)
    return Run(x[..., 0], y[..., 0])


def _widths(
    simulator: Simulator, item: Prepared, x: np.ndarray, theta: np.ndarray
) -> tuple[float, ...]:
    environment = simulator.environment(item.time, tuple(x), tuple(item.inputs.T), tuple(theta))
    return width_scales(simulator, environment)
