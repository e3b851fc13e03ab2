"""What a diagnosis changes, in the attributes that MJCF has for it.

Sources: MuJoCo's XML reference, elements ``joint``, ``tendon/fixed`` and ``actuator/general``;
polynomial damping and stiffness since 3.7, delays since 3.5.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxsr.models.formats.elements import Elements
from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.xml_text import Document, Node

TIGHT = {"solreffriction": "0.004 1", "solimpfriction": "0.99 0.999 0.001"}
"""Solver values with which frictionloss holds like dry friction. With MuJoCo's own a joint creeps:
a pendulum held by friction fell from 0.189 to 0.176 rad in 3 s, with these from 0.1955 to
0.1953."""
MOST_DELAYED = 1000
"""Steps that an actuator's delay may take."""


def text_of(*values: float) -> str:
    """Write numbers for an attribute, zeros at the end left out."""
    kept = list(values)
    while len(kept) > 1 and kept[-1] == 0.0:
        kept.pop()
    return " ".join(f"{v:.12g}" for v in kept)


@dataclass(eq=False)
class Attributes:
    """Changes of a document's elements, collected and then written.

    Each ``set_`` or ``add_`` method returns whether the format has a word for the change.
    """

    plant: Plant
    document: Document
    elements: Elements
    polynomials: dict[tuple[str, int], list[float]] = field(default_factory=dict)
    general: dict[tuple[str, int], list[float]] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)

    @staticmethod
    def of(plant: Plant) -> Attributes:
        """Return the attributes of a plant's file, nothing changed yet."""
        document = Document.read(plant.path)
        return Attributes(plant, document, Elements(document, plant))

    def joint(self, j: int) -> Node | None:
        """Return the element of a joint."""
        return None if self.elements.joints is None else self.elements.joints[j]

    def actuator(self, i: int) -> Node | None:
        """Return the element of an actuator."""
        return None if self.elements.actuators is None else self.elements.actuators[i]

    def polynomial(self, kind: str, j: int) -> list[float]:
        """Return the coefficients of damping or stiffness of a joint as they are by now."""
        m, key = self.plant.m, (kind, j)
        if key not in self.polynomials:
            at = int(m.jnt_dofadr[j]) if kind == "damping" else j
            whole = "dof" if kind == "damping" else "jnt"
            more = getattr(m, f"{whole}_{kind}poly", None)
            first = float(getattr(m, f"{whole}_{kind}")[at])
            rest = [0.0, 0.0] if more is None else [float(x) for x in more[at]]
            self.polynomials[key] = [first, *rest]
        return self.polynomials[key]

    def set_polynomial(self, kind: str, j: int, power: int, value: float) -> bool:
        """Set a coefficient of a joint's damping or stiffness."""
        node = self.joint(j)
        if node is None:
            return False
        values = self.polynomial(kind, j)
        values[power - 1] = value
        self._write(node, {kind: text_of(*values)})
        return True

    def add_damping(self, j: int, power: int, value: float) -> bool:
        """Add to the force -a v, -b v abs(v) or -c v^3 of a joint."""
        return self.set_polynomial(
            "damping", j, power, self.polynomial("damping", j)[power - 1] + value
        )

    def add_stiffness(self, j: int, power: int, value: float) -> bool:
        """Add a spring about position 0 to a joint; a spring about another position moves."""
        values, m = self.polynomial("stiffness", j), self.plant.m
        rest = float(m.qpos_spring[m.jnt_qposadr[j]])
        if not any(values):
            moved = 0.0
        elif power == 1 and not any(values[1:]) and values[0] + value:
            moved = values[0] * rest / (values[0] + value)
        elif rest == 0.0:
            moved = 0.0
        else:
            return False
        if not self.set_polynomial("stiffness", j, power, values[power - 1] + value):
            return False
        return moved == rest or self.set_springref(j, moved)

    def set_springref(self, j: int, value: float) -> bool:
        """Set the position at which a joint's spring is at rest, in rad or m."""
        node = self.joint(j)
        if node is None:
            return False
        turned = self.plant.turns(j) and self.elements.degrees
        self._write(node, {"springref": text_of(math.degrees(value) if turned else value)})
        return True

    def set_friction(self, j: int, value: float) -> bool:
        """Set a joint's dry friction."""
        node = self.joint(j)
        off = self.plant.disabled("FRICTIONLOSS") or self.plant.disabled("CONSTRAINT")
        if node is None or value < 0.0 or off:
            return False
        self._write(node, {"frictionloss": text_of(value), **TIGHT})
        return True

    def add_friction(self, j: int, value: float) -> bool:
        """Add to a joint's dry friction."""
        now = float(self.plant.m.dof_frictionloss[self.plant.m.jnt_dofadr[j]])
        return self.set_friction(j, now + value)

    def set_armature(self, j: int, value: float) -> bool:
        """Set the inertia that a joint's rotor has."""
        node = self.joint(j)
        if node is None or value < 0.0:
            return False
        self._write(node, {"armature": text_of(value)})
        return True

    def add_armature(self, j: int, value: float) -> bool:
        """Add to the inertia of a joint's rotor."""
        now = float(self.plant.m.dof_armature[self.plant.m.jnt_dofadr[j]])
        return self.set_armature(j, now + value)

    def set_tendon(self, i: int, key: str, value: float) -> bool:
        """Set damping, stiffness or frictionloss of a fixed tendon."""
        nodes = self.elements.tendons
        if nodes is None:
            return False
        self._write(nodes[i], {key: text_of(value), **(TIGHT if key == "frictionloss" else {})})
        return True

    def set_gear(self, i: int, value: float) -> bool:
        """Set the gear of an actuator."""
        node = self.actuator(i)
        if node is None:
            return False
        rest = [float(x) for x in self.plant.m.actuator_gear[i][1:]]
        self._write(node, {"gear": text_of(value, *rest)})
        return True

    def set_servo(self, i: int, values: Mapping[str, float]) -> bool:
        """Set kp and kv of an actuator that is a servo by its tag."""
        node = self.actuator(i)
        known = {"position": ("kp", "kv"), "intvelocity": ("kp", "kv"), "velocity": ("kv",)}
        if node is None or not set(values) <= set(known.get(node.tag, ())):
            return False
        if "dampratio" in node.attributes and "kv" in values:
            return False
        self._write(node, {key: text_of(value) for key, value in values.items()})
        return True

    def set_parameters(self, i: int, gain: Mapping[int, float], bias: Mapping[int, float]) -> bool:
        """Set entries of gainprm and biasprm of a general actuator."""
        node = self.actuator(i)
        if node is None or node.tag != "general":
            return False
        for key, own in (("gainprm", gain), ("biasprm", bias)):
            if own:
                at = key, i
                values = self.general.setdefault(
                    at, [float(x) for x in getattr(self.plant.m, f"actuator_{key}")[i]]
                )
                for k, value in own.items():
                    values[k] = value
                self._write(node, {key: text_of(*values)})
        return True

    def set_lag(self, i: int, tau: float) -> bool:
        """Let an actuator follow its control with a lag of first order."""
        node, m = self.actuator(i), self.plant.m
        if node is None or tau <= 0.0:
            return False
        kind = int(m.actuator_dyntype[i])
        if node.tag == "motor" and kind == 0 and self.document.empty(node):
            self.document.rename(node, "general")
        elif node.tag != "general" or kind not in (0, 2, 3):
            return False
        lag = {"dynprm": text_of(tau)}
        self._write(node, lag if kind else {"dyntype": "filterexact", **lag})
        return True

    def set_delay(self, i: int, tau: float) -> bool:
        """Let an actuator's control act later."""
        m, node = self.plant.m, self.actuator(i)
        steps = math.ceil(tau / float(m.opt.timestep)) + 1
        if (
            node is None
            or not hasattr(m, "actuator_delay")
            or not 0.0 < tau
            or steps > MOST_DELAYED
        ):
            return False
        if tau < float(m.opt.timestep):
            return False
        self._write(node, {"delay": text_of(tau), "nsample": str(steps)})
        return True

    def set_range(self, i: int, low: float, high: float) -> bool:
        """Limit the control of an actuator."""
        node, m = self.actuator(i), self.plant.m
        if node is None:
            return False
        if m.actuator_ctrllimited[i]:
            a, b = (float(x) for x in m.actuator_ctrlrange[i])
            low, high = max(low, a), min(high, b)
        self._write(node, {"ctrlrange": f"{low:.12g} {high:.12g}", "ctrllimited": "true"})
        return True

    def _write(self, node: Node, values: Mapping[str, str]) -> None:
        self.document.set(node, values)
        for key, value in values.items():
            name = node.attributes.get("name", node.tag)
            line = f'{node.tag} {name}: {key}="{value}"'
            self.said = [s for s in self.said if not s.startswith(f"{node.tag} {name}: {key}=")]
            self.said.append(line)
