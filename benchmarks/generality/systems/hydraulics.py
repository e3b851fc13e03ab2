"""Hydraulics: what moves is pushed by a pressure that oil of some stiffness has to build up."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values


def _cylinder(x: Array, u: Array, p: Values, f: Array) -> Any:
    place, speed, load = x
    flow = p["kq"] * u[0] - speed - p["cl"] * load
    return [
        speed,
        (p["A"] * load - p["b"] * speed - p["k"] * place + f[0]) / p["m"],
        p["beta"] * flow,
    ]


CYLINDER = System(
    name="hydraulic_cylinder",
    group="hydraulics",
    states=("x", "v", "p"),
    tables="""
[equations]
x = "v"
v = "(A*p - b*v - k*x)/m"
p = "beta*(kq*u - v - cl*p)"
""",
    motion=_cylinder,
    constants={
        "A": Constant(800.0, 1600.0, unit="N/MPa"),
        "b": Constant(600.0, 2000.0, free=True, unit="N*s/m"),
        "k": Constant(4e4, 1.2e5, free=True, unit="N/m"),
        "m": Constant(120.0, 300.0, unit="kg"),
        "beta": Constant(400.0, 1200.0, free=True, unit="MPa/m"),
        "kq": Constant(0.2, 0.5, free=True, unit="m/s"),
        "cl": Constant(0.004, 0.012, unit="m/s/MPa"),
    },
    drives={"u": Drive(0.3, (3.0, 60.0))},
    axes=(Axis("v", "x", without=("viscous_damping", "linear_stiffness")),),
    gauges=(Gauge("x", "position", 1e3), Gauge("p", "other")),
    inertial=(Gauge("x", "position", 1e3), Gauge("v", "acceleration")),
    dt=0.003,
)


def _transmission(x: Array, u: Array, p: Values, f: Array) -> Any:
    motor, load, motor_speed, load_speed, pressure = x
    shaft = p["ks"] * (motor - load) + p["cs"] * (motor_speed - load_speed)
    return [
        motor_speed,
        load_speed,
        (p["D"] * pressure - shaft + f[0]) / p["Jm"],
        (shaft - p["bl"] * load_speed + f[1]) / p["Jl"],
        (p["Dp"] * u[0] - p["D"] * motor_speed - p["leak"] * pressure) / p["C"],
    ]


TRANSMISSION = System(
    name="hydrostatic_transmission",
    group="hydraulics",
    states=("am", "al", "wm", "wl", "p"),
    tables="""
[definitions]
shaft = "ks*(am - al) + cs*(wm - wl)"

[equations]
am = "wm"
al = "wl"
wm = "D*p - shaft"
wl = "shaft - bl*wl"
p = "(Dp*n - D*wm - leak*p)/C"

[inertia]
wm = { wm = "Jm" }
wl = { wl = "Jl" }
""",
    motion=_transmission,
    constants={
        "D": Constant(2.0, 4.0),
        "Dp": Constant(2.0, 4.0, free=True),
        "leak": Constant(0.2, 0.6, free=True),
        "C": Constant(0.05, 0.15),
        "ks": Constant(200.0, 500.0, free=True),
        "cs": Constant(0.2, 0.6),
        "bl": Constant(0.3, 0.9, free=True),
        "Jm": Constant(0.1, 0.25),
        "Jl": Constant(0.3, 0.8),
    },
    drives={"n": Drive(6.0, (1.5, 35.0), offset=2.0)},
    axes=(
        Axis("wm", "am", turning=True),
        Axis("wl", "al", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("am", "position"), Gauge("al", "position"), Gauge("p", "other")),
    inertial=(Gauge("am", "position"), Gauge("wl", "speed")),
    dt=0.005,
    pairs=((0, 1),),
    springs=False,
    without=("coupling_stiffness", "coupling_damping"),
)


def _accumulator(x: Array, u: Array, p: Values, f: Array) -> Any:
    _, speed, gas = x
    push = p["A"] * (gas - p["p0"])
    return [
        speed,
        (push - p["d"] * speed + u[0] + f[0]) / p["M"],
        (u[1] - p["A"] * speed - p["g"] * np.sign(gas) * np.sqrt(np.abs(gas))) / p["V"],
    ]


ACTIVE_SEAT = System(
    name="pneumatic_seat",
    group="hydraulics",
    states=("z", "v", "p"),
    tables="""
[equations]
z = "v"
v = "A*(p - p0) - d*v + F"
p = "(q - A*v - g*sign(p)*sqrt(Abs(p)))/V"

[inertia]
v = { v = "M" }
""",
    motion=_accumulator,
    constants={
        "A": Constant(6.0, 10.0),
        "p0": Constant(1.5, 2.5),
        "d": Constant(80.0, 250.0, free=True),
        "M": Constant(40.0, 90.0),
        "g": Constant(0.4, 0.9, free=True),
        "V": Constant(0.02, 0.05, free=True),
    },
    drives={
        "F": Drive(12.0, (3.0, 40.0), actuator=False),
        "q": Drive(0.25, (2.0, 25.0), offset=0.9),
    },
    axes=(Axis("v", "z", without=("viscous_damping",)),),
    gauges=(Gauge("v", "speed"), Gauge("p", "other")),
    dt=0.005,
    start={"p": 2.0},
    springs=False,
)

SYSTEMS = (CYLINDER, TRANSMISSION, ACTIVE_SEAT)
