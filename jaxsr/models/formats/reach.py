"""Whether recordings stay where formulas hold: off contacts, off limits, inside control ranges.

Forces of contacts and limits are in no formula: samples in which they act are left out, counted,
and said.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions import evaluate
from jaxsr.models.formats.plant import Plant, finite_range, mujoco, quietly
from jaxsr.models.model import Model
from jaxsr.models.segments import SHORTEST
from jaxsr.recordings import Recording, noise_level
from jaxsr.recordings.data_check import DataCheck

MOST_POSES = 50_000
"""Poses of a recording at which contacts are sought; each stands for the samples around it."""
NOISES = 4.0
"""Standard deviations of its noise by which a sensor may read beyond a limit."""
RUN = 3
"""Readings in a row that lie on a limit from which the joint rests there."""


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


@dataclass(frozen=True, eq=False)
class Reach:
    """Where the formulas of a plant hold.

    Attributes
    ----------
    plant : Plant
    sensors : mapping of int to (str, float, float)
        By joint, the column that reads its position in rad or m alone, and scale and offset of it.
    """

    plant: Plant
    sensors: Mapping[int, tuple[str, float, float]]

    @staticmethod
    def of(plant: Plant, model: Model) -> Reach:
        """Return the reach of a plant whose sensors a model reads."""
        found: dict[int, tuple[str, float, float]] = {}
        for output, term in model.reading_terms.items():
            states = term.variables & set(model.states)
            position = next(iter(states), "")
            if len(states) != 1 or position not in plant.positions:
                continue
            env = {model.time: 0.0, **{n: p.value for n, p in model.parameters.items()}}
            env |= dict.fromkeys(model.inputs, 0.0)
            zero, one, two = (
                float(evaluate(term, {**env, position: at}, "numpy")) for at in (0.0, 1.0, 2.0)
            )
            if one != zero and abs(two - 2.0 * one + zero) <= 1e-12 * abs(one - zero):
                j = plant.positions.index(position)
                found[j] = model.column(output), one - zero, zero
        return Reach(plant, found)

    def __call__(self, recording: Recording) -> Recording:
        """Return a recording without the samples in which a limit or a contact acts.

        What is left out is at least so long that no run goes across it: behind it the state is
        another start.

        Raises
        ------
        InputError
            Next to nothing would be left.
        """
        poses = {
            j: (recording.channels[column] - offset) / scale
            for j, (column, scale, offset) in self.sensors.items()
            if column in recording.channels
        }
        acting = np.zeros(len(recording), bool)
        said: list[str] = []
        for j, values in poses.items():
            at = _at_limit(self.plant, j, recording.time, values)
            if at.any():
                what = f"joint {self.plant.joint_names[j]!r} is at its limit"
                said.append(_counted(what, at, recording.time))
                acting |= at
        if len(poses) == self.plant.m.njnt:
            table = np.stack([poses[j] for j in sorted(poses)], axis=1)
            for what, at in _touching(self.plant, table).items():
                said.append(_counted(what, at, recording.time))
                acting |= at
        return _without(recording, acting, said) if said else recording


def _counted(what: str, at: np.ndarray, time: np.ndarray) -> str:
    return f"{what} in {int(at.sum())} samples, first at {time[int(at.argmax())]:.4g} s"


def _without(recording: Recording, acting: np.ndarray, said: Sequence[str]) -> Recording:
    """Leave samples out, and after each stretch of them so many that it is a break in the rows."""
    time, left_out = recording.time, acting.copy()
    break_ = (SHORTEST + 0.5) * float(np.median(np.diff(time)))
    for first in np.flatnonzero(acting & ~np.r_[False, acting[:-1]]):
        if first > 0:
            left_out[first : np.searchsorted(time, time[first - 1] + break_)] = True
    # A stretch too short for a free run tells nothing that its start does not take.
    edges = np.flatnonzero(np.diff(np.r_[True, left_out, True].astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        left_out[first:last] |= last - first < SHORTEST
    more, count = f"; {said[1]}" if len(said) > 1 else "", int(acting.sum())
    more += f"; {len(said) - 2} more of the kind" if len(said) > 2 else ""
    if left_out.all():
        remedy = "If nothing held it write contacts = false or limits = false under [model]"
        raise InputError(f"{said[0]}{more}: nothing is left", recording.name, remedy)
    message = (
        f"{count} of {len(recording)} samples are left out, in which forces act that are in no "
        f"formula: {said[0]}{more}; with them {int(left_out.sum()) - count} beside them"
    )
    row = DataCheck(recording.name, "file", "masked", message, float(count))
    return replace(recording.select(~left_out), remarks=(*recording.remarks, row))


def _at_limit(plant: Plant, j: int, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return where a joint is beyond its range, or rests on an end of it."""
    m = plant.m
    off = plant.disabled("LIMIT") or plant.disabled("CONSTRAINT") or not m.jnt_limited[j]
    if off:
        return np.zeros(values.size, bool)
    low, high = (float(x) for x in m.jnt_range[j])
    good = np.isfinite(values)
    reach = NOISES * noise_level(time[good], values[good]) if good.sum() > 12 else 0.0
    # How far inside the range; a limit acts from its margin on.
    inside = np.minimum(values - low, high - values) - float(m.jnt_margin[j])
    near = inside <= reach
    rests = np.convolve(near, np.ones(RUN), mode="valid") >= RUN
    resting = np.convolve(rests, np.ones(RUN), mode="full") > 0.5
    return (inside < -reach) | resting


def _touching(plant: Plant, poses: np.ndarray) -> dict[str, np.ndarray]:
    """Return where geoms touch, by the pair in words."""
    found: dict[str, np.ndarray] = {}
    if plant.disabled("CONTACT") or plant.disabled("CONSTRAINT") or not plant.m.ngeom:
        return found
    library, m = mujoco(), copy.copy(plant.m)
    data, pairs = library.MjData(m), {}
    rows = np.flatnonzero(np.isfinite(poses).all(axis=1))
    rows = rows[:: max(1, -(-rows.size // MOST_POSES))]
    with quietly(library):
        for i, k in enumerate(rows):
            data.qpos = poses[k]
            library.mj_kinematics(m, data)
            library.mj_comPos(m, data)
            library.mj_collision(m, data)
            for c in range(data.ncon):
                if data.contact[c].exclude == 0:
                    pair = tuple(int(g) for g in data.contact[c].geom)
                    pairs.setdefault(pair, np.zeros(rows.size, bool))[i] = True
    for (a, b), at in pairs.items():
        what = f"geoms {plant.called('geom', a)!r} and {plant.called('geom', b)!r} touch"
        # Between two poses of which one is in contact they may touch as well.
        spread = np.interp(np.arange(len(poses)), rows, at.astype(float)) > 0.0
        spread[rows] = at
        found[what] = spread
    return found
