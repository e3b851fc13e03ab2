"""What the time step of a simulator's file does to its own runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsr.models.formats.mjcf import Robot
from jaxsr.models.formats.running import held, read_outputs, run_steps
from jaxsr.models.segments import Prepared, cut
from jaxsr.recordings import Recording

SHARE = 0.1
"""Share of the mismatch from which the time step is worth a word (CONTRACT.md, section 1)."""
MOST_STEPS = 60_000
"""Steps of MuJoCo that the comparison takes in all."""


def step_rows(
    robot: Robot, recordings: Sequence[Recording], horizon: float, mismatch: float
) -> list[dict[str, Any]]:
    """Say how far half the time step changes runs, where that is not little.

    Parameters
    ----------
    robot : Robot
    recordings : sequence of Recording
        Those to learn from.
    horizon : float
        Length in s of the runs, from estimated states.
    mismatch : float
        NRMSE of the given model at this horizon.

    Returns
    -------
    list of dict
        At most one row for ``data_checks``.
    """
    model, plant = robot.model, robot.plant
    if robot.edited or model.delays or not np.isfinite(mismatch):
        return []
    step = float(plant.m.opt.timestep)
    left, changes = MOST_STEPS, []
    for recording in recordings:
        item = Prepared.build(model, recording)
        if item.states.hidden:
            return []
        size = np.nanstd(item.outputs, axis=0)
        controls = held(item.time, item.inputs, model.input_hold)
        for _, first, last in cut([item], horizon):
            part = slice(first, last)
            time, start = item.time[part], item.states.values[first]
            if left <= 0 or not np.isfinite(start).all():
                continue
            left -= int(3 * (time[-1] - time[0]) / step)
            runs = [run_steps(plant, start, time, controls, refine) for refine in (1, 2)]
            read = [read_outputs(robot, time, x, item.inputs[part]) for x in runs]
            changes.append(np.mean(((read[1] - read[0]) / np.where(size > 0, size, 1.0)) ** 2))
    found = float(np.sqrt(np.mean(changes))) if changes else 0.0
    if found <= SHARE * mismatch:
        return []
    how = f"NRMSE {found:.2g} over {horizon:.3g} s" if np.isfinite(found) else "beyond bounds"
    message = (
        f"half the time step of {plant.path.name} ({step:g} s) changes its own runs by {how}; the "
        f"mismatch with the recordings is {mismatch:.2g}. The diagnosis compares the equations, "
        "not these steps"
    )
    file = plant.path.name
    return [{"file": file, "channel": "", "check": "time_step", "message": message}]
