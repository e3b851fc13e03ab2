"""A compiled MuJoCo model as the tables of a formula model."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np

from jaxsr.models.formats.forces import Written, actuator_forces, joined, passive_forces
from jaxsr.models.formats.inertial import inertial_readings
from jaxsr.models.formats.links import links_of
from jaxsr.models.formats.mechanics import Mechanics
from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.script import text_of

SOLID = 1e-10
"""Inertia against the largest one below which a joint moves nothing: MuJoCo would refuse it."""


def mechanics_of(plant: Plant) -> tuple[Mechanics, list[str]]:
    """Return the mechanics of a plant, nothing written yet, and the symbols of its masses."""
    links = links_of(plant.m)
    masses = [f"mass_{plant.bodies[link.body]}" for link in links]
    strength = float(np.linalg.norm(plant.gravity))
    direction = plant.gravity / strength if strength else np.zeros(3)
    # MuJoCo numbers joints as it numbers the bodies that have them, so links stand in their order.
    return Mechanics(links, plant.positions, plant.rates, masses, direction), masses


def tables_of(
    plant: Plant,
    unclamped: frozenset[str] = frozenset(),
    step: float = math.inf,
    readings: Collection[str] = (),
) -> dict[str, Any]:
    """Return the tables of the model file that says what a MuJoCo model says.

    The states are the joints' positions ``q_JOINT`` and rates ``v_JOINT`` and the activations of
    actuators; the rows of [inertia] stand in force units, N m for hinges and N for slides:

        sum_j M_ij(q) dv_j/dt = drives - passive forces - load_i(q, v)

    Free are dampings, friction losses, armatures and gains that are not zero, and time constants.
    Masses are fixed parameters: a mass stands for a link with all that is welded to it, its shape
    as it is. There are no readings yet.

    Parameters
    ----------
    plant : Plant
    unclamped : frozenset of str
        Inputs that never leave the range of their control.
    step : float
        Sample time of the recordings in s, which bounds what damping they can tell.
    readings : collection of str
        Expressions of sensors, whose definitions are kept.
    """
    mechanics, masses = mechanics_of(plant)
    links, strength = mechanics.links, float(np.linalg.norm(plant.gravity))
    count = len(links)
    loads, matrix = mechanics.loads(), mechanics.mass_matrix()
    if readings:
        inertial_readings(plant, mechanics)
    out = Written(forces=[[] for _ in links])
    passive_forces(plant, out, step)
    actuator_forces(plant, out, unclamped)
    for link, mass in zip(links, masses, strict=True):
        if link.mass > 0.0:
            out.parameter(mass, link.mass, "kg")
    if strength:
        out.parameter("g", strength, "m/s^2")
    out.parameter("metre", 1.0, "m")
    equations = dict(zip(plant.positions, plant.rates, strict=True))
    inertia: dict[str, dict[str, str]] = {}
    for i in range(count):
        load = text_of(loads[i])
        terms = [*out.forces[i], *([f"- ({load})"] if load != "0" else [])]
        equations[plant.rates[i]] = joined(terms)
        row = {}
        for j in range(count):
            terms = [text_of(matrix[i][j])] if matrix[i][j] else []
            terms += [out.inertias[i]] if i == j and i in out.inertias else []
            if terms:
                row[plant.rates[j]] = " + ".join(terms)
        inertia[plant.rates[i]] = row
    equations |= out.equations
    units = out.units
    for i, (q, v) in enumerate(zip(plant.positions, plant.rates, strict=True)):
        if equations[v] == "0":  # a number alone has no unit
            continue
        units[q] = "rad" if plant.turns(i) else "m"
        units[v] = f"{units[q]}/s"
    texts = [*equations.values(), *(text for row in inertia.values() for text in row.values())]
    own = {**mechanics.script.lines}
    texts += readings
    needed = mechanics.script.needed([*texts, *out.definitions.values()])
    parameters = _used(out.parameters, [*texts, *out.definitions.values(), *needed.values()])
    return {
        "model": {
            "name": plant.path.stem,
            "time": "t",
            "states": [*plant.positions, *plant.rates, *plant.activations.values()],
            "inputs": list(plant.inputs),
            "outputs": [],
            # Efforts of a URDF are measured; controls of an MJCF are held over a step.
            "input_hold": "linear" if plant.mjcf else "zero",
        },
        "definitions": {**{n: own[n] for n in needed}, **out.definitions},
        "equations": equations,
        "inertia": inertia,
        "readings": {},
        "parameters": parameters,
        "delays": dict(out.delays),
        "units": units,
    }


def _used(parameters: dict[str, dict[str, Any]], texts: list[str]) -> dict[str, dict[str, Any]]:
    """Leave out parameters that no expression has."""
    import re

    names = {name for text in texts for name in re.findall(r"[A-Za-z_]\w*", text)}
    return {name: entry for name, entry in parameters.items() if name in names}
