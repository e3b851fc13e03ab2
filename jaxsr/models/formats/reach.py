"""Whether recordings stay where formulas hold: off contacts, off limits, inside control ranges."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np

from jaxsr._result import InputError
from jaxsr.models.formats.plant import Plant, finite_range, mujoco, quietly
from jaxsr.recordings import Recording, noise_level

MOST_POSES = 2000
"""Poses of a recording at which contacts are sought."""
NOISES = 4.0
"""Standard deviations of its noise by which a sensor may read beyond a limit."""
RUN = 3
"""Readings in a row beyond a limit from which it acts."""


def unclamped_inputs(
    plant: Plant, columns: Mapping[str, str], recordings: Sequence[Recording]
) -> frozenset[str]:
    """Return the inputs that stay inside the range of their control in all recordings."""
    found = set()
    for i, u in enumerate(plant.inputs):
        low, high = finite_range(plant.m.actuator_ctrlrange[i])
        values = [r.channels[columns[u]] for r in recordings if columns.get(u) in r.channels]
        # Rounding of a file may lift the last digit of a bound.
        reach = 1e-9 * max(abs(low), abs(high)) if np.isfinite([low, high]).all() else 0.0
        if values and all(
            np.nanmin(v) >= low - reach and np.nanmax(v) <= high + reach for v in values
        ):
            found.add(u)
    return frozenset(found)


def check_reach(plant: Plant, columns: Mapping[str, str], recordings: Sequence[Recording]) -> None:
    """Refuse recordings in which a limit or a contact acts.

    Parameters
    ----------
    plant : Plant
    columns : mapping of str to str
        Column of each state that is a joint's position in rad or m.
    recordings : sequence of Recording

    Raises
    ------
    InputError
        Names joint or geoms, file and time.
    """
    for recording in recordings:
        poses = {
            j: recording.channels[columns[q]]
            for j, q in enumerate(plant.positions)
            if columns.get(q) in recording.channels
        }
        if not plant.disabled("LIMIT") and not plant.disabled("CONSTRAINT"):
            for j, values in poses.items():
                _check_limit(plant, j, values, recording)
        if len(poses) == plant.m.njnt:
            _check_contacts(plant, np.stack([poses[j] for j in sorted(poses)], axis=1), recording)


def _check_limit(plant: Plant, j: int, values: np.ndarray, recording: Recording) -> None:
    m = plant.m
    if not m.jnt_limited[j]:
        return
    low, high = (float(x) for x in m.jnt_range[j])
    good = np.isfinite(values)
    reach = NOISES * noise_level(recording.time[good], values[good]) if good.sum() > 12 else 0.0
    margin = float(m.jnt_margin[j])
    beyond = (values < low + margin - reach) | (values > high - margin + reach)
    runs = np.convolve(beyond, np.ones(RUN), mode="valid") >= RUN
    if runs.any():
        at = recording.time[int(runs.argmax())]
        what = (
            f"joint {plant.joint_names[j]!r} is at its limit in {int(beyond.sum())} samples, "
            f"first at {at:.4g} s"
        )
        remedy = "Cut the file there, or widen the range if the joint goes on"
        raise InputError(what, recording.name, remedy)


def _check_contacts(plant: Plant, poses: np.ndarray, recording: Recording) -> None:
    if plant.disabled("CONTACT") or plant.disabled("CONSTRAINT"):
        return
    library, m = mujoco(), copy.copy(plant.m)
    data = library.MjData(m)
    rows = np.flatnonzero(np.isfinite(poses).all(axis=1))
    rows = rows[:: max(1, -(-rows.size // MOST_POSES))]
    with quietly(library):
        for k in rows:
            data.qpos = poses[k]
            library.mj_kinematics(m, data)
            library.mj_comPos(m, data)
            library.mj_collision(m, data)
            acting = [c for c in range(data.ncon) if data.contact[c].exclude == 0]
            if acting:
                geoms = [plant.called("geom", int(g)) for g in data.contact[acting[0]].geom]
                at = recording.time[k]
                what = f"geoms {geoms[0]!r} and {geoms[1]!r} touch at {at:.4g} s"
                remedy = "Cut the file there, or exclude the pair in the MJCF"
                raise InputError(what, recording.name, remedy)
