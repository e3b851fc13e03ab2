"""MJCF files of dm_control and gymnasium with effects planted in them, and recordings of both.

Truth is MuJoCo itself, at a twentieth of the sample interval. A recording starts at the file's
reference position, or off its limits; where the motion would run into them, a linear-quadratic
regulator holds it and the control that is recorded is its output with a sum of sines beside.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.linalg import solve_discrete_are

from benchmarks.mjcf_files import File, pose

SUBSTEPS = 20
SHARE = 0.15
"""Size of a planted force: its rms by that of the joint's inertial force."""
DRY = (0.001, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Solver values by which a joint that friction holds stands still. With those that are written for
a user's longer steps (0.004 s, 0.99) it creeps by more than the encoders' noise: a pendulum pushed
to and fro below its breakaway moved by 1.7e-3 of its motion else, and by 5e-5 with these."""
NOISE = 1e-3
"""Standard deviation of an encoder by that of the motion."""


@dataclass(frozen=True)
class Effect:
    """What is planted in a joint: an attribute of the MJCF, and the names that say it."""

    attribute: str
    names: tuple[str, ...]
    size: Callable[[Mapping[str, float]], float]


EFFECTS: dict[str, Effect | None] = {
    "coulomb": Effect("frictionloss", ("coulomb_friction",), lambda s: s["force"]),
    "quadratic": Effect("damping2", ("quadratic_drag",), lambda s: s["force"] / s["vv"]),
    "viscous": Effect("damping", ("viscous_damping", "wrong_value"), lambda s: s["force"] / s["v"]),
    "rotor": Effect("armature", ("added_mass", "wrong_value"), lambda s: SHARE * s["mass"]),
    "spring": Effect(
        "stiffness", ("linear_stiffness", "wrong_value"), lambda s: s["force"] / s["q"]
    ),
    "nothing": None,
}


def edited(file: File, values: Mapping[str, float], effect: Effect) -> Any:
    """Compile the file with an attribute of some joints changed by MuJoCo's own editor."""
    spec = file.spec()
    for joint, value in values.items():
        element = spec.joint(joint)
        if effect.attribute == "damping2":
            damping = np.array(element.damping, dtype=float)
            damping[1] += value
            element.damping = damping
        elif effect.attribute in ("damping", "stiffness"):
            both = np.array(getattr(element, effect.attribute), dtype=float)
            both[0] += value
            setattr(element, effect.attribute, both)
        else:
            setattr(element, effect.attribute, getattr(element, effect.attribute) + value)
    m = spec.compile()
    if effect.attribute == "frictionloss":
        dofs = [m.joint(joint).dofadr[0] for joint in values]
        bit = mujoco.mjtDisableBit
        if m.opt.disableflags & bit.mjDSBL_CONSTRAINT:  # friction alone, no floor to fall on
            m.opt.disableflags &= ~int(bit.mjDSBL_CONSTRAINT)
            others = (bit.mjDSBL_CONTACT, bit.mjDSBL_LIMIT, bit.mjDSBL_EQUALITY)
            m.opt.disableflags |= sum(map(int, others))
        for dof in dofs:
            m.dof_solref[dof], m.dof_solimp[dof] = DRY
    return m


def regulator(m: Any) -> np.ndarray:
    """Return the gain of a regulator about the pose of the file, shape (controls, states)."""
    data = mujoco.MjData(m)
    data.qpos[:] = pose(m)
    mujoco.mj_forward(m, data)
    a, b = np.zeros((2 * m.nv, 2 * m.nv)), np.zeros((2 * m.nv, m.nu))
    mujoco.mjd_transitionFD(m, data, 1e-6, True, a, b, None, None)
    cost = np.diag([1.0] * m.nv + [0.1] * m.nv)
    p = solve_discrete_are(a, b, cost, np.eye(m.nu))
    return np.linalg.solve(np.eye(m.nu) + b.T @ p @ b, b.T @ p @ a)


def holding(m: Any) -> np.ndarray:
    """Return the controls that hold the pose of the file against its springs and its weight."""
    data, moments = mujoco.MjData(m), np.zeros((m.nu, m.nv))
    data.qpos[:] = pose(m)
    mujoco.mj_forward(m, data)
    mujoco.mju_sparse2dense(
        moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
    )
    return np.linalg.lstsq(moments.T, data.qfrc_bias - data.qfrc_passive, rcond=None)[0]


@dataclass(frozen=True, eq=False)
class Run:
    """A recording with the states that nobody sees, shape (samples, 2 joints)."""

    time: np.ndarray
    states: np.ndarray
    controls: np.ndarray
    size: dict[str, dict[str, float]]


def run(file: File, m: Any, rng: np.random.Generator, samples: int) -> Run:
    """Run a compiled model under random sums of sines."""
    # Euler's steps would show beside encoders as good as these: half a step of delay.
    m.opt.timestep, m.opt.integrator = file.dt / SUBSTEPS, mujoco.mjtIntegrator.mjINT_RK4
    data, time = mujoco.MjData(m), np.arange(samples) * file.dt
    start = np.r_[pose(m), np.zeros(m.nv)]
    data.qpos[:] = start[: m.nv]
    top = np.where(m.actuator_ctrllimited, m.actuator_ctrlrange[:, 1], 1.0)
    waves = np.zeros((samples, m.nu))
    for i in range(m.nu):
        for _ in range(6):
            phase = 2 * np.pi * rng.uniform(0.1, 2.5) * time + rng.uniform(0.0, 2 * np.pi)
            waves[:, i] += rng.normal() * np.sin(phase)
        waves[:, i] *= file.amplitude * top[i] / np.abs(waves[:, i]).max()
    gain = None
    if file.balanced:
        slow = file.spec().compile()
        slow.opt.timestep, slow.opt.integrator = file.dt, 0
        gain = regulator(slow)
        waves += holding(m)
    rows, force, mass = np.empty((samples, 2 * m.nv)), np.empty((samples, m.nv)), np.zeros(m.nv)
    for k in range(samples):
        rows[k] = np.concatenate([data.qpos, data.qvel])
        if gain is not None:
            waves[k] = np.clip(waves[k] - gain @ (rows[k] - start), -top, top)
        data.ctrl = waves[k]
        mujoco.mj_forward(m, data)
        mujoco.mj_mulM(m, data, force[k], data.qacc)
        mass += np.diag(_dense(m, data)) / samples
        for _ in range(SUBSTEPS):
            mujoco.mj_step(m, data)
    q, v = rows[:, : m.nv], rows[:, m.nv :]
    size = {
        m.joint(j).name: {
            "force": SHARE * float(np.sqrt(np.mean(force[:, j] ** 2))),
            "q": float(np.sqrt(np.mean(q[:, j] ** 2))),
            "v": float(np.sqrt(np.mean(v[:, j] ** 2))),
            "vv": float(np.sqrt(np.mean(v[:, j] ** 4))),
            "mass": float(mass[j]),
        }
        for j in range(m.njnt)
    }
    return Run(time, rows, waves, size)


def _dense(m: Any, data: Any) -> np.ndarray:
    out = np.zeros((m.nv, m.nv))
    for j in range(m.nv):
        unit = np.zeros(m.nv)
        unit[j] = 1.0
        mujoco.mj_mulM(m, data, out[j], unit)
    return out


def write(m: Any, found: Run, rng: np.random.Generator, path: Path) -> None:
    """Write positions with the noise of encoders, and controls, as CSV."""
    q = found.states[:, : m.nv]
    q = q + NOISE * q.std(axis=0) * rng.normal(size=q.shape)
    names = [f"{m.joint(i).name}_pos" for i in range(m.njnt)]
    for i in range(m.nu):  # one without a name is called by its joint
        names.append(f"{m.actuator(i).name or m.joint(m.actuator_trnid[i, 0]).name}_ctrl")
    table = np.column_stack([found.time, q, found.controls])
    np.savetxt(path, table, "%.9g", ",", header=",".join(["time", *names]), comments="")
