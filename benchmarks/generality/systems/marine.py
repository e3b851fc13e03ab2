"""Ships and underwater vehicles: roll with a stabilising tank, surge and yaw between thrusters."""

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


def _roll(x: Array, u: Array, p: Values, f: Array) -> Any:
    roll, tank, roll_rate, tank_rate = x
    force = np.array(
        [
            u[0] - p["dr"] * roll_rate - p["c"] * np.sin(roll) - p["ct"] * tank + f[0],
            -p["dt"] * tank_rate - p["ct"] * (roll + tank) + f[1],
        ]
    )
    rates = solved([[p["I"], p["It"]], [p["It"], p["It"] * p["r"]]], force)
    return [roll_rate, tank_rate, rates[0], rates[1]]


ROLL_TANK = System(
    name="ship_with_roll_tank",
    group="marine",
    states=("phi", "tau", "p", "s"),
    tables="""
[equations]
phi = "p"
tau = "s"
p = "M - dr*p - c*sin(phi) - ct*tau"
s = "-dt*s - ct*(phi + tau)"

[inertia]
p = { p = "I", s = "It" }
s = { p = "It", s = "It*r" }
""",
    motion=_roll,
    constants={
        "I": Constant(4.0, 7.0, free=True),
        "It": Constant(0.15, 0.3),
        "r": Constant(1.3, 1.9),
        "dr": Constant(0.15, 0.4, free=True),
        "dt": Constant(0.02, 0.06, free=True),
        "c": Constant(3.0, 6.0, free=True),
        "ct": Constant(0.2, 0.4),
    },
    drives={"M": Drive(0.6, (0.4, 2.5), actuator=False)},
    axes=(
        Axis("p", "phi", turning=True, without=("viscous_damping",)),
        Axis("s", "tau", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("phi", "position"), Gauge("tau", "position")),
    inertial=(Gauge("p", "speed"), Gauge("tau", "position")),
    dt=0.1,
)


def _thrusters(x: Array, u: Array, p: Values, f: Array) -> Any:
    _, turning, ahead, aside = x
    return [
        turning,
        (p["l"] * (u[1] - u[0]) - p["Nr"] * turning - p["Nv"] * aside + f[0]) / p["Iz"],
        (u[0] + u[1] - p["Xu"] * ahead + p["mv"] * aside * turning + f[1]) / p["mu"],
        (-p["Yv"] * aside - p["mu"] * ahead * turning) / p["mv"],
    ]


THRUSTERS = System(
    name="twin_thruster_boat",
    group="marine",
    states=("psi", "r", "u", "v"),
    tables="""
[equations]
psi = "r"
r = "l*(Tr - Tl) - Nr*r - Nv*v"
u = "Tl + Tr - Xu*u + mv*v*r"
v = "-Yv*v - mu*u*r"

[inertia]
r = { r = "Iz" }
u = { u = "mu" }
v = { v = "mv" }
""",
    motion=_thrusters,
    constants={
        "l": Constant(0.3, 0.5),
        "Nr": Constant(4.0, 9.0, free=True),
        "Nv": Constant(1.0, 3.0),
        "Iz": Constant(6.0, 12.0, free=True),
        "Xu": Constant(8.0, 16.0, free=True),
        "mu": Constant(25.0, 45.0, free=True),
        "mv": Constant(40.0, 70.0),
        "Yv": Constant(40.0, 80.0),
    },
    drives={
        "Tl": Drive(9.0, (0.2, 2.0), offset=8.0),
        "Tr": Drive(9.0, (0.2, 2.0), offset=8.0),
    },
    axes=(
        Axis("r", "psi", turning=True, without=("viscous_damping",)),
        Axis("u", without=("viscous_damping",)),
    ),
    gauges=(Gauge("psi", "position"), Gauge("u", "speed")),
    inertial=(Gauge("r", "speed"), Gauge("u", "acceleration"), Gauge("u", "speed")),
    dt=0.1,
    start={"u": 1.0},
    springs=False,
)

SYSTEMS = (ROLL_TANK, THRUSTERS)
