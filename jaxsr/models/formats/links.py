"""The moving links of a compiled MuJoCo model: a tree with one hinge or slide to a link."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

SNAP = 1e-12
"""Distance from 0, 1 or -1, relative to the largest entry, that rounding leaves."""


@dataclass(frozen=True)
class Link:
    """A rigid body that one joint moves, with all that is welded to it.

    Coordinates have their origin on the joint. With r the place in the link and dm the mass there,

        mass = int dm,    moment h = int r dm,    spread S = int r r' dm.

    A body with several joints is a row of links of which the last one has the mass.

    Attributes
    ----------
    joint : int
        Its number in MuJoCo's model.
    parent : int or None
        Index of the link that carries it, None for the world.
    slides : bool
        Whether the joint is a slide; a hinge else.
    axis : ndarray, shape (3,)
        Of the joint, a unit vector in coordinates of the link.
    place, turn : ndarray, shapes (3,) and (3, 3)
        Origin in m and orientation in coordinates of the parent, at the reference position.
    reference : float
        Joint position at which the link stands so, in rad or m.
    body : int
        Number of the body whose mass it has.
    mass, moment, spread : float, ndarray of shape (3,) and (3, 3)
        In kg, kg m and kg m^2.
    """

    joint: int
    parent: int | None
    slides: bool
    axis: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    reference: float
    body: int
    mass: float = 0.0
    moment: np.ndarray = field(default_factory=lambda: np.zeros(3))
    spread: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))


Frame = tuple[int | None, np.ndarray, np.ndarray]
"""Link that carries a body, None for the world, and the body's place and orientation in it."""


def links_of(m: Any) -> list[Link]:
    """Return the links of a compiled model (``mujoco.MjModel``), parents first.

    The joints are hinges and slides. A joint turns or moves what follows about the place that it
    has in its body, in the order of the file.
    """
    return _tree(m)[0]


def frames_of(m: Any) -> dict[int, Frame]:
    """Return where every body stands in its link."""
    return _tree(m)[1]


def _tree(m: Any) -> tuple[list[Link], dict[int, Frame]]:
    found: list[dict[str, Any]] = []
    frames: dict[int, Frame] = {}
    frames[0] = (None, np.zeros(3), np.eye(3))
    for body in range(1, m.nbody):
        link, place, turn = frames[int(m.body_parentid[body])]
        place = place + turn @ m.body_pos[body]
        turn = snapped(turn @ rotation(m.body_quat[body]))
        first = int(m.body_jntadr[body])
        for joint in range(first, first + int(m.body_jntnum[body])):
            anchor = m.jnt_pos[joint]
            found.append(
                {
                    "joint": joint,
                    "parent": link,
                    "slides": int(m.jnt_type[joint]) == 2,  # mjJNT_SLIDE
                    "axis": snapped(m.jnt_axis[joint]),
                    "place": place + turn @ anchor,
                    "turn": turn,
                    "reference": float(m.qpos0[m.jnt_qposadr[joint]]),
                    "body": body,
                    "mass": 0.0,
                    "moment": np.zeros(3),
                    "spread": np.zeros((3, 3)),
                }
            )
            link, place, turn = len(found) - 1, -anchor, np.eye(3)
        frames[body] = (link, place, turn)
        if link is not None:
            _carry(found[link], m, body, place, turn)
    links = [
        Link(**{**row, **{name: snapped(row[name]) for name in ("place", "moment", "spread")}})
        for row in found
    ]
    return links, frames


def _carry(row: dict[str, Any], m: Any, body: int, place: np.ndarray, turn: np.ndarray) -> None:
    """Add a body's mass to a link, in whose coordinates the body lies at `place` and `turn`."""
    mass, inertia = float(m.body_mass[body]), np.diag(m.body_inertia[body])
    centre = place + turn @ m.body_ipos[body]
    tilt = turn @ rotation(m.body_iquat[body])
    spread = tilt @ (0.5 * np.trace(inertia) * np.eye(3) - inertia) @ tilt.T
    row["mass"] += mass
    row["moment"] = row["moment"] + mass * centre
    row["spread"] = row["spread"] + spread + mass * np.outer(centre, centre)


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation of a quaternion w, x, y, z of any length."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return snapped(np.eye(3) + 2.0 * w * skew + 2.0 * skew @ skew)


def snapped(values: np.ndarray) -> np.ndarray:
    """Return values without what rounding left of zeros, and of ones in rotations."""
    size = float(np.abs(values).max(initial=0.0))
    out = np.where(np.abs(values) <= SNAP * size, 0.0, values)
    return np.where(np.abs(np.abs(out) - 1.0) <= SNAP, np.sign(out), out)
