"""Cranes and pendula: what hangs from something that moves."""

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

GRAVITY = 9.81


def _cart(x: Array, u: Array, p: Values, f: Array) -> Any:
    place, angle, speed, rate = x
    arm = p["m"] * p["l"]
    mass = [[p["M"] + p["m"], arm * np.cos(angle)], [arm * np.cos(angle), arm * p["l"]]]
    force = np.stack(
        [
            u[0] - p["c"] * speed - p["kc"] * place + arm * np.sin(angle) * rate**2,
            -p["b"] * rate - arm * GRAVITY * np.sin(angle),
        ]
    )
    return [speed, rate, *solved(mass, force + f)]


CART_PENDULUM = System(
    name="cart_pendulum",
    group="cranes",
    states=("x", "q", "v", "w"),
    tables="""
[equations]
x = "v"
q = "w"
v = "F - c*v - kc*x + m*l*sin(q)*w**2"
w = "-b*w - m*9.81*l*sin(q)"

[inertia]
v = { v = "M + m", w = "m*l*cos(q)" }
w = { v = "m*l*cos(q)", w = "m*l**2" }
""",
    motion=_cart,
    constants={
        "M": Constant(1.5, 3.0, free=True),
        "m": Constant(0.5, 1.2),
        "l": Constant(0.3, 0.6),
        "c": Constant(2.0, 5.0, free=True),
        "kc": Constant(8.0, 20.0),
        "b": Constant(0.01, 0.03, free=True),
    },
    drives={"F": Drive(8.0, (1.5, 10.0))},
    axes=(
        Axis("v", "x", without=("viscous_damping", "linear_stiffness")),
        Axis("w", "q", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("x", "position"), Gauge("q", "position")),
    inertial=(Gauge("x", "position"), Gauge("w", "speed"), Gauge("v", "acceleration")),
    dt=0.01,
    without=("added_mass",),
)


def _double(x: Array, u: Array, p: Values, f: Array) -> Any:
    first, second, first_rate, second_rate = x
    # absolute angles of two point masses; the generalised forces are torques about them
    between = first - second
    off = p["m2"] * p["l1"] * p["l2"]
    mass = [
        [(p["m1"] + p["m2"]) * p["l1"] ** 2, off * np.cos(between)],
        [off * np.cos(between), p["m2"] * p["l2"] ** 2],
    ]
    joint = p["b2"] * (first_rate - second_rate)
    force = np.stack(
        [
            u[0]
            - p["b1"] * first_rate
            - joint
            - off * np.sin(between) * second_rate**2
            - (p["m1"] + p["m2"]) * GRAVITY * p["l1"] * np.sin(first),
            joint
            + off * np.sin(between) * first_rate**2
            - p["m2"] * GRAVITY * p["l2"] * np.sin(second),
        ]
    )
    return [first_rate, second_rate, *solved(mass, force + f)]


DOUBLE_PENDULUM = System(
    name="driven_double_pendulum",
    group="cranes",
    states=("a", "b", "wa", "wb"),
    tables="""
[definitions]
ab = "a - b"
n = "m2*l1*l2"

[equations]
a = "wa"
b = "wb"
wa = "T - b1*wa - b2*(wa - wb) - n*sin(ab)*wb**2 - (m1 + m2)*9.81*l1*sin(a)"
wb = "b2*(wa - wb) + n*sin(ab)*wa**2 - m2*9.81*l2*sin(b)"

[inertia]
wa = { wa = "(m1 + m2)*l1**2", wb = "n*cos(ab)" }
wb = { wa = "n*cos(ab)", wb = "m2*l2**2" }
""",
    motion=_double,
    constants={
        "m1": Constant(0.4, 0.9),
        "m2": Constant(0.3, 0.7, free=True),
        "l1": Constant(0.25, 0.4),
        "l2": Constant(0.2, 0.35),
        "b1": Constant(0.03, 0.08, free=True),
        "b2": Constant(0.01, 0.03, free=True),
    },
    drives={"T": Drive(0.9, (1.5, 9.0))},
    axes=(
        Axis("wa", "a", turning=True, without=("viscous_damping",)),
        Axis("wb", "b", turning=True),
    ),
    gauges=(Gauge("a", "position"), Gauge("b", "position")),
    inertial=(Gauge("a", "position"), Gauge("wb", "speed")),
    dt=0.01,
    pairs=((0, 1),),
    without=("added_mass", "coupling_damping"),
)


def _furuta(x: Array, u: Array, p: Values, f: Array) -> Any:
    _, tilt, turn_rate, tilt_rate = x
    sine, cosine = np.sin(tilt), np.cos(tilt)
    coupled = p["mp"] * p["r"] * p["lp"]
    around = p["mp"] * p["lp"] ** 2
    mass = [
        [p["Ja"] + p["mp"] * p["r"] ** 2 + around * sine**2, coupled * cosine],
        [coupled * cosine, p["Jp"] + around],
    ]
    force = np.stack(
        [
            p["km"] * u[0]
            - p["ba"] * turn_rate
            - 2.0 * around * sine * cosine * turn_rate * tilt_rate
            + coupled * sine * tilt_rate**2,
            around * sine * cosine * turn_rate**2
            - p["bp"] * tilt_rate
            - p["mp"] * GRAVITY * p["lp"] * sine,
        ]
    )
    return [turn_rate, tilt_rate, *solved(mass, force + f)]


ROTARY_PENDULUM = System(
    name="rotary_pendulum",
    group="cranes",
    states=("th", "al", "dth", "dal"),
    tables="""
[definitions]
h = "mp*lp**2"
k = "mp*r*lp"

[equations]
th = "dth"
al = "dal"
dth = "km*V - ba*dth - h*sin(2*al)*dth*dal + k*sin(al)*dal**2"
dal = "0.5*h*sin(2*al)*dth**2 - bp*dal - mp*9.81*lp*sin(al)"

[inertia]
dth = { dth = "Ja + mp*r**2 + h*sin(al)**2", dal = "k*cos(al)" }
dal = { dth = "k*cos(al)", dal = "Jp + h" }
""",
    motion=_furuta,
    constants={
        "mp": Constant(0.1, 0.2),
        "r": Constant(0.18, 0.25),
        "lp": Constant(0.14, 0.2),
        "Ja": Constant(0.004, 0.01, free=True),
        "Jp": Constant(0.0008, 0.002),
        "km": Constant(0.04, 0.08),
        "ba": Constant(0.008, 0.02, free=True),
        "bp": Constant(0.0008, 0.002, free=True),
    },
    drives={"V": Drive(2.5, (2.0, 12.0))},
    axes=(
        Axis("dth", "th", turning=True, without=("viscous_damping",)),
        Axis("dal", "al", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("th", "position"), Gauge("al", "position")),
    inertial=(Gauge("th", "position"), Gauge("dal", "speed")),
    dt=0.01,
    springs=False,
    without=("added_mass", "coupling_stiffness"),
)

SYSTEMS = (CART_PENDULUM, DOUBLE_PENDULUM, ROTARY_PENDULUM)
