"""Whether formulas say what MuJoCo computes: accelerations at random states and controls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate
from jaxsr.models.formats.plant import Plant, finite_range, mujoco, quietly
from jaxsr.models.model import Model

POINTS = 24
SAME = 1e-9
"""Difference of forces, relative to their size, up to which it is rounding."""
FLOOR = 1e-4
"""Share of the largest joint's force that counts as force of every joint: rounding is of that."""
ONCE = 2.0
"""Largest position in rad or m, rate and control at which a model without ranges is compared."""


def check_agreement(plant: Plant, model: Model, inside: frozenset[str] = frozenset()) -> float:
    """Compare forces and inertias with MuJoCo's, contacts, limits and dry friction apart.

    Parameters
    ----------
    plant : Plant
    model : Model
        Its formulas, nothing edited.
    inside : frozenset of str
        Inputs that are compared inside the range of their control alone.

    Returns
    -------
    float
        The largest difference, relative to the size of the forces.

    Raises
    ------
    InputError
        They differ: something acts that the formulas do not have.
    """
    points = random_points(plant, np.random.default_rng(0), inside)
    own, theirs = forces_at(plant, model, points), mujoco_forces(plant, points)
    # Compared as forces and inertias: where a link has next to none, accelerations are rounding.
    scale = np.sqrt(np.einsum("kii->ki", own[0]))
    inertia = np.abs(own[0] - theirs[0]) / (scale[:, :, None] * scale[:, None, :])
    force = np.abs(own[1] - theirs[1]).max(axis=0)
    size = np.abs(theirs[2]).max(axis=0)
    force = force / (size + FLOOR * size.max() + 1e-300)
    inertia = inertia.max(axis=(0, 2)) * (scale / scale.max()).max(axis=0).clip(FLOOR)
    difference = np.maximum(force, inertia)
    worst = int(np.argmax(np.nan_to_num(difference, nan=np.inf)))
    if not difference[worst] <= SAME:
        what = (
            f"MuJoCo's force or inertia of joint {plant.joint_names[worst]!r} differs from that of "
            f"the formulas by {difference[worst]:.1g} of its size"
        )
        remedy = "Something acts on it that is not covered; take it out, or name a TOML"
        raise InputError(what, plant.path.name, remedy)
    return float(difference[worst])


def random_points(
    plant: Plant, rng: np.random.Generator, inside: frozenset[str] = frozenset()
) -> dict[str, np.ndarray]:
    """Return random positions, rates, controls and activations, each (points, elements)."""
    m = plant.m
    ranges = [
        finite_range(m.jnt_range[i]) if m.jnt_limited[i] else (-ONCE, ONCE) for i in range(m.njnt)
    ]
    low, high = np.array(ranges).T
    centre = m.qpos0 if m.nq == m.njnt else np.zeros(m.njnt)
    free = ~m.jnt_limited.astype(bool)
    q = rng.uniform(low, high, (POINTS, m.njnt)) + np.where(free, centre, 0.0)
    controls = np.tile([-ONCE, ONCE], (m.nu, 1)).reshape(m.nu, 2)
    for i in np.flatnonzero(m.actuator_ctrllimited):
        a, b = m.actuator_ctrlrange[i]
        # A little beyond its range too, where it is clamped.
        more = 0.0 if plant.inputs[i] in inside else 0.1 * (b - a)
        controls[i] = a - more, b + more
    return {
        "q": q,
        "v": rng.uniform(-ONCE, ONCE, (POINTS, m.nv)),
        "u": rng.uniform(controls[:, 0], controls[:, 1], (POINTS, m.nu))
        if m.nu
        else np.zeros((POINTS, 0)),
        "act": rng.uniform(-1.0, 1.0, (POINTS, m.na)),
    }


def mujoco_forces(
    plant: Plant, points: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return MuJoCo's mass matrices, forces, and the sum of what the forces consist of."""
    library, m = mujoco(), plant.m
    data, n = library.MjData(m), m.nv
    mass, force, size = np.empty((POINTS, n, n)), np.empty((POINTS, n)), np.empty((POINTS, n))
    with quietly(library):
        for k in range(POINTS):
            data.qpos, data.qvel, data.ctrl = points["q"][k], points["v"][k], points["u"][k]
            if m.na:
                data.act = points["act"][k]
            library.mj_forward(m, data)
            for j, unit in enumerate(np.eye(n)):
                library.mj_mulM(m, data, mass[k, j], unit)
            parts = data.qfrc_passive, data.qfrc_actuator, -data.qfrc_bias
            force[k], size[k] = sum(parts), sum(np.abs(p) for p in parts)
    return mass, force, size


def mujoco_accelerations(plant: Plant, points: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return MuJoCo's accelerations, contacts, limits and dry friction off."""
    import copy

    library, m = mujoco(), copy.copy(plant.m)
    m.opt.disableflags |= int(library.mjtDisableBit.mjDSBL_CONSTRAINT)
    data, found = library.MjData(m), np.empty_like(points["v"])
    with quietly(library):
        for k in range(len(found)):
            data.qpos, data.qvel, data.ctrl = points["q"][k], points["v"][k], points["u"][k]
            if m.na:
                data.act = points["act"][k]
            library.mj_forward(m, data)
            found[k] = data.qacc
    return found


def model_accelerations(plant: Plant, model: Model, points: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the accelerations that the formulas say, dry friction left out."""
    mass, force = forces_at(plant, model, points)
    return np.linalg.solve(mass, force[..., None])[..., 0]


def forces_at(
    plant: Plant, model: Model, points: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return mass matrices and forces that the formulas say, dry friction left out."""
    env = environment(plant, model, points)
    env |= {p: 0.0 for p in model.parameters if p.startswith("frictionloss_")}
    shared: dict[Term, Any] = {}

    def value(term: Term) -> np.ndarray:
        return np.broadcast_to(evaluate(term, env, "numpy", shared), (POINTS,))

    count = len(plant.rates)
    mass = np.zeros((POINTS, count, count))
    force = np.stack([value(model.equation_terms[v]) for v in plant.rates], axis=1)
    for i, row in enumerate(plant.rates):
        for column, term in model.inertia_terms[row].items():
            mass[:, i, plant.rates.index(column)] = value(term)
    return mass, force


def environment(plant: Plant, model: Model, points: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return values of a model's symbols at the points."""
    env: dict[str, Any] = {model.time: 0.0}
    env |= {n: p.value for n, p in model.parameters.items()}
    env |= dict(zip(plant.positions, points["q"].T, strict=True))
    env |= dict(zip(plant.rates, points["v"].T, strict=True))
    env |= dict(zip(plant.inputs, points["u"].T, strict=True))
    order = sorted(plant.activations, key=lambda i: int(plant.m.actuator_actadr[i]))
    acts = [plant.activations[i] for i in order]
    env |= dict(zip(acts, points["act"].T, strict=True))
    return env
