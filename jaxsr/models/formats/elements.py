"""Which element of an MJCF's text is which joint, tendon or actuator of the compiled model."""

from __future__ import annotations

from collections.abc import Iterator

from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.xml_text import Document, Node

_WRAPPERS = ("frame",)
_COPIES = ("replicate", "attach", "composite", "flexcomp")


class Elements:
    """The elements of a document by the numbers that MuJoCo gave them.

    Attributes
    ----------
    joints, tendons, actuators : list of Node or None
        None where elements are made by others (``<replicate>``, ``<attach>``), or do not tally.
    """

    def __init__(self, document: Document, plant: Plant) -> None:
        m, root = plant.m, document.root
        made = any(node.tag in _COPIES for node in root.walk())
        joints = [j for world in _sections(root, "worldbody") for j in _joints(world)]
        # The plant's base may be held where the file lets it fly.
        joints = [j for j in joints if j.tag == "joint" and j.attributes.get("type") != "free"]
        self.joints = _tallied(joints, plant.joint_names, made)
        tendons = [t for part in _sections(root, "tendon") for t in part.children]
        names = [plant.called("tendon", i) for i in range(m.ntendon)]
        self.tendons = _tallied(tendons, names, made)
        actuators = [a for part in _sections(root, "actuator") for a in part.children]
        names = [plant.called("actuator", i) for i in range(m.nu)]
        self.actuators = _tallied(actuators, names, made)
        self.compilers = _sections(root, "compiler")

    @property
    def degrees(self) -> bool:
        """Whether angles in the text are in degrees, as they are where nothing is said."""
        said = [c.attributes["angle"] for c in self.compilers if "angle" in c.attributes]
        return not said or said[-1] == "degree"


def _sections(root: Node, tag: str) -> list[Node]:
    return [child for child in root.children if child.tag == tag]


def _joints(body: Node) -> Iterator[Node]:
    """Yield the joints of a body and of those in it, as MuJoCo numbers them."""
    yield from (e for e in _inside(body) if e.tag in ("joint", "freejoint"))
    for inner in _inside(body):
        if inner.tag == "body":
            yield from _joints(inner)


def _inside(body: Node) -> Iterator[Node]:
    """Yield what a body holds, wrappers opened."""
    for child in body.children:
        if child.tag in _WRAPPERS:
            yield from _inside(child)
        else:
            yield child


def _tallied(
    nodes: list[Node], names: list[str] | tuple[str, ...], made: bool
) -> list[Node] | None:
    """Return the nodes if they are as many as there are elements, named alike."""
    if made or len(nodes) != len(names):
        return None
    told = [node.attributes.get("name") for node in nodes]
    return nodes if all(t in (None, n) for t, n in zip(told, names, strict=True)) else None
