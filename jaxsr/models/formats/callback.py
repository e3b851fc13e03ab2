"""``explained.py``: forces and values that MJCF has no attribute for, as MuJoCo's callback."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.summands import names_in, needed_by
from jaxsr.models.model import Model

GIVEN = "given_"
"""Prefix of definitions as they were, where an edit changed them."""
WIDTH = 1e-3
"""Rate in rad/s or m/s below which a callback's sign is smooth: a step holds nothing still."""
TIGHT_SOLREF, TIGHT_SOLIMP = "[0.004, 1.0]", "[0.99, 0.999, 0.001]"
HEAD = '''\
"""{title}

MJCF has no attribute for what stands here. Use it beside {xml}:

    import mujoco, {module}
    model = mujoco.MjModel.from_xml_path("{xml}")
    {module}.install(model)

MuJoCo compiles no other model while a callback is set: mujoco.set_mjcb_passive(None) takes it away.
"""

import math

import mujoco
'''
_MATH = "sin cos tan asin acos atan atan2 sinh cosh tanh exp log sqrt floor".split()
_MEANING = {
    **{name: f"{name} = math.{name}" for name in (*_MATH, "pi")},
    **{"Abs": "Abs = abs", "Max": "Max = max", "Min": "Min = min"},
    "sign": f"def sign(x):\n    return math.tanh(x / {WIDTH!r})",
    "Heaviside": f"def Heaviside(x):\n    return 0.5 + 0.5 * math.tanh(x / {WIDTH!r})",
    "Piecewise": "def Piecewise(*pairs):\n    return next(value for value, true in pairs if true)",
    "And": "def And(*parts):\n    return all(parts)",
    "Or": "def Or(*parts):\n    return any(parts)",
    "Not": "def Not(part):\n    return not part",
}
"""What the functions of the grammar are in Python."""


@dataclass
class Callback:
    """What a callback adds.

    Attributes
    ----------
    forces : dict
        By joint, the terms that are added and those that are taken away.
    friction : dict
        By joint, factors X of terms -X*sign(rate): dry friction that changes, which MuJoCo's
        solver holds still as no force of a callback could.
    constant : dict
        By joint, its frictionloss in the file that is written.
    values : list of str
        Lines that set values of the compiled model.
    states : tuple of str
        Added states of the explained model, integrated by the callback.
    """

    forces: dict[int, tuple[list[str], list[str]]] = field(default_factory=dict)
    friction: dict[int, list[str]] = field(default_factory=dict)
    constant: dict[int, float] = field(default_factory=dict)
    values: list[str] = field(default_factory=list)
    states: tuple[str, ...] = ()

    @property
    def needed(self) -> bool:
        """Whether there is anything to do."""
        return bool(self.forces or self.friction or self.values)


def callback_text(
    callback: Callback, plant: Plant, given: Model, explained: Model, xml: str
) -> str:
    """Return the text of ``explained.py``."""
    module = Path(xml).stem
    title = f"What {plant.path.name} leaves out, beside {xml}."
    parts = [HEAD.format(title=title, xml=xml, module=module)]
    if callback.forces or callback.friction:
        parts.append(_passive(callback, plant, given, explained))
    lines = ["", "", "def install(model):"]
    lines += ['    """Set what has no attribute, and let MuJoCo call what acts besides."""']
    lines += [f"    {line}" for line in callback.values]
    if any("body_mass" in line or "body_inertia" in line for line in callback.values):
        lines.append("    mujoco.mj_setConst(model, mujoco.MjData(model))")
    for joint in callback.friction:
        dof = int(plant.m.jnt_dofadr[joint])
        lines.append(f"    model.dof_solref[{dof}] = {TIGHT_SOLREF}")
        lines.append(f"    model.dof_solimp[{dof}, :3] = {TIGHT_SOLIMP}")
    if callback.forces or callback.friction:
        lines.append("    mujoco.set_mjcb_passive(passive)")
    return "".join(parts) + "\n".join(lines) + "\n"


def _passive(callback: Callback, plant: Plant, given: Model, explained: Model) -> str:
    """Return the constants and the callback function."""
    touched = {n for n, t in explained.definitions.items() if given.definitions.get(n) != t}
    definitions = dict(explained.definitions)
    for name, text in given.definitions.items():
        if name in touched:
            definitions[GIVEN + name] = _as_given(text, touched)
    texts: list[str] = []
    rows: list[tuple[int, str]] = []
    for joint, (added, taken) in callback.forces.items():
        parts = [*added, *(_turned(_as_given(t, touched)) for t in taken)]
        text = " ".join(parts).removeprefix("+ ")
        rows.append((joint, text))
        texts.append(text)
    sliding = {j: " + ".join(parts) for j, parts in callback.friction.items()}
    texts += sliding.values()
    rates = {s: explained.equations[s] for s in callback.states}
    needed = needed_by([*texts, *rates.values()], definitions)
    used = [*texts, *rates.values(), *(definitions[n] for n in needed)]
    names = set().union(*(names_in(text) for text in used))
    constants = [f"{n} = {p.value!r}" for n, p in explained.parameters.items() if n in names]
    body = _readings(plant, explained, names)
    if callback.states:
        inner = [f"{n} = {definitions[n]}" for n in needed] + [
            f"d_{s} = {text}" for s, text in rates.items()
        ]
        memory = _memory(callback.states, body, inner)
        body = [*body, f"{', '.join(callback.states)}, = _remember(data)"]
    else:
        memory = ""
    body += [f"{n} = {definitions[n]}" for n in needed]
    for joint, text in rows:
        dof = int(plant.m.jnt_dofadr[joint])
        body.append(f"data.qfrc_passive[{dof}] += {text}  # {plant.joint_names[joint]}")
    meant = meanings(names)
    for joint, text in sliding.items():
        dof, at_rest = int(plant.m.jnt_dofadr[joint]), callback.constant.get(joint, 0.0)
        base = f"{at_rest!r} + " if at_rest else ""
        comment = f"# {plant.joint_names[joint]}, from the next step on"
        body.append(f"model.dof_frictionloss[{dof}] = max({base}{text}, 0.0)  {comment}")
    lines = ["", *meant, *constants, memory, "", "def passive(model, data):"]
    lines += ['    """Add to the passive forces, once they are computed."""']
    return "\n".join([*lines, *(f"    {line}" for line in body)]) + "\n"


def meanings(names: set[str]) -> list[str]:
    """Return the lines that give the functions among some names their meaning."""
    texts = [text for name, text in _MEANING.items() if name in names]
    plain = [text for text in texts if not text.startswith("def")]
    defined = [f"\n\n{text}" for text in texts if text.startswith("def")]
    return [*plain, *defined, *(["", ""] if defined else [])]


def _readings(plant: Plant, model: Model, names: set[str]) -> list[str]:
    """Return lines that take the model's symbols from MuJoCo's data."""
    m = plant.m
    lines = [f"{model.time} = data.time"] if model.time in names else []
    for j, (q, v) in enumerate(zip(plant.positions, plant.rates, strict=True)):
        if q in names:
            lines.append(f"{q} = data.qpos[{int(m.jnt_qposadr[j])}]")
        if v in names:
            lines.append(f"{v} = data.qvel[{int(m.jnt_dofadr[j])}]")
    lines += [f"{u} = data.ctrl[{i}]" for i, u in enumerate(plant.inputs) if u in names]
    for i, state in plant.activations.items():
        if state in names:
            lines.append(f"{state} = data.act[{int(m.actuator_actadr[i])}]")
    return lines


def _memory(states: Sequence[str], readings: Sequence[str], rates: Sequence[str]) -> str:
    """Return a function that integrates the added states along MuJoCo's time."""
    zeros = ", ".join("0.0" for _ in states)
    listed = ", ".join(states)
    moved = [f"{s} += step * d_{s}" for s in states]
    lines = [
        "",
        "",
        "SUBSTEPS = 20",
        "_memory = {}",
        "",
        "",
        "def _remember(data):",
        '    """Integrate the states that MuJoCo does not have up to its time."""',
        "    key = id(data)",
        f"    last, values = _memory.get(key, (data.time, ({zeros},)))",
        "    if data.time < last:  # a new run",
        f"        last, values = data.time, ({zeros},)",
        "    if data.time > last:",
        *(f"        {line}" for line in readings),
        f"        {listed}, = values",
        "        step = (data.time - last) / SUBSTEPS",
        "        for _ in range(SUBSTEPS):",
        *(f"            {line}" for line in (*rates, *moved)),
        f"        values = ({listed},)",
        "    _memory[key] = data.time, values",
        "    return values",
        "",
    ]
    return "\n".join(lines)


def _turned(term: str) -> str:
    return ("- " if term[0] == "+" else "+ ") + term[2:]


def _as_given(term: str, touched: set[str]) -> str:
    """Name the definitions in a term as they were before the edit."""
    for name in touched:
        term = re.sub(rf"\b{name}\b", GIVEN + name, term)
    return term
