"""What acts on the joints of a MuJoCo model beside motion and gravity, as text of formulas."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxsr.models.formats.plant import Plant, finite_range

WIDE = 10.0
"""How many times its value the upper bound of a damping, friction or armature is at least. Files
give simulated joints a damping that only quiets them; what the joint's inertia can have bounds it
then: a damping that stops it within a sample, a rotor as heavy as all that the joint moves."""
GAIN = 2.0
"""By which factor the bounds of an actuator's gain lie around its value."""


@dataclass
class Written:
    """Parts of the tables of a model file.

    Attributes
    ----------
    forces : list of list of str
        Signed terms along every joint.
    inertias : dict
        Symbol that adds to the mass matrix on the diagonal, by joint.
    """

    forces: list[list[str]]
    inertias: dict[int, str] = field(default_factory=dict)
    definitions: dict[str, str] = field(default_factory=dict)
    equations: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    delays: dict[str, float] = field(default_factory=dict)

    def parameter(self, name: str, value: float, unit: str, *bounds: float) -> str:
        """Enter a parameter, free between `bounds`, and return its symbol."""
        entry: dict[str, Any] = {"value": float(value), "unit": unit}
        if bounds:
            entry["bounds"] = sorted(float(b) for b in bounds)
        self.parameters[name] = entry
        return name

    def add(self, joint: int, sign: str, text: str) -> None:
        """Add a term to the force along a joint."""
        self.forces[joint].append(f"{sign} {text}")


def passive_forces(plant: Plant, out: Written, step: float = math.inf) -> None:
    """Write springs, dampers, dry friction and armature of joints and fixed tendons.

    Parameters
    ----------
    plant : Plant
    out : Written
    step : float
        Sample time of the recordings in s.
    """
    m, moved = plant.m, plant.inertias
    for i, name in enumerate(plant.joints):
        q, v = plant.positions[i], plant.rates[i]
        arm = [(i, 1.0)]
        force = "N*m" if plant.turns(i) else "N"
        length = "rad" if plant.turns(i) else "m"
        dof = int(m.jnt_dofadr[i])
        stiffness = [m.jnt_stiffness[i], *getattr(m, "jnt_stiffnesspoly", np.zeros((i + 1, 2)))[i]]
        damping = [m.dof_damping[dof], *getattr(m, "dof_dampingpoly", np.zeros((dof + 1, 2)))[dof]]
        if not plant.disabled("SPRING"):
            rest = float(m.qpos_spring[m.jnt_qposadr[i]])
            stretch = q
            if rest and any(stiffness):
                out.parameter(f"springref_{name}", rest, length)
                stretch = f"({q} - springref_{name})"
            _polynomial(out, arm, "stiffness", name, stiffness, stretch, (force, length), False)
        if not plant.disabled("DAMPER"):
            units, most = (force, f"{length}/s"), moved[i] / step
            _polynomial(out, arm, "damping", name, damping, v, units, True, most)
        loss = float(m.dof_frictionloss[dof])
        if loss > 0.0 and not (plant.disabled("FRICTIONLOSS") or plant.disabled("CONSTRAINT")):
            out.parameter(f"frictionloss_{name}", loss, force, 0.0, WIDE * loss)
            out.add(i, "-", f"frictionloss_{name}*sign({v})")
        mass = float(m.dof_armature[dof])
        if mass > 0.0:
            unit = "kg*m^2" if plant.turns(i) else "kg"
            most = float(f"{max(WIDE * mass, moved[i]):.3g}")
            out.parameter(f"armature_{name}", mass, unit, 0.0, most)
            out.inertias[i] = f"armature_{name}"
    for i in range(m.ntendon):
        _tendon(plant, out, i)


def _polynomial(
    out: Written,
    arms: list[tuple[int, float]],
    kind: str,
    name: str,
    values: list[float],
    over: str,
    units: tuple[str, str],
    free: bool,
    most: float = 0.0,
) -> None:
    """Write -(k0 x + k1 x^2 + k2 x^3) along joints, of a damper x abs(x) for x^2 (MuJoCo 3.7).

    The upper bound of k0, where it is free, is at least `most`.
    """
    force, length = units
    shapes = (over, f"{over}*Abs({over})" if free else f"{over}**2", f"{over}**3")
    for power, (value, shape) in enumerate(zip(values, shapes, strict=True), start=1):
        if not value:
            continue
        symbol = f"{kind}_{name}" if power == 1 else f"{kind}{power}_{name}"
        high = max(WIDE * value, most if power == 1 else 0.0)
        bounds = (0.0, float(f"{high:.3g}")) if free else ()
        unit = f"{force}/({length})" + (f"^{power}" if power > 1 else "")
        out.parameter(symbol, value, unit, *bounds)
        for joint, arm in arms:
            out.add(joint, "-", f"{_times(arm)}{symbol}*{shape}")


def _tendon(plant: Plant, out: Written, i: int) -> None:
    """Write the passive forces of a fixed tendon, a weighted sum of joint positions."""
    m, name = plant.m, plant.tendons[i]
    arms = [(int(j), float(plant.tendon_arms[i, j])) for j in np.flatnonzero(plant.tendon_arms[i])]
    speed, length = f"speed_{name}", f"length_{name}"
    force, unit = ("N", "m") if not plant.turns(arms[0][0]) else ("N*m", "rad")
    out.definitions[length] = _sum([(a, plant.positions[j]) for j, a in arms])
    out.definitions[speed] = _sum([(a, plant.rates[j]) for j, a in arms])
    stiffness, damping = float(m.tendon_stiffness[i]), float(m.tendon_damping[i])
    if stiffness and not plant.disabled("SPRING"):
        low, high = (float(x) for x in m.tendon_lengthspring[i])
        stretch = f"({length} - {low!r})" if low else length
        if low < high:
            stretch = f"(Max({length} - {high!r}, 0) + Min({length} - {low!r}, 0))"
        _polynomial(out, arms, "stiffness", name, [stiffness, 0, 0], stretch, (force, unit), False)
    if damping and not plant.disabled("DAMPER"):
        _polynomial(out, arms, "damping", name, [damping, 0, 0], speed, (force, f"{unit}/s"), True)
    loss = float(m.tendon_frictionloss[i])
    if loss > 0.0 and not (plant.disabled("FRICTIONLOSS") or plant.disabled("CONSTRAINT")):
        out.parameter(f"frictionloss_{name}", loss, force, 0.0, WIDE * loss)
        for joint, arm in arms:
            out.add(joint, "-", f"{_times(arm)}frictionloss_{name}*sign({speed})")


def actuator_forces(plant: Plant, out: Written, unclamped: frozenset[str] = frozenset()) -> None:
    """Write what the actuators do.

    Parameters
    ----------
    plant : Plant
    out : Written
    unclamped : frozenset of str
        Inputs that never leave the range of their control.
    """
    if plant.disabled("ACTUATION"):
        return
    totals: list[list[str]] = [[] for _ in plant.joints]
    for i in range(plant.m.nu):
        if not plant.m.opt.disableactuator >> int(plant.m.actuator_group[i]) & 1:
            _actuator(plant, out, totals, i, unclamped)
    for joint, terms in enumerate(totals):
        if not terms:
            continue
        if plant.m.jnt_actfrclimited[joint]:
            low, high = finite_range(plant.m.jnt_actfrcrange[joint])
            whole = f"drive_{plant.joints[joint]}"
            out.definitions[whole] = _clamped(joined(terms), low, high)
            terms = [f"+ {whole}"]
        out.forces[joint][:0] = terms  # what drives comes first


def _actuator(
    plant: Plant, out: Written, totals: list[list[str]], i: int, unclamped: frozenset[str]
) -> None:
    m, name, u = plant.m, plant.actuators[i], plant.inputs[i]
    gear = float(m.actuator_gear[i, 0])
    arms = _arms(plant, i, gear)
    turns = plant.turns(arms[0][0])
    force, length = ("N*m", "rad") if turns else ("N", "m")
    command = u
    if m.actuator_ctrllimited[i] and u not in unclamped and not plant.disabled("CLAMPCTRL"):
        command = f"ctrl_{name}"
        out.definitions[command] = _clamped(u, *finite_range(m.actuator_ctrlrange[i]))
    gain, bias = m.actuator_gainprm[i, :3], np.zeros(3)
    if int(m.actuator_biastype[i]) == 1:
        bias = m.actuator_biasprm[i, :3]
    if int(m.actuator_gaintype[i]) == 0:
        gain = np.array([gain[0], 0.0, 0.0])
    servo = gain[0] != 0.0 and bias[1] == -gain[0] and not gain[1:].any()
    paced = gain[0] != 0.0 and bias[2] == -gain[0] and not (bias[1] or gain[1:].any())
    unit = length if servo else f"{length}/s" if paced else "1"
    direct = not (servo or bias.any() or gain[1:].any()) and gear * gain[0] == 1.0
    if direct:
        unit = force
    command = _activated(plant, out, i, command, unit)
    if int(m.actuator_dyntype[i]) != 1:
        out.units[u] = unit
    delay = float(getattr(m, "actuator_delay", np.zeros(i + 1))[i])
    if delay > 0.0:
        out.delays[u] = delay
    long = _sum([(a, plant.positions[j]) for j, a in arms])
    fast = _sum([(a, plant.rates[j]) for j, a in arms])
    terms: list[str] = []
    loop = plant.loops.get(i)
    if servo:
        # Of a controller's own gains a sidecar that states them is sure; what acts as kv does, is
        # the joint's damping as well.
        near = _near(gain[0]) if loop is None else ()
        if loop is not None and loop.estimated:
            near = gain[0] / WIDE, gain[0] * WIDE
        kp = out.parameter(f"kp_{name}", gain[0], f"{force}/rad" if turns else "N/m", *near)
        terms.append(f"+ {kp}*({command} - {_bracket(long)})")
    elif paced:
        kv = out.parameter(f"kv_{name}", gain[0], f"{force}/({length}/s)", *_near(gain[0]))
        terms.append(f"+ {kv}*({command} - {_bracket(fast)})")
    elif direct:
        # The control is the force itself: nothing was calibrated.
        out.parameter(f"gain_{name}", 1.0, "1")
        terms.append(f"+ gain_{name}*{command}")
        arms = [(j, a / gear) for j, a in arms]
    elif gain[0]:
        share = 1.0 if bias.any() or gain[1:].any() or m.actuator_forcelimited[i] else gear
        unit = force if unit == "1" else f"{force}/({unit})"
        out.parameter(f"gain_{name}", gain[0] * share, unit, *_near(gain[0] * share))
        terms.append(f"+ gain_{name}*{command}")
        if share != 1.0:
            arms = [(j, a / gear) for j, a in arms]
    for value, kind, over, per in (
        (gain[1], "gain_by_length", f"{command}*{_bracket(long)}", length),
        (gain[2], "gain_by_speed", f"{command}*{_bracket(fast)}", f"{length}/s"),
    ):
        if value:
            out.parameter(f"{kind}_{name}", value, f"{force}/({per})")
            terms.append(f"+ {kind}_{name}*{over}")
    if bias[0]:
        terms.append(f"+ {out.parameter(f'offset_{name}', bias[0], force)}")
    if bias[1] and not servo:
        out.parameter(f"kp_{name}", -bias[1], f"{force}/{length}", *_near(-bias[1]))
        terms.append(f"- kp_{name}*{_bracket(long)}")
    if bias[2] and not paced:
        near = _near(-bias[2]) if loop is None else ()
        out.parameter(f"kv_{name}", -bias[2], f"{force}/({length}/s)", *near)
        terms.append(f"- kv_{name}*{_bracket(fast)}")
    _enter(out, totals, terms, arms, m.actuator_forcelimited[i], m.actuator_forcerange[i], name)


def _enter(
    out: Written,
    totals: list[list[str]],
    terms: list[str],
    arms: list[tuple[int, float]],
    limited: bool,
    limits: np.ndarray,
    name: str,
) -> None:
    """Add an actuator's force to the joints on which it acts."""
    if not terms:
        return
    if limited:
        force = f"force_{name}"
        out.definitions[force] = _clamped(joined(terms), *finite_range(limits))
        terms = [f"+ {force}"]
    for joint, arm in arms:
        if arm == 1.0:
            totals[joint] += terms
        else:
            whole = joined(terms)
            simple = len(terms) == 1 and terms[0][0] == "+"
            totals[joint].append(f"+ {_times(arm)}{whole if simple else f'({whole})'}")


def _arms(plant: Plant, i: int, gear: float) -> list[tuple[int, float]]:
    """Return the joints on which an actuator acts, each with its lever."""
    element = int(plant.m.actuator_trnid[i, 0])
    if int(plant.m.actuator_trntype[i]) == 3:
        row = plant.tendon_arms[element]
        return [(int(j), gear * float(row[j])) for j in np.flatnonzero(row)]
    return [(element, gear)]


def _activated(plant: Plant, out: Written, i: int, command: str, unit: str) -> str:
    """Write an actuator's own state, and return what its gain multiplies."""
    kind = int(plant.m.actuator_dyntype[i])
    if not kind:
        return command
    state, name = plant.activations[i], plant.actuators[i]
    out.units[state] = unit
    if kind == 1:
        out.equations[state] = command
        out.units[plant.inputs[i]] = f"{unit}/s" if unit != "1" else "1/s"
        return state
    tau = max(float(plant.m.actuator_dynprm[i, 0]), 1e-15)
    out.parameter(f"tau_{name}", tau, "s", tau / WIDE, tau * WIDE)
    out.equations[state] = f"({command} - {state})/tau_{name}"
    return state


def _near(value: float) -> tuple[float, float]:
    return value / GAIN, value * GAIN


def _clamped(text: str, low: float, high: float) -> str:
    if np.isfinite(high):
        text = f"Min({text}, {high!r})"
    return f"Max({text}, {low!r})" if np.isfinite(low) else text


def _times(factor: float) -> str:
    if factor == 1.0:
        return ""
    return f"{factor!r}*" if factor > 0 else f"({factor!r})*"


def _sum(parts: list[tuple[float, str]]) -> str:
    return joined([f"{'-' if a < 0 else '+'} {_times(abs(a))}{text}" for a, text in parts])


def _bracket(text: str) -> str:
    return text if text.replace("_", "").isalnum() else f"({text})"


def joined(terms: list[str]) -> str:
    """Return signed terms as one sum."""
    if not terms:
        return "0"
    first = terms[0][2:] if terms[0][0] == "+" else f"-{terms[0][2:]}"
    return " ".join([first, *terms[1:]])
