"""The moving links of a serial arm, read from a URDF."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from xml.etree import ElementTree

import numpy as np

from jaxsr._result import InputError

SNAP = 1e-9
"""Distance from 0, 1 or -1 below which a cosine stands for that number: a URDF rounds pi/2."""
AXES = "xyz"


@dataclass(frozen=True)
class Body:
    """A moving link of an arm with what is fixed to it, and the joint that carries it.

    With r the place in the link, its origin on the joint, and dm the mass there,

        mass = int dm,    moment h = int r dm,    spread S = int r r' dm.

    Attributes
    ----------
    axis : ndarray, shape (3,)
        Of the joint, a unit vector in coordinates of the link.
    place, turn : ndarray, shapes (3,) and (3, 3)
        Origin and orientation of the link in coordinates of the one before, at angle zero.
    mass : float
        In kg.
    moment, spread : ndarray, shapes (3,) and (3, 3)
        h and S in kg m and kg m^2.
    """

    axis: np.ndarray
    place: np.ndarray
    turn: np.ndarray
    mass: float = 0.0
    moment: np.ndarray = field(default_factory=lambda: np.zeros(3))
    spread: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    def carrying(self, link: ElementTree.Element, place: np.ndarray, turn: np.ndarray) -> Body:
        """Return the body with the mass of a link that sits on it at `place` and `turn`."""
        inertial = link.find("inertial")
        if inertial is None:
            return self
        mass = float(_of(inertial, "mass").get("value", "0"))
        own = _of(inertial, "inertia")
        i = np.array(
            [[float(own.get(f"i{min(a, b)}{max(a, b)}", "0")) for a in AXES] for b in AXES]
        )
        centre, tilt = _origin(inertial)
        centre, tilt = place + turn @ centre, turn @ tilt
        spread = tilt @ (0.5 * np.trace(i) * np.eye(3) - i) @ tilt.T
        return replace(
            self,
            mass=self.mass + mass,
            moment=self.moment + mass * centre,
            spread=self.spread + spread + mass * np.outer(centre, centre),
        )


def read_arm(urdf: str) -> list[Body]:
    """Read the moving links of a serial arm, the first one first.

    Parameters
    ----------
    urdf : str
        Text of a URDF with revolute and fixed joints. Fixed links count to what carries them.

    Raises
    ------
    InputError
        The text is no URDF, the arm branches, or a joint slides.
    """
    try:
        robot = ElementTree.fromstring(urdf)
    except ElementTree.ParseError as error:
        raise InputError(f"is no XML: {error}", "URDF") from None
    links = {link.get("name", ""): link for link in robot.findall("link")}
    joints: dict[str, list[ElementTree.Element]] = {name: [] for name in links}
    children = set()
    for joint in robot.findall("joint"):
        joints[_of(joint, "parent").get("link", "")].append(joint)
        children.add(_of(joint, "child").get("link", ""))
    bodies = [Body(np.zeros(3), np.zeros(3), np.eye(3))]  # the ground, as if it moved
    rigid = [(name, np.zeros(3), np.eye(3)) for name in links if name not in children]
    while rigid:
        moving = []
        while rigid:
            name, place, turn = rigid.pop()
            bodies[-1] = bodies[-1].carrying(links[name], place, turn)
            for joint in joints[name]:
                at, tilt = _origin(joint)
                child = _of(joint, "child").get("link", "")
                at, tilt = place + turn @ at, turn @ tilt
                if joint.get("type") == "fixed":
                    rigid.append((child, at, tilt))
                else:
                    moving.append(Body(_axis(joint), at, tilt))
                    after = [(child, np.zeros(3), np.eye(3))]
        if len(moving) > 1:
            raise InputError("the arm branches", "URDF", "Leave one moving joint to each link")
        if moving:
            bodies, rigid = [*bodies, *moving], after
    return bodies[1:]


def _axis(joint: ElementTree.Element) -> np.ndarray:
    if joint.get("type") not in ("revolute", "continuous"):
        what = f"a {joint.get('type')} joint"
        raise InputError(what, f"URDF {joint.get('name')}", "Only joints that turn are read")
    found = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if found is None else _numbers(found.get("xyz", "1 0 0"))
    return axis / np.linalg.norm(axis)


def _of(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    found = element.find(tag)
    if found is None:
        raise InputError(f"no <{tag}>", f"URDF {element.tag} {element.get('name', '')}".rstrip())
    return found


def _numbers(text: str) -> np.ndarray:
    return np.array([float(part) for part in text.split()])


def _origin(element: ElementTree.Element) -> tuple[np.ndarray, np.ndarray]:
    """Return place and orientation, which a URDF writes as turns about fixed x, y, z."""
    found = element.find("origin")
    if found is None:
        return np.zeros(3), np.eye(3)
    turn = np.eye(3)
    for k, angle in enumerate(_numbers(found.get("rpy", "0 0 0"))):
        turn = turned(np.eye(3)[k], math.cos(angle), math.sin(angle)) @ turn
    return _numbers(found.get("xyz", "0 0 0")), turn


def turned(axis: np.ndarray, cosine: float, sine: float) -> np.ndarray:
    """Return Rodrigues' rotation about a unit vector."""
    skew = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    across = np.eye(3) - np.outer(axis, axis)
    return _snapped(np.outer(axis, axis) + cosine * across + sine * skew)


def _snapped(values: np.ndarray) -> np.ndarray:
    whole = np.round(values)
    return np.where(np.abs(values - whole) < SNAP, whole, values)
