"""Position loops around actuators: where logs hold targets, the inner loop is part of the model.

Most robots log the angle that is asked for and the angle that is reached, and no torque. The loop
of a controller then stands between the column and the joint,

    force = kp*(target - position) - kv*rate,

held inside the range of the motor's force. It is in no file of the robot. Where the sidecar does
not give its gains they are estimated, together with what friction takes, from the momentum that
the given bodies have (`estimated`).
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.models.formats.momentum import Asked, asked, unseen
from jaxsr.models.formats.plant import Loop, Plant, finite_range
from jaxsr.models.model import Model
from jaxsr.recordings import Recording

KEYS = ("kp", "kv")
LEAST = 1e-6
"""Seconds by which a loop leads below which it does not: kv that a bound of 0 held."""
TERMS, WIDTH = 5, 11
"""Terms of a loop's force, and columns of a table with its right side and five instruments."""


def motors(plant: Plant) -> list[int]:
    """Return the actuators that are plain motors of one joint: force = gain*control."""
    m = plant.m
    plain = (m.actuator_gaintype == 0) & (m.actuator_biastype == 0) & (m.actuator_dyntype == 0)
    plain &= np.isin(m.actuator_trntype, (0, 1)) & ~m.actuator_gainprm[:, 1:3].any(axis=1)
    return [int(i) for i in np.flatnonzero(plain)]


def with_loops(plant: Plant, loops: Mapping[int, Loop]) -> Plant:
    """Return a plant with position loops around motors; their controls are targets.

    The range of a motor's control becomes that of its force along the joint.
    """
    if not loops:
        return plant
    m = copy.copy(plant.m)
    for i, loop in loops.items():
        gain = float(m.actuator_gear[i, 0] * m.actuator_gainprm[i, 0])
        ends = [(-np.inf, np.inf)]
        if m.actuator_ctrllimited[i]:
            a, b = (gain * x for x in finite_range(m.actuator_ctrlrange[i]))
            ends.append((min(a, b), max(a, b)))
        if m.actuator_forcelimited[i]:
            gear = float(m.actuator_gear[i, 0])
            a, b = (gear * x for x in finite_range(m.actuator_forcerange[i]))
            ends.append((min(a, b), max(a, b)))
        low, high = max(a for a, _ in ends), min(b for _, b in ends)
        limited = bool(np.isfinite([low, high]).all())
        m.actuator_forcelimited[i], m.actuator_ctrllimited[i] = limited, 0
        m.actuator_forcerange[i] = (low, high) if limited else (0.0, 0.0)
        m.actuator_gear[i, 0] = 1.0
        m.actuator_biastype[i] = 1  # mjBIAS_AFFINE
        m.actuator_gainprm[i, :3] = loop.kp, 0.0, 0.0
        m.actuator_biasprm[i, :3] = 0.0, -loop.kp, -loop.kv
    return replace(plant, m=m, loops=dict(loops))


def loops_of(plant: Plant, table: Any, where: str) -> dict[int, Loop]:
    """Read the table [servos] of a sidecar: ACTUATOR = { kp = 20.0, kv = 1.5 }.

    Raises
    ------
    InputError
        It names no motor, or a gain is no number from 0 on.
    """
    place = f"{where} [servos]"
    if not isinstance(table, Mapping):
        raise InputError("[servos] is no table", where, "Write ACTUATOR = { kp = 20.0, kv = 1.0 }")
    found, known = {}, {plant.actuator_names[i]: i for i in motors(plant)}
    for name, entry in table.items():
        if name not in known:
            remedy = f"Known: {shortened(', '.join(known), 200) or 'none'}"
            raise InputError(f"{shortened(str(name))!r} is no motor of a joint", place, remedy)
        gains = entry if isinstance(entry, Mapping) else {}
        numbers = [gains.get("kp"), gains.get("kv", 0.0)]
        good = all(isinstance(x, int | float) and not isinstance(x, bool) for x in numbers)
        if not good or not set(gains) <= set(KEYS) or numbers[0] <= 0 or numbers[1] < 0:
            what = f"{shortened(str(name))} is no pair of gains"
            raise InputError(what, place, f"Write {name} = {{ kp = 20.0, kv = 1.0 }}")
        found[known[name]] = Loop(float(numbers[0]), float(numbers[1]))
    return found


def estimated(plant: Plant, model: Model, recordings: Sequence[Recording]) -> dict[int, Loop]:
    """Estimate the gains of loops from what the motion asks of the motors.

    With test functions phi, momentum p = M(q) v, and f the passive forces less gravity's and
    motion's,

        int phi (dp/dt - f - dM/dt v) dt = int phi (kp e - kv v - Fc sign(v) - Ia dv/dt + F0) dt,

    solved for kp, kv, Fc and a rotor's inertia Ia from 0 on by two-stage least squares: e follows
    the rate so closely that noise in either shrinks all gains, so all are seen through what the
    target and its rates do. kv is what remains beside the file's own damping: the two cannot be
    told apart.

    Raises
    ------
    InputError
        A joint has no sensor, or no gain follows.

    References
    ----------
    Young, Recursive Estimation and Time-Series Analysis (2011), chapter 6 (instruments).
    """
    for recording in recordings:
        if state := unseen(model, recording):
            what = f"gains of position loops are not to be had where {state} has no sensor"
            raise InputError(what, recording.name, "Write [servos] in the sidecar")
    stretches = list(asked(plant, model, recordings))
    loops = {}
    for i in plant.loops:
        name = plant.actuator_names[i]
        table = np.concatenate([np.zeros((0, WIDTH)), *(_rows(plant, i, x) for x in stretches)])
        if len(table) < 8 or not np.isfinite(table).all():
            raise InputError(f"too short to tell the gains of {name!r}", recordings[0].name)
        kp, kv = _gains(table[:, :TERMS], table[:, TERMS], table[:, TERMS + 1 :])
        if not kp > 0.0:
            what = f"the target of {name!r} asks for no force in the way of a position loop"
            raise InputError(what, recordings[0].name, "Write [servos] in the sidecar")
        loops[i] = Loop(_rounded(kp), _rounded(kv) if kv > LEAST * kp else 0.0, estimated=True)
    return loops


def _gains(columns: np.ndarray, right: np.ndarray, seen: np.ndarray) -> tuple[float, float]:
    """Return kp and kv: least squares on what of the columns the instruments `seen` tell."""
    basis, strength, _ = np.linalg.svd(
        seen / (np.linalg.norm(seen, axis=0) + 1e-300), full_matrices=False
    )
    basis = basis[:, strength > 1e-9 * strength[0]]
    told = basis @ (basis.T @ columns)
    size = np.linalg.norm(told, axis=0) + 1e-300
    bounds = np.array([0.0, 0.0, 0.0, 0.0, -np.inf]), np.full(TERMS, np.inf)
    kp, kv, *_ = lsq_linear(told / size, basis @ (basis.T @ right), bounds).x / size
    return float(kp), float(kv)


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _rows(plant: Plant, i: int, one: Asked) -> np.ndarray:
    """Return the rows of one stretch: `TERMS` columns, right side, instruments."""
    view, j = one.view, int(plant.m.actuator_trnid[i, 0])
    q, v, target = one.position[:, j], one.rate[:, j], one.inputs[:, i]
    kept = view.valid & view.covered(one.good & np.isfinite(target))
    target = np.nan_to_num(target)
    columns = [target - q, -v, -np.sign(v), np.ones(q.size)]
    table = view.integrate(np.stack(columns, axis=1))
    seen = [view.integrate(target, k) for k in range(3)]
    seen.append(view.integrate(np.sign(np.gradient(target, one.time))))
    parts = [table[:, :3], -view.integrate(q, 2), table[:, 3], one.force[:, j], *seen, table[:, 3]]
    return np.column_stack(parts)[kept]
