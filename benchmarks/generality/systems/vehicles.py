"""Vehicles: suspension, lateral and longitudinal motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values


def _quarter(x: Array, u: Array, p: Values, f: Array) -> Any:
    body, wheel, body_speed, wheel_speed = x
    strut = p["ks"] * (body - wheel) + p["cs"] * (body_speed - wheel_speed)
    tyre = p["kt"] * (wheel - u[0])
    return [
        body_speed,
        wheel_speed,
        (u[1] - strut + f[0]) / p["ms"],
        (strut - u[1] - tyre + f[1]) / p["mu"],
    ]


QUARTER_CAR = System(
    name="active_quarter_car",
    group="vehicles",
    states=("zs", "zu", "vs", "vu"),
    tables="""
[definitions]
strut = "ks*(zs - zu) + cs*(vs - vu)"

[equations]
zs = "vs"
zu = "vu"
vs = "(Fa - strut)/ms"
vu = "(strut - Fa - kt*(zu - zr))/mu"
""",
    motion=_quarter,
    constants={
        "ks": Constant(1.2e4, 2.5e4, free=True, unit="N/m"),
        "cs": Constant(700.0, 1600.0, free=True, unit="N*s/m"),
        "kt": Constant(1.4e5, 2.2e5, unit="N/m"),
        "ms": Constant(250.0, 400.0, free=True, unit="kg"),
        "mu": Constant(30.0, 55.0, unit="kg"),
    },
    drives={"zr": Drive(0.012, (2.0, 40.0), actuator=False), "Fa": Drive(250.0, (2.0, 30.0))},
    axes=(
        Axis("vs", "zs"),
        Axis("vu", "zu", without=("linear_stiffness",)),
    ),
    gauges=(Gauge("zs", "position"), Gauge("zu", "position")),
    inertial=(Gauge("vs", "acceleration"), Gauge("vu", "acceleration"), Gauge("zs", "position")),
    dt=0.005,
    pairs=((0, 1),),
    without=("coupling_stiffness", "coupling_damping"),
)


def _bicycle(x: Array, u: Array, p: Values, f: Array) -> Any:
    side, yaw_rate = x
    front = -p["Cf"] * ((side + p["a"] * yaw_rate) / p["U"] - u[0])
    rear = -p["Cr"] * (side - p["b"] * yaw_rate) / p["U"]
    return [
        (front + rear + f[0]) / p["m"] - p["U"] * yaw_rate,
        (p["a"] * front - p["b"] * rear + f[1]) / p["Iz"],
    ]


BICYCLE = System(
    name="bicycle_lateral",
    group="vehicles",
    states=("vy", "r"),
    tables="""
[definitions]
Ff = "Cf*(delta - (vy + a*r)/U)"
Fr = "-Cr*(vy - b*r)/U"

[equations]
vy = "Ff + Fr - m*U*r"
r = "a*Ff - b*Fr"

[inertia]
vy = { vy = "m" }
r = { r = "Iz" }
""",
    motion=_bicycle,
    constants={
        "Cf": Constant(6e4, 1.1e5, free=True),
        "Cr": Constant(7e4, 1.3e5, free=True),
        "a": Constant(1.1, 1.3),
        "b": Constant(1.4, 1.7),
        "U": Constant(14.0, 22.0),
        "m": Constant(1200.0, 1800.0),
        "Iz": Constant(1800.0, 3000.0, free=True),
    },
    drives={"delta": Drive(0.03, (1.0, 12.0))},
    axes=(Axis("vy"), Axis("r", without=("viscous_damping",))),
    gauges=(Gauge("vy", "speed"), Gauge("r", "speed")),
    inertial=(Gauge("r", "speed"), Gauge("vy", "speed")),
    dt=0.01,
    without=("added_mass",),
)


def _longitudinal(x: Array, u: Array, p: Values, f: Array) -> Any:
    speed, pull = x
    rolling = p["m"] * 9.81 * p["fr"]
    drag = 0.5 * 1.2 * p["CdA"] * speed * np.abs(speed)
    return [(pull - rolling - drag + f[0]) / p["m"], (u[0] - pull) / p["T"]]


LONGITUDINAL = System(
    name="longitudinal",
    group="vehicles",
    states=("v", "F"),
    tables="""
[definitions]
rolling = "m*9.81*fr"
drag = "0.6*CdA*v*Abs(v)"

[equations]
v = "(F - rolling - drag)/m"
F = "(Fcmd - F)/T"
""",
    motion=_longitudinal,
    constants={
        "m": Constant(1100.0, 1900.0),
        "fr": Constant(0.009, 0.016, free=True),
        "CdA": Constant(0.5, 0.9, free=True),
        "T": Constant(0.3, 0.7, free=True),
    },
    drives={"Fcmd": Drive(1400.0, (0.1, 1.5), offset=600.0, steps=True)},
    axes=(
        Axis(
            "v",
            without=(
                "constant_force",
                "coulomb_friction",
                "asymmetric_friction",
                "stribeck_friction",
                "quadratic_drag",
            ),
        ),
    ),
    gauges=(Gauge("v", "speed"),),
    inertial=(Gauge("v", "speed"), Gauge("v", "acceleration")),
    dt=0.1,
    start={"v": 18.0, "F": 600.0},
    without=("actuator_lag",),
)

SYSTEMS = (QUARTER_CAR, BICYCLE, LONGITUDINAL)
