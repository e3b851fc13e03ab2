"""Flight: a helicopter on a stand, an aircraft's pitch, a flap that flutters."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.system import (
    Array,
    Axis,
    Constant,
    Drive,
    Gauge,
    System,
    Values,
    solved,
)


def _stand(x: Array, u: Array, p: Values, f: Array) -> Any:
    pitch, _, pitch_rate, yaw_rate = x
    swing = p["Jy"] + p["ml"] * np.cos(pitch) ** 2
    lean = p["ml"] * np.sin(pitch) * np.cos(pitch) * yaw_rate
    up = p["kpp"] * u[0] + p["kpy"] * u[1] - p["wl"] * np.sin(pitch) - p["bp"] * pitch_rate
    round_ = p["kyy"] * u[1] + p["kyp"] * u[0] - p["by"] * yaw_rate
    return [
        pitch_rate,
        yaw_rate,
        (up - lean * yaw_rate + f[0]) / (p["Jp"] + p["ml"]),
        (round_ + 2.0 * lean * pitch_rate + f[1]) / swing,
    ]


STAND = System(
    name="helicopter_on_a_stand",
    group="flight",
    states=("th", "psi", "q", "r"),
    tables="""
[definitions]
lean = "ml*sin(th)*cos(th)*r"

[equations]
th = "q"
psi = "r"
q = "kpp*Vm + kpy*Vt - wl*sin(th) - bp*q - lean*r"
r = "kyy*Vt + kyp*Vm - by*r + 2*lean*q"

[inertia]
q = { q = "Jp + ml" }
r = { r = "Jy + ml*cos(th)**2" }
""",
    motion=_stand,
    constants={
        "kpp": Constant(0.15, 0.25, free=True),
        "kpy": Constant(0.005, 0.015),
        "kyy": Constant(0.06, 0.1, free=True),
        "kyp": Constant(0.02, 0.04),
        "wl": Constant(0.6, 1.2, free=True),
        "bp": Constant(0.04, 0.12, free=True),
        "by": Constant(0.04, 0.12),
        "ml": Constant(0.03, 0.06),
        "Jp": Constant(0.03, 0.06),
        "Jy": Constant(0.03, 0.06),
    },
    drives={"Vm": Drive(1.6, (0.8, 12.0)), "Vt": Drive(1.6, (0.8, 12.0))},
    axes=(
        Axis("q", "th", turning=True, without=("viscous_damping",)),
        Axis("r", "psi", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("th", "position"), Gauge("psi", "position")),
    inertial=(Gauge("th", "position"), Gauge("r", "speed")),
    dt=0.02,
    springs=False,
)


def _pitch(x: Array, u: Array, p: Values, f: Array) -> Any:
    attack, rate, elevator = x
    return [
        rate - p["Za"] * attack - p["Ze"] * elevator,
        -p["Ma"] * attack - p["Mq"] * rate - p["Me"] * elevator + f[0] / p["Iy"],
        (u[0] - elevator) / p["lag"],
    ]


PITCH = System(
    name="aircraft_pitch",
    group="flight",
    states=("alpha", "q", "e"),
    tables="""
[equations]
alpha = "q - Za*alpha - Ze*e"
q = "Iy*(-Ma*alpha - Mq*q - Me*e)"
e = "(command - e)/lag"

[inertia]
q = { q = "Iy" }
""",
    motion=_pitch,
    constants={
        "Za": Constant(0.8, 1.6, free=True),
        "Ze": Constant(0.05, 0.15),
        "Ma": Constant(4.0, 9.0, free=True),
        "Mq": Constant(0.8, 2.0, free=True),
        "Me": Constant(6.0, 12.0, free=True),
        "Iy": Constant(1500.0, 3000.0),
        "lag": Constant(0.08, 0.15),
    },
    drives={"command": Drive(0.04, (0.7, 9.0))},
    axes=(Axis("q", without=("viscous_damping",)),),
    gauges=(Gauge("alpha", "other"), Gauge("q", "speed")),
    dt=0.02,
    without=("actuator_lag",),
)


def _section(x: Array, u: Array, p: Values, f: Array) -> Any:
    plunge, twist, plunge_rate, twist_rate = x
    lift = p["L"] * (twist + plunge_rate / p["U"])
    force = np.array(
        [
            -p["kh"] * plunge - p["ch"] * plunge_rate - lift + f[0],
            -p["ka"] * twist - p["ca"] * twist_rate + p["e"] * lift + u[0] + f[1],
        ]
    )
    rates = solved([[p["m"], p["S"]], [p["S"], p["I"]]], force)
    return [plunge_rate, twist_rate, rates[0], rates[1]]


SECTION = System(
    name="wing_section",
    group="flight",
    states=("h", "a", "vh", "va"),
    tables="""
[definitions]
lift = "L*(a + vh/U)"

[equations]
h = "vh"
a = "va"
vh = "-kh*h - ch*vh - lift"
va = "-ka*a - ca*va + e*lift + T"

[inertia]
vh = { vh = "m", va = "S" }
va = { vh = "S", va = "I" }
""",
    motion=_section,
    constants={
        "m": Constant(8.0, 14.0),
        "S": Constant(0.05, 0.15),
        "I": Constant(0.05, 0.1),
        "kh": Constant(1500.0, 3000.0, free=True),
        "ch": Constant(15.0, 35.0, free=True),
        "ka": Constant(8.0, 16.0, free=True),
        "ca": Constant(0.05, 0.15, free=True),
        "L": Constant(20.0, 50.0),
        "e": Constant(0.02, 0.05),
        "U": Constant(8.0, 14.0),
    },
    drives={"T": Drive(0.6, (3.0, 40.0))},
    axes=(
        Axis("vh", "h", without=("viscous_damping", "linear_stiffness")),
        Axis("va", "a", turning=True, without=("viscous_damping", "linear_stiffness")),
    ),
    gauges=(Gauge("h", "position", 1e3), Gauge("a", "position")),
    inertial=(Gauge("vh", "acceleration"), Gauge("a", "position")),
    dt=0.006,
)

SYSTEMS = (STAND, PITCH, SECTION)
