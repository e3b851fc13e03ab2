"""Columns of recordings that are joints, actuators or sensors of a model, found by their names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.models.formats.names import symbols_for
from jaxsr.models.formats.plant import Plant
from jaxsr.models.formats.sensors import sensor_readings

POSITION, RATE, CONTROL, SENSOR = "position", "rate", "control", "sensor"
WORDS = {
    POSITION: "q qpos pos position angle ang theta length rad deg degree degrees m mm cm",
    RATE: "v qvel dq qd vel velocity speed omega rate rads radps degs degps mps",
    CONTROL: "u ctrl control command cmd torque tau force effort input act nm n target des desired "
    "ref reference setpoint goal qdes qref qcmd",
}
TARGETS = frozenset("target des desired ref reference setpoint goal qdes qref qcmd".split())
EFFORTS = frozenset("torque tau force effort nm n".split())
PLAIN = frozenset("u ctrl control command cmd input act".split())
NEUTRAL = frozenset(
    "joint meas measured measurement sensor motor actuator encoder actual s".split()
)
KINDS: dict[str, frozenset[str]] = {kind: frozenset(text.split()) for kind, text in WORDS.items()}
SCALES = {"deg": "180/pi", "degree": "180/pi", "degrees": "180/pi", "degs": "180/pi"}
SCALES |= {"degps": "180/pi", "mm": "1000", "cm": "100"}
UNITS = {"deg": "deg", "degree": "deg", "degrees": "deg", "degs": "deg/s", "degps": "deg/s"}
UNITS |= {"mm": "mm", "cm": "cm"}
LISTED = 200
"""Characters of a list of names in a message."""


@dataclass(frozen=True)
class Quantity:
    """What a column may hold.

    Attributes
    ----------
    role : str
        An input or an output of the model.
    kind : str
        position, rate, control or sensor.
    names : tuple of str
        Names of the element; the first is its own, the others those of elements tied to it.
    element : str
        In words, for messages.
    reading : str
        Expression of an output; empty for an input.
    unit : str
    exact : tuple of str
        Columns that are certainly this quantity.
    drives : str
        Of a control: "effort" of a motor, "target" of a servo, "" for others.
    """

    role: str
    kind: str
    names: tuple[str, ...]
    element: str
    reading: str = ""
    unit: str = ""
    exact: tuple[str, ...] = ()
    drives: str = ""


@dataclass
class Matched:
    """Quantities that have a column, and columns that have none."""

    columns: dict[str, str] = field(default_factory=dict)
    outputs: list[Quantity] = field(default_factory=list)
    unknown: list[str] = field(default_factory=list)


def quantities_of(plant: Plant, units: Mapping[str, str]) -> list[Quantity]:
    """Return everything of a model that a column may hold; `units` are those of its symbols."""
    m, found = plant.m, []
    driven: dict[int, list[int]] = {}
    for i in range(m.nu):
        if int(m.actuator_trntype[i]) in (0, 1):
            driven.setdefault(int(m.actuator_trnid[i, 0]), []).append(i)
    for j, name in enumerate(plant.joint_names):
        own = driven.get(j, [])
        tied = tuple(n for i in own if (n := plant.actuator_names[i]) != name)
        for kind, state in ((POSITION, plant.positions[j]), (RATE, plant.rates[j])):
            role, unit = f"{state}_meas", units.get(state, "")
            exact = (role, state, f"d_q_{plant.joints[j]}" if kind == RATE else role)
            element = f"the {kind} of joint {name!r}"
            found.append(Quantity(role, kind, (name, *tied), element, state, unit, exact))
    for i, name in enumerate(plant.actuator_names):
        joint = int(m.actuator_trnid[i, 0])
        alone = int(m.actuator_trntype[i]) in (0, 1) and len(driven[joint]) == 1
        tied = (plant.joint_names[joint],) if alone and plant.joint_names[joint] != name else ()
        role = plant.inputs[i]
        element = f"the control of actuator {name!r}"
        exact = (f"u_{role}", f"ctrl_{role}", *((role,) if role != name else ()))
        unit, drives = units.get(role, ""), _drives(plant, i)
        found.append(Quantity(role, CONTROL, (name, *tied), element, "", unit, exact, drives))
    taken = {q.role for q in found} | set(units)
    for name, reading, unit in sensor_readings(plant, units):
        (role,) = symbols_for([name], taken)
        element = f"sensor {name!r}"
        found.append(Quantity(role, SENSOR, (name,), element, reading, unit, (name, role)))
    return found


def _drives(plant: Plant, i: int) -> str:
    """Return what an actuator's control is: a force's measure, or the target of a servo."""
    m = plant.m
    if int(m.actuator_dyntype[i]):
        return ""
    if int(m.actuator_biastype[i]) == 0:
        return "effort" if int(m.actuator_gaintype[i]) == 0 else ""
    return "target" if m.actuator_biasprm[i, 1] == -m.actuator_gainprm[i, 0] else ""


def says_effort(plant: Plant, matched: Matched) -> bool:
    """Whether every control's column is named as a force: measured, not held over a step."""
    columns = [matched.columns[u] for u in plant.inputs if u in matched.columns]
    words = [set(words_of(c)) for c in columns]
    return bool(words) and all(w & EFFORTS and not w & (TARGETS | PLAIN) for w in words)


def match(
    plant: Plant,
    quantities: Sequence[Quantity],
    columns: Sequence[str],
    file: str,
    *,
    measured: bool = False,
) -> Matched:
    """Find the columns of the inputs and of the sensors.

    Parameters
    ----------
    plant : Plant
    quantities : sequence of Quantity
        What a column may be.
    columns : sequence of str
    file : str
        Names the recording in errors.
    measured : bool
        Whether sensors are told already, so that none has to be found.

    Raises
    ------
    InputError
        A column may be two things, two columns are one thing, an input has no column, or nothing
        is measured.
    """
    found: dict[str, tuple[Quantity, str]] = {}
    open_: list[tuple[str, list[Quantity]]] = []
    unknown: list[str] = []
    certain = {c: q for c in columns for q in quantities if c in q.exact}
    # A sensor of the name stands before an element of the name.
    for column in columns:
        named = [q for q in quantities if column in q.exact]
        if named:
            own = next((q for q in named if q.kind == SENSOR), named[0])
            found[own.role] = own, column
    for column in columns:
        if column in certain:
            continue
        likely = candidates(column, quantities)
        if not likely:
            unknown.append(column)
        else:
            open_.append((column, likely))
    for column, likely in sorted(open_, key=lambda pair: len(pair[1])):
        free = [q for q in likely if q.role not in found]
        if len(free) > 1:
            a, b = free[0].element, free[1].element
            what = f"column {shortened(column)!r} may be {a} or {b}"
            raise InputError(what, file, _remedy(plant, free[0].role, column))
        if not free:
            if likely[0].role in found and len(likely) == 1:
                other = found[likely[0].role][1]
                if other not in likely[0].exact:
                    what = f"columns {shortened(other)!r} and {shortened(column)!r} may both be "
                    remedy = _remedy(plant, likely[0].role, column)
                    raise InputError(what + likely[0].element, file, remedy)
            unknown.append(column)
            continue
        found[free[0].role] = free[0], column
    matched = _collected(quantities, found, unknown)
    missing = [q for q in quantities if q.kind == CONTROL and q.role not in found]
    if missing or not (matched.outputs or measured):
        raise _unmatched(plant, quantities, columns, missing, file)
    return matched


def _collected(
    quantities: Sequence[Quantity],
    found: Mapping[str, tuple[Quantity, str]],
    unknown: list[str],
) -> Matched:
    out = Matched(unknown=unknown)
    for quantity in quantities:
        if quantity.role not in found:
            continue
        own, column = found[quantity.role]
        out.columns[own.role] = column
        if own.kind != CONTROL:
            out.outputs.append(scaled(own, column))
    return out


def _unmatched(
    plant: Plant,
    quantities: Sequence[Quantity],
    columns: Sequence[str],
    missing: Sequence[Quantity],
    file: str,
) -> InputError:
    """Say that a column is missing, with both lists."""
    both = f"columns: {_listed(columns)}; names: {_listed(_names(plant, quantities))}"
    if missing:
        what = f"no column is {missing[0].element} ({both})"
        return InputError(what, file, _remedy(plant, missing[0].role, "COLUMN"))
    what = f"no column is a position, rate or sensor ({both})"
    return InputError(what, file, _remedy(plant, quantities[0].role, "COLUMN"))


def _names(plant: Plant, quantities: Sequence[Quantity]) -> list[str]:
    sensors = [q.names[0] for q in quantities if q.kind == SENSOR]
    kinds = {"joint": plant.joint_names, "actuator": plant.actuator_names, "sensor": sensors}
    return [f"{kind} {name}" for kind, names in kinds.items() for name in names]


def _listed(names: Sequence[str]) -> str:
    return shortened(", ".join(names), LISTED) or "none"


def _remedy(plant: Plant, role: str, column: str) -> str:
    table = plant.path.with_suffix(".toml").name
    return f'Write {role} = "{shortened(column)}" under [columns] of {table}'


def scaled(quantity: Quantity, column: str) -> Quantity:
    """Return an output in the unit that the column's name states."""
    words = [w for w in words_of(column) if w in SCALES and w not in words_of(quantity.names[0])]
    fits = {"rad": "deg", "rad/s": "deg/s", "m": "m"}
    for word in words:
        turning = SCALES[word] == "180/pi"
        if (quantity.unit in ("rad", "rad/s")) != turning or quantity.unit not in fits:
            continue
        unit = UNITS[word]
        if quantity.kind == RATE:
            unit = "deg/s"
        reading = f"{quantity.reading}*{SCALES[word]}"
        return replace(quantity, reading=reading, unit=unit)
    return quantity


def candidates(column: str, quantities: Sequence[Quantity]) -> list[Quantity]:
    """Return the quantities that a column's name fits best: by own names, then by tied ones."""
    tokens = words_of(column)
    ranked: dict[tuple[int, int], list[Quantity]] = {}
    for quantity in quantities:
        for place, name in enumerate(quantity.names):
            rest = _without(tokens, words_of(name))
            if rest is not None and _fits(quantity.kind, rest) and _suits(quantity, rest):
                ranked.setdefault((min(place, 1), -len(words_of(name))), []).append(quantity)
                break
    if not ranked:
        counted = _by_number(tokens, quantities)
        if counted:
            return counted
        alone = [q for q in quantities if q.kind != SENSOR and tokens and _says(q.kind, tokens)]
        alone = [q for q in alone if _suits(q, tokens)]
        return alone if len(alone) == 1 else []
    return ranked[min(ranked)]


def _by_number(tokens: Sequence[str], quantities: Sequence[Quantity]) -> list[Quantity]:
    """Return what ``q1`` or ``tau_2`` is, where names end in a number that no other one has."""
    parts = [p for t in tokens for p in re.findall(r"[a-z]+|\d+", t)]
    digits = [p for p in parts if p.isdigit()]
    words = [p for p in parts if not p.isdigit()]
    if len(digits) != 1 or not words:
        return []
    found = []
    for quantity in quantities:
        numbers = re.findall(r"\d+", quantity.names[0])
        if quantity.kind != SENSOR and _says(quantity.kind, words) and _suits(quantity, words):
            found += [quantity] if numbers and int(numbers[-1]) == int(digits[0]) else []
    return found if len(found) == 1 else []


def _fits(kind: str, rest: Sequence[str]) -> bool:
    """Whether what a column's name says beside an element's is true of a quantity of this kind."""
    if kind == SENSOR:
        return all(w in NEUTRAL or any(w in words for words in KINDS.values()) for w in rest)
    if not [w for w in rest if w not in NEUTRAL]:
        return kind in (POSITION, CONTROL)
    return _says(kind, rest)


def _suits(quantity: Quantity, words: Sequence[str]) -> bool:
    """Whether a control takes what words name: no target is a torque, and no torque a target."""
    told = set(words)
    if quantity.drives == "effort":
        return not told & TARGETS or bool(told & (EFFORTS | PLAIN))
    return quantity.drives != "target" or not told & EFFORTS or bool(told & (TARGETS | PLAIN))


def _says(kind: str, words: Sequence[str]) -> bool:
    """Whether words name this kind of quantity, and no other; the last of them decide."""
    telling = [w for w in words if w not in NEUTRAL]
    if not telling or not all(any(w in own for own in KINDS.values()) for w in telling):
        return False
    # "angle target" is a control, "joint rate deg" a rate: position words stand beside others
    kinds = {k for w in telling for k, own in KINDS.items() if w in own}
    told = next((k for k in (CONTROL, RATE, POSITION) if k in kinds), None)
    if CONTROL in kinds and RATE in kinds:
        return False
    return told == kind


def _without(tokens: Sequence[str], name: Sequence[str]) -> list[str] | None:
    """Return the tokens around a name that stands among them, None where it does not."""
    if not name:
        return None
    for start in range(len(tokens) - len(name) + 1):
        if list(tokens[start : start + len(name)]) == list(name):
            return [*tokens[:start], *tokens[start + len(name) :]]
    return None


def words_of(text: str) -> list[str]:
    """Split a name into lower-case words and numbers."""
    joined = re.sub(r"(rad|deg|m)\s*/\s*s\b", r"\1s", text)
    joined = re.sub(
        r"\b_?(rad|deg|m)_s\b|(?<=_)(rad|deg|m)_s$", lambda m: f"_{m[1] or m[2]}s", joined
    )
    joined = re.sub(r"([a-z])([A-Z])", r"\1_\2", joined).lower()
    tokens = [t for t in re.split(r"[^a-z0-9]+", joined) if t]
    return ["mps" if t == "ms" else t for t in tokens]
