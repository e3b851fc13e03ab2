"""Arms of one to three joints."""

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


def _flexible(x: Array, u: Array, p: Values, f: Array) -> Any:
    link, motor, link_speed, motor_speed = x
    spring = p["k"] * (motor - link)
    return [
        link_speed,
        motor_speed,
        (spring - p["mgl"] * np.sin(link) + f[0]) / p["I"],
        (u[0] - spring - p["Bm"] * motor_speed + f[1]) / p["Jm"],
    ]


FLEXIBLE_JOINT = System(
    name="flexible_joint",
    group="arms",
    states=("ql", "qm", "wl", "wm"),
    tables="""
[equations]
ql = "wl"
qm = "wm"
wl = "(k*(qm - ql) - mgl*sin(ql))/I"
wm = "(u - k*(qm - ql) - Bm*wm)/Jm"
""",
    motion=_flexible,
    constants={
        "k": Constant(20.0, 50.0, free=True),
        "mgl": Constant(3.0, 7.0, free=True),
        "I": Constant(0.2, 0.5),
        "Bm": Constant(0.1, 0.4, free=True),
        "Jm": Constant(0.05, 0.15),
    },
    drives={"u": Drive(3.0, (1.0, 12.0))},
    axes=(
        Axis("wl", "ql", turning=True),
        Axis("wm", "qm", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("ql", "position"), Gauge("qm", "position")),
    inertial=(Gauge("wl", "speed"), Gauge("qm", "position")),
    dt=0.01,
    pairs=((0, 1),),
    without=("coupling_stiffness",),
)


def _planar(angles: Array, speeds: Array, p: Values, lengths: Any, gravity: float) -> Any:
    """Return mass matrix and forces of joints of a planar arm by its centres' Jacobians.

    M = sum m J' J + I w w', h = sum m J' Jdot v, with joint angles counted from the link before.
    """
    n = len(angles)
    total, rate = np.cumsum(angles, axis=0), np.cumsum(speeds, axis=0)
    mass = [[0.0] * n for _ in range(n)]
    force: list[Any] = [0.0] * n
    for link in range(n):
        # the centre is a sum of steps along the links up to this one
        steps = [*lengths[:link], p[f"c{link + 1}"]]
        jx: list[Any] = [0.0] * n
        jy: list[Any] = [0.0] * n
        ax: Any = 0.0
        ay: Any = 0.0
        for k, step in enumerate(steps):
            for joint in range(k + 1):
                jx[joint] = jx[joint] - step * np.sin(total[k])
                jy[joint] = jy[joint] + step * np.cos(total[k])
            ax = ax - step * np.cos(total[k]) * rate[k] ** 2
            ay = ay - step * np.sin(total[k]) * rate[k] ** 2
        m, inertia = p[f"m{link + 1}"], p[f"I{link + 1}"]
        for i in range(link + 1):
            force[i] = force[i] - m * (jx[i] * ax + jy[i] * (ay + gravity))
            for j in range(link + 1):
                mass[i][j] = mass[i][j] + m * (jx[i] * jx[j] + jy[i] * jy[j]) + inertia
    return mass, force


def _two(x: Array, u: Array, p: Values, f: Array) -> Any:
    angles, speeds = x[:2], x[2:]
    mass, force = _planar(angles, speeds, p, (p["l1"],), GRAVITY)
    total = np.stack([u[0] + force[0] - p["d1"] * speeds[0], u[1] + force[1] - p["d2"] * speeds[1]])
    return [*speeds, *solved(mass, total + f)]


TWO_JOINTS = System(
    name="two_joints",
    group="arms",
    states=("q1", "q2", "w1", "w2"),
    tables="""
[definitions]
al = "I1 + m1*c1**2 + m2*l1**2"
be = "m2*l1*c2"
ga = "I2 + m2*c2**2"
g2 = "m2*9.81*c2*cos(q1 + q2)"

[equations]
q1 = "w1"
q2 = "w2"
w1 = "u1 - d1*w1 + be*sin(q2)*(2*w1*w2 + w2**2) - (m1*c1 + m2*l1)*9.81*cos(q1) - g2"
w2 = "u2 - d2*w2 - be*sin(q2)*w1**2 - g2"

[inertia]
w1 = { w1 = "al + ga + 2*be*cos(q2)", w2 = "ga + be*cos(q2)" }
w2 = { w1 = "ga + be*cos(q2)", w2 = "ga" }
""",
    motion=_two,
    constants={
        "m1": Constant(1.5, 3.0),
        "m2": Constant(0.8, 2.0, free=True),
        "l1": Constant(0.3, 0.4),
        "c1": Constant(0.13, 0.2),
        "c2": Constant(0.12, 0.2),
        "I1": Constant(0.02, 0.04),
        "I2": Constant(0.01, 0.03),
        "d1": Constant(0.3, 0.8, free=True),
        "d2": Constant(0.15, 0.4, free=True),
    },
    drives={"u1": Drive(4.0, (1.0, 9.0)), "u2": Drive(1.2, (1.5, 12.0))},
    axes=(
        Axis("w1", "q1", turning=True, without=("viscous_damping",)),
        Axis("w2", "q2", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("q1", "position"), Gauge("q2", "position")),
    inertial=(Gauge("w1", "speed"), Gauge("q2", "position"), Gauge("q1", "position")),
    dt=0.01,
    start={"q1": -1.57},
    pairs=((0, 1),),
    without=("coupling_stiffness", "added_mass"),
)


def _three(x: Array, u: Array, p: Values, f: Array) -> Any:
    angles, speeds = x[:3], x[3:]
    mass, force = _planar(angles, speeds, p, (p["l1"], p["l2"]), 0.0)
    total = np.stack(
        [u[k] + force[k] - p[f"d{k + 1}"] * speeds[k] - p["ks"] * angles[k] for k in range(3)]
    )
    return [*speeds, *solved(mass, total + f)]


THREE_JOINTS = System(
    name="scara_springs",
    group="arms",
    states=("q1", "q2", "q3", "w1", "w2", "w3"),
    tables="""
[definitions]
A = "I1 + m1*c1**2 + (m2 + m3)*l1**2"
B = "I2 + m2*c2**2 + m3*l2**2"
C = "I3 + m3*c3**2"
D = "(m2*c2 + m3*l2)*l1"
F = "m3*c3*l1"
G = "m3*c3*l2"
s2 = "w1 + w2"
s3 = "w1 + w2 + w3"
p1 = "D*sin(q2)*s2**2 + F*sin(q2 + q3)*s3**2"
p2 = "-D*sin(q2)*w1**2 + G*sin(q3)*s3**2"
p3 = "-F*sin(q2 + q3)*w1**2 - G*sin(q3)*s2**2"
m33 = "C"
m23 = "C + G*cos(q3)"
m13 = "C + G*cos(q3) + F*cos(q2 + q3)"
m22 = "B + C + 2*G*cos(q3)"
m12 = "B + C + 2*G*cos(q3) + D*cos(q2) + F*cos(q2 + q3)"
m11 = "A + B + C + 2*D*cos(q2) + 2*F*cos(q2 + q3) + 2*G*cos(q3)"

[equations]
q1 = "w1"
q2 = "w2"
q3 = "w3"
w1 = "t1 - d1*w1 - ks*q1 + p1 + p2 + p3"
w2 = "t2 - d2*w2 - ks*q2 + p2 + p3"
w3 = "t3 - d3*w3 - ks*q3 + p3"

[inertia]
w1 = { w1 = "m11", w2 = "m12", w3 = "m13" }
w2 = { w1 = "m12", w2 = "m22", w3 = "m23" }
w3 = { w1 = "m13", w2 = "m23", w3 = "m33" }
""",
    motion=_three,
    constants={
        "m1": Constant(2.0, 3.5),
        "m2": Constant(1.2, 2.2),
        "m3": Constant(0.6, 1.2, free=True),
        "l1": Constant(0.25, 0.35),
        "l2": Constant(0.2, 0.3),
        "c1": Constant(0.12, 0.16),
        "c2": Constant(0.1, 0.14),
        "c3": Constant(0.08, 0.12),
        "I1": Constant(0.02, 0.04),
        "I2": Constant(0.01, 0.02),
        "I3": Constant(0.004, 0.01),
        "d1": Constant(0.4, 0.9, free=True),
        "d2": Constant(0.2, 0.5, free=True),
        "d3": Constant(0.08, 0.2, free=True),
        "ks": Constant(1.5, 3.0),
    },
    drives={
        "t1": Drive(3.0, (1.0, 8.0)),
        "t2": Drive(1.2, (1.5, 9.0)),
        "t3": Drive(0.5, (2.0, 12.0)),
    },
    axes=tuple(
        Axis(f"w{k}", f"q{k}", turning=True, without=("viscous_damping",)) for k in (1, 2, 3)
    ),
    gauges=tuple(Gauge(f"q{k}", "position") for k in (1, 2, 3)),
    inertial=(Gauge("q1", "position"), Gauge("w2", "speed"), Gauge("q3", "position")),
    dt=0.01,
    pairs=((0, 1), (1, 2)),
    without=("added_mass",),
)

SYSTEMS = (FLEXIBLE_JOINT, TWO_JOINTS, THREE_JOINTS)
