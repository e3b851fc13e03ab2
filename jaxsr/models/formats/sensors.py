"""Sensors of a MuJoCo model that read what joints, tendons and actuators do."""

from __future__ import annotations

from collections.abc import Mapping

from jaxsr.models.formats.formulas import mechanics_of
from jaxsr.models.formats.inertial import has_inertial, inertial_readings
from jaxsr.models.formats.plant import Plant

JOINTPOS, JOINTVEL = 9, 10
TENDONPOS, TENDONVEL, ACTUATORPOS, ACTUATORVEL = 11, 12, 13, 14


def sensor_readings(plant: Plant, units: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Return name, expression and unit of the sensors that formulas cover.

    Parameters
    ----------
    plant : Plant
    units : mapping of str to str
        Of the model's states.
    """
    m, found = plant.m, []
    for i in range(m.nsensor):
        kind, element = int(m.sensor_type[i]), int(m.sensor_objid[i])
        name = plant.called("sensor", i)
        states = plant.rates if kind in (JOINTVEL, TENDONVEL, ACTUATORVEL) else plant.positions
        if kind in (JOINTPOS, JOINTVEL):
            found.append((name, states[element], units.get(states[element], "")))
        elif kind in (TENDONPOS, TENDONVEL):
            row = plant.tendon_arms[element]
            text = " + ".join(
                f"({a!r})*{s}" for a, s in zip(row.tolist(), states, strict=True) if a
            )
            found.append((name, text, ""))
        elif kind in (ACTUATORPOS, ACTUATORVEL) and int(m.actuator_trntype[element]) in (0, 1):
            state = states[int(m.actuator_trnid[element, 0])]
            gear = float(m.actuator_gear[element, 0])
            found.append((name, f"({gear!r})*{state}", units.get(state, "")))
    if has_inertial(plant):
        mechanics, _ = mechanics_of(plant)
        mechanics.loads()
        mechanics.mass_matrix()
        found += inertial_readings(plant, mechanics)
    return found
