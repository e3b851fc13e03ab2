"""An explained model in the words of MJCF: ``explained.xml``, with ``explained.py`` for the rest.

Forces that have an attribute are written there, joint by joint; what is left of the difference
between the explained and the given equations is computed by a callback. So the two files together
do what ``explained.toml`` says, whatever was found.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxsr._staging import staging_folder, sweep
from jaxsr.models.formats.attributes import Attributes
from jaxsr.models.formats.callback import Callback, callback_text
from jaxsr.models.formats.moved_files import edited_files
from jaxsr.models.formats.plant import Plant, mujoco
from jaxsr.models.formats.summands import names_in, plain, sum_difference, summands
from jaxsr.models.formats.urdf import urdf_text
from jaxsr.models.model import Model

Finding = Mapping[str, Any]
XML, PY, URDF = "explained.xml", "explained.py", "explained.urdf"
_ACTUATOR = ("kp", "kv", "tau", "offset", "gain_by_length", "gain_by_speed", "gain")
"""Constants of actuators, NAME in ``NAME_ACTUATOR``; longer ones before their beginnings."""
SAME = 1e-12
"""Relative difference below which a value was not changed."""


@dataclass
class WrittenBack:
    """Files in the simulator's own format.

    Attributes
    ----------
    files : dict of str to str
        Texts by name.
    said : list of str
        What was changed, and what could not be.
    """

    files: dict[str, str] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)


def write_back(
    plant: Plant, given: Model, explained: Model, findings: Sequence[Finding], folder: Path
) -> WrittenBack:
    """Return an explained model as MJCF, and as a callback where MJCF has no attribute.

    Parameters
    ----------
    plant : Plant
    given, explained : Model
        Formulas of the file, and those that a diagnosis ended with.
    findings : sequence of mapping
        Of the diagnosis.
    folder : Path
        Where the files will lie, for paths to what the MJCF includes.
    """
    if plant.mjcf:
        return _from_urdf(plant, given, explained, findings, folder)
    work = _Work(plant, given, explained, Attributes.of(plant))
    work.values()
    for finding in findings:
        work.finding(finding)
    work.rest()
    files = edited_files(work.attributes, plant, folder, XML)
    if work.callback.needed:
        files[PY] = callback_text(work.callback, plant, given, explained, XML)
    said = [*work.attributes.said, *work.said]
    return WrittenBack(files, said)


def _from_urdf(
    plant: Plant, given: Model, explained: Model, findings: Sequence[Finding], folder: Path
) -> WrittenBack:
    """Write damping and friction into the URDF too, and everything into the MJCF made of it."""
    temporary = Path(tempfile.gettempdir())
    sweep(temporary)
    with staging_folder(temporary) as home:
        path = home / plant.path.name
        path.write_text(plant.mjcf, encoding="utf-8")
        as_mjcf = replace(plant, path=path, mjcf="")
        back = write_back(as_mjcf, given, explained, findings, home)
        (path.parent / XML).write_text(back.files[XML], encoding="utf-8")
        m = mujoco().MjModel.from_xml_path(str(path.parent / XML))
    changed = {}
    for j, name in enumerate(plant.joint_names):
        dof = int(plant.m.jnt_dofadr[j])
        now = float(m.dof_damping[dof]), float(m.dof_frictionloss[dof])
        if now != (float(plant.m.dof_damping[dof]), float(plant.m.dof_frictionloss[dof])):
            changed[name] = now
    back.files[URDF] = urdf_text(plant.path, changed)
    back.said.append(f"{URDF} holds damping and friction alone, {XML} everything")
    return back


class _Work:
    """The difference between two models while it is written down piece by piece."""

    def __init__(
        self, plant: Plant, given: Model, explained: Model, attributes: Attributes
    ) -> None:
        self.plant, self.given, self.explained = plant, given, explained
        self.attributes, self.callback = attributes, Callback()
        self.said: list[str] = []
        touched = {n for n, t in explained.definitions.items() if given.definitions.get(n) != t}
        self.added: dict[int, list[str]] = {}
        self.taken: dict[int, list[str]] = {}
        for j, v in enumerate(plant.rates):
            before, after = given.equations[v], explained.equations[v]
            self.added[j], self.taken[j] = sum_difference(before, after, touched)
        self.inertia = {
            j: sum_difference(
                given.inertia[v].get(v, "0"), explained.inertia[v].get(v, "0"), set()
            )[0]
            for j, v in enumerate(plant.rates)
        }
        self.done: set[str] = set()  # added states that an attribute stands for

    def values(self) -> None:
        """Write parameters of the file that have another value now."""
        servos: dict[int, dict[str, float]] = {}
        for name, old in self.given.parameters.items():
            new = self.explained.parameters.get(name, old).value
            if abs(new - old.value) <= SAME * max(abs(new), abs(old.value)):
                continue
            if not self._value(name, old.value, new, servos):
                self._line(name, old.value, new)
        for i, values in servos.items():
            if not self.attributes.set_servo(i, values):
                self._servo_line(i, values)

    def _value(
        self, name: str, before: float, value: float, servos: dict[int, dict[str, float]]
    ) -> bool:
        """Write a parameter into an attribute; tell whether there is one."""
        kind, _, element = name.partition("_")
        own, plant = self.attributes, self.plant
        if element in plant.joints and name in _joint_parameters(plant, element):
            j = plant.joints.index(element)
            setters: dict[str, Callable[[], bool]] = {
                "springref": lambda: own.set_springref(j, value),
                "frictionloss": lambda: own.set_friction(j, value),
                "armature": lambda: own.set_armature(j, value),
            }
            for family in ("damping", "stiffness"):
                for power in (1, 2, 3):
                    key = family if power == 1 else f"{family}{power}"
                    setters[key] = lambda f=family, p=power: own.set_polynomial(f, j, p, value)
            return setters[kind]() if kind in setters else False
        if kind in ("damping", "stiffness", "frictionloss") and element in plant.tendons:
            return own.set_tendon(plant.tendons.index(element), kind, value)
        for kind in _ACTUATOR:
            element = name.removeprefix(f"{kind}_")
            if element != name and element in plant.actuators:
                i = plant.actuators.index(element)
                return self._actuator_value(i, kind, before, value, servos)
        return False

    def _actuator_value(
        self, i: int, kind: str, before: float, value: float, servos: dict[int, dict[str, float]]
    ) -> bool:
        own, m = self.attributes, self.plant.m
        node = own.actuator(i)
        if i in self.plant.loops:
            name = self.plant.actuator_names[i]
            self.said.append(f"{kind} of the controller's loop around {name} is {value:.4g}")
            return True
        if kind in ("kp", "kv") and node is not None and node.tag != "general":
            servos.setdefault(i, {})[kind] = value
            return True
        gain, bias = (np.array(x[i]) for x in (m.actuator_gainprm, m.actuator_biasprm))
        if kind == "tau":
            return own.set_lag(i, value)
        if kind == "gain":
            if node is not None and node.tag == "motor":
                return own.set_gear(i, float(m.actuator_gear[i, 0]) * value / before)
            return own.set_parameters(i, {0: float(gain[0]) * value / before}, {})
        if kind == "offset":
            return own.set_parameters(i, {}, {0: value})
        if kind in ("gain_by_length", "gain_by_speed"):
            return own.set_parameters(i, {1 if kind == "gain_by_length" else 2: value}, {})
        servo, paced = bias[1] == -gain[0], bias[2] == -gain[0]
        if kind == "kp":
            return own.set_parameters(i, {0: value} if servo else {}, {1: -value})
        return own.set_parameters(i, {0: value} if paced and not servo else {}, {2: -value})

    def finding(self, finding: Finding) -> None:
        """Write a finding into attributes, if the format has a word for it."""
        kind, _, element = str(finding["site"]).partition(":")
        mechanism = str(finding["mechanism"])
        values = {
            n: self.explained.parameters[n].value
            for n in finding.get("parameters", {})
            if n in self.explained.parameters
        }
        if kind == "equation" and element in self.plant.rates:
            self._force(self.plant.rates.index(element), mechanism, values)
        elif kind == "input" and element in self.plant.inputs:
            self._input(self.plant.inputs.index(element), mechanism, values)

    def _force(self, j: int, mechanism: str, values: Mapping[str, float]) -> None:
        if len(values) != 1:
            return
        ((name, value),) = values.items()
        own, q, v = self.attributes, self.plant.positions[j], self.plant.rates[j]
        if mechanism == "added_mass":
            lines = self.inertia[j]
            if f"+{name}" in [plain(t) for t in lines] and own.add_armature(j, value):
                self.inertia[j] = [t for t in lines if plain(t) != f"+{name}"]
            return
        words: dict[str, tuple[str, Callable[[], bool]]] = {
            "viscous_damping": (f"{name}*{v}", lambda: own.add_damping(j, 1, value)),
            "quadratic_drag": (f"{name}*{v}*Abs({v})", lambda: own.add_damping(j, 2, value)),
            "coulomb_friction": (f"{name}*sign({v})", lambda: own.add_friction(j, value)),
            "linear_stiffness": (f"{name}*{q}", lambda: own.add_stiffness(j, 1, value)),
            "quadratic_stiffness": (f"{name}*{q}**2", lambda: own.add_stiffness(j, 2, value)),
            "cubic_stiffness": (f"{name}*{q}**3", lambda: own.add_stiffness(j, 3, value)),
        }
        if mechanism not in words:
            return
        text, write = words[mechanism]
        mine = [t for t in self.added[j] if name in names_in(t)]
        if len(mine) == 1 and plain(mine[0]) == f"-{text}" and write():
            self.added[j].remove(mine[0])

    def _input(self, i: int, mechanism: str, values: Mapping[str, float]) -> None:
        m, own, u = self.plant.m, self.attributes, self.plant.inputs[i]
        node, value = own.actuator(i), next(iter(values.values()), 0.0)
        written = False
        if i in self.plant.loops:  # whose target is in no file
            return
        if mechanism == "input_delay" and u in self.explained.delays:
            tau = self.explained.delays[u]
            seconds = self.explained.parameters[tau].value if isinstance(tau, str) else float(tau)
            if not own.set_delay(i, seconds):
                self.said.append(
                    f"a delay of {u} by {seconds:.4g} s stands in explained.toml alone"
                )
            return
        if mechanism == "input_gain" and node is not None and node.tag == "motor":
            name = f"gain_{self.plant.actuators[i]}"
            if name in self.given.parameters:
                now, before = (x.parameters[name].value for x in (self.explained, self.given))
                written = own.set_gear(i, float(m.actuator_gear[i, 0]) * value * now / before)
        elif mechanism == "input_saturation" and not self._smooth(values):
            written = own.set_range(i, -value, value)
        elif mechanism == "actuator_lag" and not self.plant.activations.get(i):
            written = own.set_lag(i, value)
            if written:
                new = [s for s in self.explained.states if s not in self.given.states]
                self.done |= {s for s in new if u in names_in(self.explained.equations[s])}
        if written:
            self._consume(values)

    def _smooth(self, values: Mapping[str, float]) -> bool:
        return any(
            "tanh" in t for terms in self.added.values() for t in terms if names_in(t) & set(values)
        )

    def _consume(self, values: Mapping[str, float]) -> None:
        """Strike out the terms that an attribute stands for now."""
        names = set(values) | self.done
        for j, terms in self.added.items():
            mine = [t for t in terms if names_in(t) & names]
            if mine:
                self.added[j] = [t for t in terms if t not in mine]
                # An input that was replaced by another took its own term away.
                self.taken[j] = [] if self.done else self.taken[j]

    def rest(self) -> None:
        """Leave to the callback what no attribute stands for."""
        targets = {self.plant.inputs[i] for i in self.plant.loops}
        for j, v in enumerate(self.plant.rates):
            if any(names_in(t) & targets for t in (*self.added[j], *self.taken[j])):
                self.said.append(
                    f"what acts on {v} through a target stands in explained.toml alone"
                )
                self.added[j] = self.taken[j] = []
            self._sliding(j)
            if self.added[j] or self.taken[j]:
                self.callback.forces[j] = self.added[j], self.taken[j]
            if self.inertia[j]:
                text = " ".join(self.inertia[j])
                v = self.plant.rates[j]
                self.said.append(f"the inertia of {v} changed by {text}: see explained.toml")
        texts = [x for a, t in self.callback.forces.values() for x in (*a, *t)]
        texts += [x for parts in self.callback.friction.values() for x in parts]
        used = {n for x in texts for n in names_in(x)}
        new = [s for s in self.explained.states if s not in self.given.states]
        used |= {n for s in new for n in names_in(self.explained.equations[s])}
        self.callback.states = tuple(s for s in new if s in used and s not in self.done)
        for name, text in self.explained.readings.items():
            if self.given.readings.get(name) != text:
                self.said.append(f"the sensor {name} reads {text}: see explained.toml")

    def _sliding(self, j: int) -> None:
        """Take terms -X*sign(rate) for dry friction of a changing size."""
        plant, v = self.plant, self.plant.rates[j]
        if plant.disabled("FRICTIONLOSS") or plant.disabled("CONSTRAINT"):
            return
        end = f"*sign({v})"
        mine = [t for t in self.added[j] if plain(t).startswith("-") and plain(t).endswith(end)]
        factors = [plain(t)[1 : -len(end)] for t in mine]
        if any(len(summands(f)) > 1 or f"sign({v})" in f for f in factors):
            return
        if mine:
            node = self.attributes.joint(j)
            loss = float(plant.m.dof_frictionloss[plant.m.jnt_dofadr[j]])
            if node is not None and "frictionloss" in node.attributes:
                loss = float(node.attributes["frictionloss"])
            self.callback.friction[j], self.callback.constant[j] = factors, loss
            self.added[j] = [t for t in self.added[j] if t not in mine]

    def _line(self, name: str, before: float, now: float) -> None:
        """Set a value of the compiled model in explained.py, where no attribute holds it."""
        kind, _, element = name.partition("_")
        plant, lines = self.plant, self.callback.values
        if kind == "mass" and element in plant.bodies:
            for body in _welded(plant, plant.bodies.index(element)):
                lines.append(f"model.body_mass[{body}] *= {now / before!r}")
                lines.append(f"model.body_inertia[{body}] *= {now / before!r}")
        elif name == "g":
            lines.append(f"model.opt.gravity[:] *= {now / before!r}")
        elif place := _place_of(plant, name):
            lines.append(f"model.actuator_{place} *= {now / before!r}")
        else:
            self.said.append(f"{name} = {now:.6g} stands in explained.toml alone")

    def _servo_line(self, i: int, values: Mapping[str, float]) -> None:
        lines = self.callback.values
        for kind, value in values.items():
            k = 1 if kind == "kp" else 2
            if self.plant.m.actuator_biasprm[i, k] == -self.plant.m.actuator_gainprm[i, 0]:
                lines.append(f"model.actuator_gainprm[{i}, 0] = {value!r}")
            lines.append(f"model.actuator_biasprm[{i}, {k}] = {-value!r}")


def _place_of(plant: Plant, name: str) -> str:
    """Return where the compiled model has a constant of an actuator, "" for other constants."""
    places = {"gain": "gainprm[{}, 0]", "gain_by_length": "gainprm[{}, 1]"}
    places |= {
        "gain_by_speed": "gainprm[{}, 2]",
        "offset": "biasprm[{}, 0]",
        "tau": "dynprm[{}, 0]",
    }
    for kind, place in places.items():
        element = name.removeprefix(f"{kind}_")
        if element != name and element in plant.actuators:
            return place.format(plant.actuators.index(element))
    return ""


def _joint_parameters(plant: Plant, element: str) -> set[str]:
    kinds = ("springref", "frictionloss", "armature")
    kinds += tuple(f"{f}{p}" for f in ("damping", "stiffness") for p in ("", "2", "3"))
    return {f"{kind}_{element}" for kind in kinds}


def _welded(plant: Plant, body: int) -> list[int]:
    """Return a body and those that are fixed to it."""
    m = plant.m
    return [b for b in range(1, m.nbody) if int(m.body_weldid[b]) == int(m.body_weldid[body])]
