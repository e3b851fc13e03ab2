"""URDF as a simulator: cleaned, compiled by MuJoCo, with an effort along every joint.

Files in the wild seldom load as they are: meshes of packages that are not there, tags and prefixes
of other programs, links without inertia, inertias that no body has. What is mended here is said in
``data_checks``, each repair in a line.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.models.formats.plant import MOST_BYTES, Plant, mujoco, quietly, refuse
from jaxsr.models.formats.xml_text import Document

KNOWN = ("link", "joint")
SHAPES = ("visual", "collision")
KINDS = ("revolute", "continuous", "prismatic", "fixed")
LEAST_MASS, LEAST_INERTIA = 1e-6, 1e-9
"""Mass in kg and inertia in kg m^2 of a moving link that has none: MuJoCo asks for more than 0."""


@dataclass
class Cleaned:
    """A URDF that MuJoCo reads.

    Attributes
    ----------
    root : Element
    repairs : list of str
        What was mended or left out, a line each.
    """

    root: ElementTree.Element
    repairs: list[str] = field(default_factory=list)


def read_urdf(path: str | Path) -> tuple[Plant, list[str]]:
    """Compile a URDF, and return it with what was mended.

    Raises
    ------
    InputError
        The file cannot be read, or has what is not covered.
    """
    path = Path(path)
    cleaned = clean(_text(path), path.name)
    library = mujoco()
    text = ElementTree.tostring(cleaned.root, encoding="unicode")
    try:
        with quietly(library):
            spec = library.MjSpec.from_string(text)
            _drive(library, spec)
            m = spec.compile()
    except ValueError as error:
        what = f"MuJoCo cannot read it: {shortened(str(error), 200)}"
        raise InputError(what, path.name, "Mend the file, or name an MJCF") from None
    if m.jnt_actfrclimited.any():
        m.jnt_actfrclimited[:] = 0
        cleaned.repairs.append(
            "limits of effort are left out: the recorded efforts are those that acted"
        )
    plant = Plant(path, m, spec.to_xml())
    refuse(plant)
    return plant, cleaned.repairs


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError("is too large for a robot", str(path), "Name a URDF")
        return path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError("no such file", str(path), "Check the path") from None
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", str(path)) from None
    except UnicodeDecodeError:
        raise InputError("is no text in UTF-8", str(path), "Save it as UTF-8") from None


def clean(text: str, name: str) -> Cleaned:
    """Return a URDF without what is not mechanics, and mended where no body could be so.

    Raises
    ------
    InputError
        It is no URDF, or a joint is neither hinge, slide nor fixed.
    """
    declared = set(re.findall(r"xmlns:(\w+)", text))
    strange = {p for p in re.findall(r"[<\s/](\w+):\w+", text) if p not in {*declared, "xmlns"}}
    repairs = []
    for prefix in sorted(strange):
        mended = re.sub(rf"([<\s/]){prefix}:(?=\w+[\s=/>])", rf"\1{prefix}_", text)
        if mended != text:
            repairs.append(f"the prefix {prefix}: is declared nowhere")
        text = mended
    if "<!ENTITY" in text:
        raise InputError("declares entities", name, "Write them out")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"is no XML: {error}", name, "Mend the file") from None
    if root.tag != "robot":
        what = f"is no URDF: its root is <{shortened(root.tag)}>"
        raise InputError(what, name, "Run xacro first, or name another file")
    out = Cleaned(root, repairs)
    _drop(out)
    _joints(out, name)
    _inertias(out)
    compiler = {"discardvisual": "true", "fusestatic": "true", "strippath": "true"}
    extension = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    extension.attrib.update({**compiler, "boundmass": "0", "boundinertia": "0"})
    return out


def _drop(out: Cleaned) -> None:
    """Leave out what is no mechanics."""
    left: dict[str, int] = {}
    for element in list(out.root):
        if element.tag not in KNOWN:
            left[element.tag] = left.get(element.tag, 0) + 1
            out.root.remove(element)
    shapes = False
    for link in out.root.findall("link"):
        for element in list(link):
            if element.tag != "inertial":
                shapes = shapes or element.tag in SHAPES
                link.remove(element)
    left.pop("material", None)
    if left:
        names = ", ".join(f"<{tag}>" for tag in sorted(left))
        out.repairs.append(f"left out as no mechanics: {shortened(names, 200)}")
    if shapes:
        out.repairs.append("shapes of links are left out: whether links touch is not checked")


def _joints(out: Cleaned, name: str) -> None:
    """Refuse joints that are not covered, and add links that joints name alone."""
    links = {link.get("name") for link in out.root.findall("link")}
    for joint in out.root.findall("joint"):
        kind = joint.get("type", "")
        where = f"{name} joint {joint.get('name')!r}"
        if kind not in KINDS:
            raise InputError(f"is {kind or 'without type'}", where, f"Use {', '.join(KINDS)}")
        if joint.find("mimic") is not None:
            raise InputError("mimics another joint", where, "Coupled joints are not covered")
        for tag in ("parent", "child"):
            end = joint.find(tag)
            link = None if end is None else end.get("link")
            if link is None:
                raise InputError(f"has no {tag}", where, f'Write <{tag} link="..."/>')
            if link not in links:
                ElementTree.SubElement(out.root, "link", name=link)
                links.add(link)
                out.repairs.append(f"link {link!r} is declared nowhere: it is one without mass")
        for element in list(joint):
            if element.tag not in ("origin", "parent", "child", "axis", "limit", "dynamics"):
                joint.remove(element)
        limit = joint.find("limit")
        if kind == "revolute" and (limit is None or "lower" not in limit.attrib):
            joint.set("type", "continuous")


def _inertias(out: Cleaned) -> None:
    """Mend what no rigid body has; links without inertia may be welded to others."""
    moved, welded = _carried(out.root)
    heavy = {n.get("name") for n in out.root.findall("link") if n.find("inertial") is not None}
    for link in out.root.findall("link"):
        name, inertial = link.get("name", ""), link.find("inertial")
        if inertial is None:
            if name not in moved or any(w in heavy for w in _group(name, welded)):
                continue
            inertial = ElementTree.SubElement(link, "inertial")
            out.repairs.append(f"link {name!r} has no inertia: it is taken for {LEAST_MASS:g} kg")
        mass, body = inertial.find("mass"), inertial.find("inertia")
        if mass is None:
            mass = ElementTree.SubElement(inertial, "mass", value="0")
        if body is None:
            body = ElementTree.SubElement(inertial, "inertia")
        _mend(out, name, mass, body)


def _carried(root: ElementTree.Element) -> tuple[set[str], dict[str, list[str]]]:
    """Return the links that a joint moves, and those that are welded to a link."""
    moved: set[str] = set()
    welded: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        parent, child = (joint.find(tag) for tag in ("parent", "child"))
        assert parent is not None and child is not None  # `_joints` looked
        if joint.get("type") == "fixed":
            welded.setdefault(parent.get("link", ""), []).append(child.get("link", ""))
        else:
            moved.add(child.get("link", ""))
    return moved, welded


def _group(name: str, welded: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the links that move with a link, itself among them."""
    found = [name]
    for one in found:
        found += [w for w in welded.get(one, ()) if w not in found]
    return found


def _mend(out: Cleaned, name: str, mass: ElementTree.Element, body: ElementTree.Element) -> None:
    if float(mass.get("value", "0")) < LEAST_MASS:
        mass.set("value", repr(LEAST_MASS))
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    keys = {(i, j): f"i{'xyz'[i]}{'xyz'[j]}" for i, j in pairs}
    matrix = np.zeros((3, 3))
    for (i, j), key in keys.items():
        matrix[i, j] = matrix[j, i] = float(body.get(key, "0"))
    moments, axes = np.linalg.eigh(matrix)
    mended = np.maximum(moments, LEAST_INERTIA)
    # The moments of a body obey A + B >= C; the smaller two grow until they do.
    short = mended[2] - mended[0] - mended[1]
    if short > 0.0:
        mended[:2] += 0.5 * short * (1.0 + 1e-9)
    if np.array_equal(mended, moments):
        return
    said = f"{moments[0]:.3g}, {moments[1]:.3g}, {moments[2]:.3g}"
    now = f"{mended[0]:.3g}, {mended[1]:.3g}, {mended[2]:.3g}"
    if moments.any():
        out.repairs.append(
            f"no body has the moments of inertia {said} kg m^2 of link {name!r}: {now} are taken"
        )
    elif mass.get("value") != repr(LEAST_MASS):
        out.repairs.append(f"link {name!r} has no moments of inertia: {now} kg m^2 are taken")
    matrix = axes @ np.diag(mended) @ axes.T
    for (i, j), key in keys.items():
        body.set(key, repr(float(matrix[i, j])))


def _drive(library: Any, spec: Any) -> None:
    """Give every joint an effort of its name."""
    for joint in spec.joints:
        if int(joint.type) in (2, 3):
            actuator = spec.add_actuator(
                name=joint.name, target=joint.name, trntype=library.mjtTrn.mjTRN_JOINT
            )
            actuator.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def urdf_text(path: Path, values: Mapping[str, tuple[float, float]]) -> str:
    """Return a URDF with damping and friction of joints changed in its text.

    Parameters
    ----------
    path : Path
    values : mapping
        Joint to damping and friction.
    """
    document = Document.read(path)
    for node in document.root.children:
        name = node.attributes.get("name", "")
        if node.tag != "joint" or name not in values:
            continue
        damping, friction = values[name]
        own = {"damping": f"{damping:.12g}", "friction": f"{friction:.12g}"}
        inner = next((c for c in node.children if c.tag == "dynamics"), None)
        if inner is not None:
            document.set(inner, own)
        else:
            text = " ".join(f'{k}="{v}"' for k, v in own.items())
            document.insert(node, f"<dynamics {text}/>")
    return document.edited(path).decode("utf-8-sig")


def repair_rows(path: Path, repairs: Sequence[str]) -> list[dict[str, Any]]:
    """Return what was mended as rows of ``data_checks``."""
    empty = {"file": path.name, "channel": "", "check": "repair"}
    return [{**empty, "message": line} for line in repairs]
