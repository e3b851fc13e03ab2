"""A leg of a robot, read from its MJCF (MuJoCo's XML): one chain of bodies with a hinge each."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np

from jaxsr._result import InputError
from jaxsr.datasets.urdf import Body

PASSIVE = ("damping", "frictionloss", "armature")
Defaults = Mapping[str, Mapping[str, str]]


def read_leg(mjcf: str, first: str) -> tuple[list[Body], list[dict[str, float]]]:
    """Read the bodies of a leg, the first one first, and what its joints have by themselves.

    Parameters
    ----------
    mjcf : str
        Text of an MJCF with angles in radian, inertias as ``diaginertia``, and hinges in the
        origins of their bodies.
    first : str
        Name of the body that the base carries.

    Returns
    -------
    bodies : list of Body
    passive : list of dict
        ``damping``, ``frictionloss`` and ``armature`` of every joint, in SI units.

    Raises
    ------
    InputError
        No such body, or the leg branches.
    """
    robot = ElementTree.fromstring(mjcf)
    defaults = _defaults(robot.find("default"))
    parent = {child: body for body in robot.iter("body") for child in body.findall("body")}
    body = next((b for b in robot.iter("body") if b.get("name") == first), None)
    if body is None:
        raise InputError(f"no body {first!r}", "MJCF", "Name the first body of the leg")
    inherited = _class_above(body, parent)
    bodies, passive = [], []
    while body is not None:
        inherited = body.get("childclass", inherited)
        hinge = body.find("joint")
        if hinge is None:
            raise InputError("a body without a joint", f"MJCF {body.get('name')}")
        of_joint = {**defaults.get(hinge.get("class", inherited), {}), **hinge.attrib}
        bodies.append(_body(body, of_joint))
        passive.append({name: float(of_joint.get(name, "0")) for name in PASSIVE})
        carried = body.findall("body")
        if len(carried) > 1:
            raise InputError("the leg branches", f"MJCF {body.get('name')}")
        body = carried[0] if carried else None
    return bodies, passive


def _class_above(
    body: ElementTree.Element, parent: Mapping[ElementTree.Element, ElementTree.Element]
) -> str:
    """Return the class of joints that the nearest body above sets for its children."""
    while body in parent:
        body = parent[body]
        if "childclass" in body.attrib:
            return body.attrib["childclass"]
    return "main"


def _defaults(element: ElementTree.Element | None) -> Defaults:
    """Return what a class says about joints, with what the classes around it say."""
    found: dict[str, Mapping[str, str]] = {}

    def collect(default: ElementTree.Element, above: Mapping[str, str]) -> None:
        joint = default.find("joint")
        own = {**above, **(joint.attrib if joint is not None else {})}
        found[default.get("class", "main")] = own
        for inner in default.findall("default"):
            collect(inner, own)

    if element is not None:
        collect(element, {})
    return found


def _body(body: ElementTree.Element, joint: Mapping[str, str]) -> Body:
    inertial = body.find("inertial")
    if inertial is None:
        raise InputError("no <inertial>", f"MJCF {body.get('name')}")
    mass = float(inertial.get("mass", "0"))
    centre = _numbers(inertial.get("pos", "0 0 0"))
    tilt = _rotation(_numbers(inertial.get("quat", "1 0 0 0")))
    i = np.diag(_numbers(inertial.get("diaginertia", "0 0 0")))
    spread = tilt @ (0.5 * np.trace(i) * np.eye(3) - i) @ tilt.T
    return Body(
        axis=_numbers(joint.get("axis", "0 0 1")),
        place=_numbers(body.get("pos", "0 0 0")),
        turn=_rotation(_numbers(body.get("quat", "1 0 0 0"))),
        mass=mass,
        moment=mass * centre,
        spread=spread + mass * np.outer(centre, centre),
    )


def _numbers(text: str) -> np.ndarray:
    return np.array([float(part) for part in text.split()])


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation of a quaternion w, x, y, z of any length."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * skew + 2.0 * skew @ skew
