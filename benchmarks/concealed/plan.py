"""Which cases there are: kinds, systems, mechanisms and loops, dealt in fixed shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.concealed.chains import CHAINS
from benchmarks.concealed.effects import FAMILIES
from benchmarks.concealed.rotors import ROTORS
from benchmarks.concealed.systems import System

SYSTEMS: dict[str, System] = {s.name: s for s in (*CHAINS, *ROTORS)}

SHARES = {
    "structure": 0.46,
    "several": 0.07,
    "nothing": 0.10,
    "parameter": 0.07,
    "sensor": 0.08,
    "timing": 0.06,
    "push": 0.04,
    "below_noise": 0.03,
    "collinear": 0.03,
    "unnamed": 0.03,
    "decoys": 0.03,
}
TRAPS = tuple(k for k in SHARES if k not in ("structure", "several"))
LEAST_MULTIBODY, LEAST_CLOSED = 0.45, 0.32

STRUCTURE = tuple(
    m
    for family, members in FAMILIES.items()
    if family not in ("parameter", "measurement", "external", "unnamed")
    for m in members
    if m not in ("input_delay", "input_gain")
)
MENU = {
    "structure": STRUCTURE,
    "several": ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "constant_force"),
    "nothing": ("",),
    "parameter": ("wrong_value", "wrong_value", "input_gain"),
    "sensor": ("sensor_gain", "sensor_bias", "clipping", "quantisation"),
    "timing": ("input_delay", "sensor_delay", "clock_skew"),
    "push": ("transient_force",),
    "below_noise": ("coulomb_friction", "cubic_stiffness", "quadratic_drag", "position_ripple"),
    "collinear": ("coulomb_friction", "cubic_stiffness", "quadratic_drag"),
    "unnamed": ("unnamed",),
    "decoys": ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "stribeck_friction"),
}
_FLOW = frozenset(
    "overflow drift constant_force linear_stiffness harmonic_force actuator_lag input_saturation "
    "input_deadzone wrong_value input_gain input_delay sensor_gain clipping quantisation "
    "sensor_bias sensor_delay transient_force added_mass piecewise_stiffness".split()
)


@dataclass(frozen=True)
class Ticket:
    """What a case is to be."""

    number: int
    kind: str
    mechanism: str
    system: str
    row: int
    closed: bool
    size: float

    @property
    def name(self) -> str:
        """Opaque name of the case."""
        return f"c{self.number:04d}"


def rows_for(system: System, mechanism: str) -> list[int]:
    """Return the rows (or drives) of a system at which a mechanism can be planted."""
    n = system.size
    if mechanism in ("", "wrong_value") or mechanism in FAMILIES["measurement"]:
        return [0]
    if system.order == 1 and mechanism not in _FLOW:
        return []
    if mechanism == "input_deadzone" and system.order == 1:
        return []  # a pump never turns: where commands keep away from zero, it is a constant force
    if mechanism in (*FAMILIES["actuator"], "actuator_lag"):
        return [i for i, d in enumerate(system.drives) if d.actuated]
    if mechanism == "overflow":
        return [0] if system.order == 1 else []
    if mechanism == "backlash":
        return [0] if system.springs or "n1" in system.constants else []
    if mechanism == "gravity":
        straight = [i for i in range(n) if i not in system.turning and "n1" not in system.constants]
        return straight + [i for i in system.turning if (mechanism, i) not in system.twins]
    if mechanism == "coupling_stiffness":
        return [0] if system.name in ("three_mass", "double_pendulum", "arm") else []
    if mechanism == "coupling_damping":
        return [0] if system.name in ("three_mass", "arm") else []
    if mechanism == "centrifugal_coupling":
        return list(range(n)) if n > 1 and system.name != "servo" else []
    rows = list(range(n))
    # what a change of one constant reproduces is a wrong value, except an added mass, which
    # counts as one with it
    if mechanism != "added_mass":
        rows = [i for i in rows if (mechanism, i) not in system.twins]
    if mechanism == "end_stop" and system.name == "quarter_car":
        rows = [0]
    return rows


def deal(seed: int, count: int) -> list[Ticket]:
    """Return the tickets of `count` cases; the same for the same seed and count."""
    rng = np.random.default_rng([seed, 0])
    kinds = [k for k, n in _whole(count).items() for _ in range(n)]
    rng.shuffle(kinds)
    decks: dict[str, list[str]] = {}
    tickets = []
    multibody = closed = 0
    for number, kind in enumerate(kinds):
        deck = decks.setdefault(kind, [])
        if not deck:
            deck.extend(str(m) for m in rng.permutation(MENU[kind]))
        mechanism = deck.pop()
        fitting = [s for s in SYSTEMS.values() if rows_for(s, mechanism)]
        if kind == "several":
            fitting = [s for s in fitting if s.multibody]
        want_multibody = multibody < LEAST_MULTIBODY * (number + 1)
        want_closed = closed < LEAST_CLOSED * (number + 1)
        looped = kind != "below_noise" and mechanism not in ("clock_skew", "overflow", "end_stop")
        if want_multibody and any(s.multibody for s in fitting):
            fitting = [s for s in fitting if s.multibody]
        if want_closed and looped and any(s.loops for s in fitting):
            fitting = [s for s in fitting if s.loops]
        system = fitting[int(rng.integers(len(fitting)))]
        close = bool(looped and system.loops and (want_closed or rng.uniform() < 0.1))
        multibody += system.multibody
        closed += close
        row = int(rng.choice(rows_for(system, mechanism)))
        size = float(np.exp(rng.uniform(np.log(0.005), np.log(0.4))))
        if kind == "below_noise":
            size = float(np.exp(rng.uniform(np.log(0.005), np.log(0.01))))
        tickets.append(Ticket(number + 1, kind, mechanism, system.name, row, close, size))
    return tickets


def _whole(count: int) -> dict[str, int]:
    """Split the count by the shares, largest remainders up."""
    exact = {k: s * count for k, s in SHARES.items()}
    whole = {k: int(x) for k, x in exact.items()}
    rest = sorted(exact, key=lambda k: whole[k] - exact[k])
    for k in rest[: count - sum(whole.values())]:
        whole[k] += 1
    # rounding must not take the traps below a third
    while sum(whole[k] for k in TRAPS) * 3 < count:
        whole["structure"] -= 1
        whole["nothing"] += 1
    return whole
