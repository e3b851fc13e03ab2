"""Gyros and accelerometers on moving links, as expressions of the joints' motion.

A gyro reads the angular rate of its site, an accelerometer the acceleration less gravity, both in
the directions of the site. With w, a and B of the link at zero joint accelerations (`Mechanics`)
and the site at r,

    gyro = w,    accelerometer = a + B r + sum_j J_j(q) dv_j/dt,

where J_j is how the site follows joint j.
"""

from __future__ import annotations

import numpy as np

from jaxsr.models.formats.links import frames_of, rotation
from jaxsr.models.formats.mechanics import NOTHING, Mechanics
from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.script import (
    AXES,
    Vector,
    added,
    applied,
    cross,
    number,
    plus,
    text_of,
    times,
    transposed,
)

ACCELEROMETER, GYRO = 1, 3
UNITS = {ACCELEROMETER: "m/s^2", GYRO: "rad/s"}


def has_inertial(plant: Plant) -> bool:
    """Whether there is such a sensor."""
    return bool(np.isin(plant.m.sensor_type, (ACCELEROMETER, GYRO)).any())


def inertial_readings(plant: Plant, mechanics: Mechanics) -> list[tuple[str, str, str]]:
    """Return names with their axis, expressions and units; definitions go to the script.

    Parameters
    ----------
    plant : Plant
    mechanics : Mechanics
        Its loads and its mass matrix written.
    """
    m, frames, found = plant.m, frames_of(plant.m), []
    for i in range(m.nsensor):
        kind, site = int(m.sensor_type[i]), int(m.sensor_objid[i])
        if kind not in UNITS:
            continue
        link, place, turn = frames[int(m.site_bodyid[site])]
        if link is None:  # it stands on the ground
            continue
        place = place + turn @ m.site_pos[site]
        turn = turn @ rotation(m.site_quat[site])
        back = [[number(x) for x in row] for row in turn.T]
        w, _, a, swirl = mechanics.motion[link]
        if kind == GYRO:
            values = applied(back, w)
        else:
            at = [number(x, "metre") for x in place]
            values = applied(back, added(a, applied(swirl, at)))
            values = mechanics.script.vector(f"A{i + 1}_", values)
            for joint, follows in _followed(mechanics, link, at):
                rate = number(1.0, f"d({plant.rates[joint]})")
                follows = mechanics.script.vector(f"J{i + 1}_{joint + 1}_", applied(back, follows))
                values = [plus(x, times(y, rate)) for x, y in zip(values, follows, strict=True)]
        name = plant.called("sensor", i)
        found += [
            (f"{name}_{axis}", text_of(value), UNITS[kind])
            for axis, value in zip(AXES, values, strict=True)
            if value
        ]
    return found


def _followed(mechanics: Mechanics, link: int, at: Vector) -> list[tuple[int, Vector]]:
    """Return how a place of a link follows the joints that carry it, in the link's coordinates."""
    chain = [link]
    while (parent := mechanics.links[chain[0]].parent) is not None:
        chain.insert(0, parent)
    moved: list[tuple[int, Vector, Vector]] = []  # joint, angular and linear acceleration
    for k in chain:
        back, place = transposed(mechanics.turns[k]), mechanics.places[k]
        carried = []
        for joint, spin, line in moved:
            name = f"{joint + 1}_{k + 1}_"
            line = applied(back, added(line, cross(spin, place)))
            spin = mechanics.script.vector(f"Q{name}", applied(back, spin))
            carried.append((joint, spin, mechanics.script.vector(f"L{name}", line)))
        own, axis = mechanics.links[k], mechanics.axes[k]
        moved = [*carried, (own.joint, *((NOTHING, axis) if own.slides else (axis, NOTHING)))]
    return [(joint, added(line, cross(spin, at))) for joint, spin, line in moved]
