"""Rotating machines: gears, shafts, unbalance."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values


def _gears(x: Array, u: Array, p: Values, f: Array) -> Any:
    pinion, wheel, pinion_speed, wheel_speed = x
    ratio = p["N"]
    mesh = p["k"] * (pinion / ratio - wheel) + p["c"] * (pinion_speed / ratio - wheel_speed)
    return [
        pinion_speed,
        wheel_speed,
        (u[0] - p["b1"] * pinion_speed - mesh / ratio + f[0]) / p["J1"],
        (mesh - p["b2"] * wheel_speed + f[1]) / p["J2"],
    ]


GEAR_PAIR = System(
    name="gear_pair",
    group="rotating",
    states=("a1", "a2", "w1", "w2"),
    tables="""
[definitions]
mesh = "k*(a1/N - a2) + c*(w1/N - w2)"

[equations]
a1 = "w1"
a2 = "w2"
w1 = "Tin - b1*w1 - mesh/N"
w2 = "mesh - b2*w2"

[inertia]
w1 = { w1 = "J1" }
w2 = { w2 = "J2" }
""",
    motion=_gears,
    constants={
        "N": Constant(2.5, 4.0),
        "k": Constant(80.0, 200.0, free=True),
        "c": Constant(0.1, 0.4),
        "b1": Constant(0.003, 0.01),
        "b2": Constant(0.05, 0.2, free=True),
        "J1": Constant(0.002, 0.006, free=True),
        "J2": Constant(0.05, 0.12),
    },
    drives={"Tin": Drive(0.6, (2.0, 35.0))},
    axes=(
        Axis("w1", "a1", turning=True, without=("viscous_damping",)),
        Axis("w2", "a2", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("a1", "position"), Gauge("a2", "position")),
    inertial=(Gauge("a1", "position"), Gauge("w2", "speed")),
    dt=0.005,
    springs=False,
)


def _shaft(x: Array, u: Array, p: Values, f: Array) -> Any:
    angle, speed = x[:3], x[3:]
    first = p["k1"] * (angle[0] - angle[1]) + p["c"] * (speed[0] - speed[1])
    second = p["k2"] * (angle[1] - angle[2]) + p["c"] * (speed[1] - speed[2])
    return [
        *speed,
        (u[0] - first + f[0]) / p["Ja"],
        (first - second + f[1]) / p["Jb"],
        (second - p["d"] * speed[2] + f[2]) / p["Jc"],
    ]


SHAFT_TRAIN = System(
    name="shaft_train",
    group="rotating",
    states=("p1", "p2", "p3", "s1", "s2", "s3"),
    tables="""
[equations]
p1 = "s1"
p2 = "s2"
p3 = "s3"
s1 = "(torque - k1*(p1 - p2) - c*(s1 - s2))/Ja"
s2 = "(k1*(p1 - p2) + c*(s1 - s2) - k2*(p2 - p3) - c*(s2 - s3))/Jb"
s3 = "(k2*(p2 - p3) + c*(s2 - s3) - d*s3)/Jc"
""",
    motion=_shaft,
    constants={
        "k1": Constant(40.0, 100.0, free=True),
        "k2": Constant(30.0, 80.0, free=True),
        "c": Constant(0.02, 0.08),
        "d": Constant(0.1, 0.3, free=True),
        "Ja": Constant(0.03, 0.08),
        "Jb": Constant(0.05, 0.12),
        "Jc": Constant(0.08, 0.2, free=True),
    },
    drives={"torque": Drive(2.0, (2.0, 45.0))},
    axes=(
        Axis("s1", "p1", turning=True),
        Axis("s2", "p2", turning=True),
        Axis("s3", "p3", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("p1", "position"), Gauge("p3", "position")),
    inertial=(Gauge("p1", "position"), Gauge("s3", "speed")),
    dt=0.005,
    pairs=((0, 2),),
    springs=False,
)


def _rotor(x: Array, u: Array, p: Values, f: Array) -> Any:
    turn, across, up, across_speed, up_speed = x
    spin = u[0]
    pull = p["e"] * spin**2
    return [
        spin,
        across_speed,
        up_speed,
        pull * np.cos(turn)
        - 2.0 * p["zeta_x"] * p["wx"] * across_speed
        - p["wx"] ** 2 * across
        + f[0],
        pull * np.sin(turn) - 2.0 * p["zeta_y"] * p["wy"] * up_speed - p["wy"] ** 2 * up + f[1],
    ]


ROTOR = System(
    name="unbalanced_rotor",
    group="rotating",
    states=("phi", "x", "y", "vx", "vy"),
    tables="""
[equations]
phi = "Om"
x = "vx"
y = "vy"
vx = "e*Om**2*cos(phi) - 2*zeta_x*wx*vx - wx**2*x"
vy = "e*Om**2*sin(phi) - 2*zeta_y*wy*vy - wy**2*y"
""",
    motion=_rotor,
    constants={
        "e": Constant(2e-5, 6e-5, free=True),
        "zeta_x": Constant(0.02, 0.06, free=True),
        "zeta_y": Constant(0.02, 0.06, free=True),
        "wx": Constant(55.0, 75.0, free=True),
        "wy": Constant(65.0, 90.0, free=True),
    },
    drives={"Om": Drive(15.0, (1.0, 8.0), offset=60.0, actuator=False)},
    axes=(
        Axis("vx", "x", without=("viscous_damping", "linear_stiffness")),
        Axis("vy", "y", without=("viscous_damping", "linear_stiffness")),
    ),
    gauges=(
        Gauge("x", "position", 1e6),
        Gauge("y", "position", 1e6),
        Gauge("phi", "position"),
    ),
    inertial=(
        Gauge("vx", "acceleration"),
        Gauge("vy", "acceleration"),
        Gauge("phi", "position"),
    ),
    dt=0.004,
    pairs=((0, 1),),
    without=("added_mass",),
)

SYSTEMS = (GEAR_PAIR, SHAFT_TRAIN, ROTOR)
