"""A robot run by MuJoCo itself, with the integrator and the time step of its file."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.expressions import evaluate
from jaxsr.models.formats.mjcf import Robot
from jaxsr.models.formats.plant import Plant, mujoco, quietly
from jaxsr.models.simulation import MOST_SAMPLES, simulate_to_csv, start_on, time_column
from jaxsr.models.simulator import Simulator
from jaxsr.recordings import Recording

Controls = Callable[[float], np.ndarray]
"""Controls by time in s."""


def run_steps(
    plant: Plant, start: np.ndarray, time: np.ndarray, controls: Controls, refine: int = 1
) -> np.ndarray:
    """Run MuJoCo from a start, and return its states at given times.

    Parameters
    ----------
    plant : Plant
    start : ndarray, shape (states,)
        Positions, rates and activations at ``time[0]``.
    time : ndarray, shape (samples,)
        In s; between two steps the states lie on a line.
    controls : callable
        Asked at the start of every step, as a program around MuJoCo sets them.
    refine : int
        Into how many parts the time step of the file is cut.

    Returns
    -------
    ndarray, shape (samples, states)
        NaN from where the run diverges.
    """
    library, m = mujoco(), copy.copy(plant.m)
    m.opt.timestep = plant.m.opt.timestep / refine
    n, data = m.nv, library.MjData(m)
    order = sorted(plant.activations, key=lambda i: int(m.actuator_actadr[i]))
    place = [list(plant.activations).index(i) for i in order]
    data.qpos, data.qvel = start[:n], start[n : 2 * n]
    if m.na:
        data.act = start[2 * n :][place]
    out = np.full((time.size, start.size), np.nan)
    out[0] = start
    row, before, now = 1, start, start
    h = float(m.opt.timestep)
    with quietly(library) as said:
        step = 0
        while row < time.size:
            at = time[0] + step * h
            if m.nu:
                data.ctrl = controls(at)
            library.mj_step(m, data)
            step += 1
            before = now
            now = np.concatenate([data.qpos, data.qvel, data.act[np.argsort(place)]])
            if said or not np.isfinite(now).all():
                break
            end = time[0] + step * h
            while row < time.size and time[row] <= end + 1e-9 * h:
                share = min(max((time[row] - at) / h, 0.0), 1.0)
                out[row] = before + share * (now - before)
                row += 1
    return out


def held(time: np.ndarray, inputs: np.ndarray, hold: str) -> Controls:
    """Return recorded inputs, shape (samples, inputs), as controls by time."""

    def controls(at: float) -> np.ndarray:
        k = int(np.clip(np.searchsorted(time, at + 1e-9, side="right") - 1, 0, time.size - 1))
        if hold == "zero" or k + 1 >= time.size:
            return inputs[k]
        share = (at - time[k]) / (time[k + 1] - time[k])
        return inputs[k] + min(max(share, 0.0), 1.0) * (inputs[k + 1] - inputs[k])

    return controls


def robot_to_csv(
    robot: Robot,
    recording: Recording | None = None,
    duration: float | None = None,
    dt: float | None = None,
) -> pd.DataFrame:
    """Return the table that ``jaxsr simulate robot.xml`` writes, by MuJoCo's own steps.

    Without a recording the run starts at rest in the file's reference position. What a sidecar
    adds or changes MuJoCo does not know: with it the formulas are run.

    Raises
    ------
    InputError
        Inputs are unknown, or the run diverges.
    """
    model, plant = robot.model, robot.plant
    simulator = Simulator(model)
    if robot.edited or model.delays:
        if recording is not None and model.within is not None:
            if len(model.within(recording)) < len(recording):
                what = "a contact or a limit acts in it, which the formulas with the sidecar's "
                remedy = "Cut the file there, or run the MJCF without them"
                raise InputError(f"{what}changes do not have", recording.name, remedy)
        return simulate_to_csv(simulator, recording, duration, dt)
    if recording is None:
        time, inputs, start = _alone(robot, duration, dt)
    else:
        item, start = start_on(simulator, recording)
        time, inputs = item.time, item.inputs
    states = run_steps(plant, start, time, held(time, inputs, model.input_hold))
    if not np.isfinite(states).all():
        at = time[int(np.argmax(~np.isfinite(states).all(axis=1)))]
        remedy = "Take a smaller timestep in the file, or a shorter time"
        raise InputError(f"MuJoCo's run diverges at {at:.4g} s", plant.path.name, remedy)
    table = time_column(model, time)
    table |= {model.column(u): inputs[:, k] for k, u in enumerate(model.inputs)}
    readings = read_outputs(robot, time, states, inputs)
    table |= {model.column(y): readings[:, k] for k, y in enumerate(model.outputs)}
    for k, state in enumerate(model.states):
        table.setdefault(state, states[:, k])
    return pd.DataFrame(table)


def read_outputs(
    robot: Robot, time: np.ndarray, states: np.ndarray, inputs: np.ndarray
) -> np.ndarray:
    """Return what the sensors read, shape (samples, outputs)."""
    model = robot.model
    env: dict[str, Any] = {model.time: time}
    env |= {n: p.value for n, p in model.parameters.items()}
    env |= dict(zip(model.states, states.T, strict=True))
    env |= dict(zip(model.inputs, inputs.T, strict=True))
    terms = [model.reading_terms[y] for y in model.outputs]
    with np.errstate(all="ignore"):
        columns = [np.broadcast_to(evaluate(t, env, "numpy"), time.shape) for t in terms]
    return np.stack(columns, axis=1)


def _alone(
    robot: Robot, duration: float | None, dt: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, no inputs, and the start of a run without a recording."""
    model, m = robot.model, robot.plant.m
    if model.inputs:
        what = f"the inputs {', '.join(model.inputs)} are unknown"
        raise InputError(what, robot.plant.path.name, "Give a recording")
    if duration is None or dt is None or not (dt > 0 and duration >= 2 * dt):
        raise InputError("no rows to run for", robot.plant.path.name, "Give --duration and --dt")
    if duration / dt > MOST_SAMPLES:
        raise InputError("too many rows", robot.plant.path.name, "Give a larger --dt")
    time = np.arange(int(np.floor(duration / dt * (1 + 1e-12))) + 1) * dt
    start = np.concatenate([m.qpos0, np.zeros(m.nv + m.na)])
    for k, state in enumerate(model.states):
        value = model.initial.get(state)
        start[k] = float(value) if isinstance(value, int | float) else start[k]
    return time, np.zeros((time.size, 0)), start
