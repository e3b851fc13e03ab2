"""Inertia of the rotors behind gears, which a URDF has no word for.

Seen from the joint a rotor weighs as much as the square of the gear's ratio makes it: more than the
last links of an arm. So a URDF's joints get an armature where the recordings tell one, free from 0
on, and the report says so.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from jaxsr._result import InputError
from jaxsr.models.formats.momentum import Asked, asked, unseen
from jaxsr.models.formats.plant import Plant, mujoco, quietly
from jaxsr.models.model import Model
from jaxsr.recordings import Recording

TOLD = 6.0
"""Standard errors from which an inertia is told: rows of a weak view overlap, and friction that is
of another kind than Coulomb and viscous is no noise."""


def with_rotors(plant: Plant, rotors: Mapping[int, float]) -> Plant:
    """Return the plant of a URDF with armature, by joint, in kg m^2 or kg."""
    if not rotors:
        return plant
    library = mujoco()
    with quietly(library):
        spec = library.MjSpec.from_string(plant.mjcf)
        m = copy.copy(plant.m)  # the text has six digits
        for j, value in rotors.items():
            spec.joint(plant.joint_names[j]).armature = value
            m.dof_armature[m.jnt_dofadr[j]] = value
        library.mj_setConst(m, library.MjData(m))
    return replace(plant, m=m, mjcf=spec.to_xml())


def rotors_of(plant: Plant, parameters: Any, where: str) -> dict[int, float]:
    """Return the armatures that the [parameters] of a sidecar give to the joints of a URDF.

    Raises
    ------
    InputError
        A value is no number above 0.
    """
    found = {}
    for j, name in enumerate(plant.joints if isinstance(parameters, Mapping) else ()):
        entry = parameters.get(f"armature_{name}")
        value = entry.get("value") if isinstance(entry, Mapping) else entry
        if value is None:
            continue
        if not isinstance(value, int | float) or isinstance(value, bool) or not value > 0.0:
            what = f"armature_{name} is no inertia above 0"
            raise InputError(
                what, f"{where} [parameters]", "Write { value = 0.1 }, or leave it out"
            )
        found[j] = float(value)
    return found


def told_rotors(plant: Plant, model: Model, recordings: Sequence[Recording]) -> dict[int, float]:
    """Estimate armatures from recorded efforts; joints that tell none are left out.

    Along every joint, with its drive's effort u and the force f that the motion asks for,

        u - f = Ia dv/dt + Fv v + Fc sign(v) + F0

    by least squares, all but F0 from 0 on.
    """
    m = plant.m
    if m.nu != m.nv or any(unseen(model, r) for r in recordings):
        return {}
    stretches = list(asked(plant, model, recordings))
    found = {}
    for i in range(m.nu):
        j = int(m.actuator_trnid[i, 0])
        rows = [_rows(i, j, float(m.actuator_gear[i, 0]), one) for one in stretches]
        value = _told(np.concatenate([np.zeros((0, 5)), *rows]))
        if value is not None:
            found[j] = float(f"{value:.3g}")
    return found


def _rows(i: int, j: int, gear: float, one: Asked) -> np.ndarray:
    view, q, v, effort = one.view, one.position[:, j], one.rate[:, j], one.inputs[:, i]
    kept = view.valid & view.covered(one.good & np.isfinite(effort))
    right = gear * view.integrate(np.nan_to_num(effort)) - one.force[:, j]
    columns = view.integrate(np.stack([v, np.sign(v), np.ones(v.size)], axis=1))
    return np.column_stack([view.integrate(q, 2), columns, right])[kept]


def _told(table: np.ndarray) -> float | None:
    """Return the inertia, None where it is not told from none."""
    columns, right = table[:, :4], table[:, 4]
    if len(table) < 16 or not np.isfinite(table).all():
        return None
    size = np.linalg.norm(columns, axis=0) + 1e-300
    bounds = np.array([0.0, 0.0, 0.0, -np.inf]), np.full(4, np.inf)
    found = lsq_linear(columns / size, right, bounds).x
    left = right - columns / size @ found
    others = columns[:, 1:] / size[1:]
    own = columns[:, 0] / size[0]
    own = own - others @ np.linalg.lstsq(others, own, rcond=None)[0]
    error = np.sqrt(np.mean(left**2)) / max(float(np.linalg.norm(own)), 1e-300)
    return float(found[0] / size[0]) if found[0] > TOLD * error else None
