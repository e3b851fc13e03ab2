"""Linkages: closed kinematics in one coordinate, with an inertia that depends on it."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values


def _slider_motion(angle: Array, r: Any, rod: Any) -> tuple[Array, Array]:
    """Return ds/dq and d2s/dq2 of a crank-slider, from the closed loop.

    The rod keeps its length: (s - r cos q)^2 + (r sin q)^2 = rod^2, differentiated twice.
    """
    across = r * np.sin(angle)
    along = np.sqrt(rod**2 - across**2)  # s - r cos q
    first = -across - across * r * np.cos(angle) / along
    # with g = s - r cos q: g g' = -across across', g'^2 + g g'' = -(across'^2 + across across'')
    turn = r * np.cos(angle)
    rate = -across * turn / along
    second = -turn + (-(turn**2) + across**2 - rate**2) / along
    return first, second


def _crank(x: Array, u: Array, p: Values, f: Array) -> Any:
    angle, speed = x
    first, second = _slider_motion(angle, p["r"], p["l"])
    inertia = p["J"] + p["m"] * first**2
    force = u[0] - p["b"] * speed - p["m"] * first * second * speed**2
    return [speed, (force + f[0]) / inertia]


CRANK_SLIDER = System(
    name="crank_slider",
    group="linkages",
    states=("q", "w"),
    tables="""
[definitions]
rod = "sqrt(l**2 - r**2*sin(q)**2)"
ds = "-r*sin(q) - r**2*sin(q)*cos(q)/rod"
dds = "-r*cos(q) - r**2*cos(2*q)/rod - r**4*sin(q)**2*cos(q)**2/rod**3"

[equations]
q = "w"
w = "tau - b*w - m*ds*dds*w**2"

[inertia]
w = { w = "J + m*ds**2" }
""",
    motion=_crank,
    constants={
        "r": Constant(0.08, 0.12),
        "l": Constant(0.28, 0.4),
        "m": Constant(1.5, 4.0),
        "J": Constant(0.03, 0.08, free=True),
        "b": Constant(0.05, 0.15, free=True),
    },
    drives={"tau": Drive(0.5, (1.5, 12.0), offset=0.7)},
    axes=(Axis("w", "q", turning=True, without=("viscous_damping", "linear_stiffness",
                                                "quadratic_stiffness", "cubic_stiffness",
                                                "piecewise_stiffness", "backlash",
                                                "asymmetric_friction", "coulomb_friction",
                                                "stribeck_friction")),),
    gauges=(Gauge("q", "position"),),
    inertial=(Gauge("q", "position"), Gauge("w", "speed")),
    dt=0.01,
    start={"w": 5.0},
    springs=False,
)  # fmt: skip


def _rocker(angle: Array, p: Values) -> tuple[Array, Array]:
    """Return d(psi)/dq and its derivative: the loop's two equations, solved and differentiated.

    a e^{iq} + b e^{i phi} = g + c e^{i psi}. The position is found by circles that meet, the rates
    by two linear equations each.
    """
    a, b, c, ground = (p[k] for k in ("a", "b", "c", "g"))
    pin = a * np.exp(1j * angle)
    line = ground - pin  # from the crank's pin to the rocker's pivot
    far = np.abs(line)
    along = (b**2 - c**2 + far**2) / (2.0 * far)
    joint = pin + line / far * (along - 1j * -np.sqrt(b**2 - along**2))
    coupler, rocker = np.angle(joint - pin), np.angle(joint - ground)
    # b e^{i phi} phi' - c e^{i psi} psi' = -a e^{i q}
    unit = np.exp(1j * coupler)
    psi = np.imag(1j * a * np.exp(1j * angle) * 1j * np.conj(unit)) / np.imag(
        1j * c * np.exp(1j * rocker) * 1j * np.conj(unit)
    )
    phi = np.real((1j * c * np.exp(1j * rocker) * psi - 1j * pin) / (1j * b * unit))
    # once more: b (i phi'' - phi'^2) e^{i phi} - c (i psi'' - psi'^2) e^{i psi} = a e^{i q}
    right = pin + b * phi**2 * unit - c * psi**2 * np.exp(1j * rocker)
    second = -np.real(right * np.conj(unit)) / np.real(1j * c * np.exp(1j * rocker) * np.conj(unit))
    return psi, second


def _four_bar(x: Array, u: Array, p: Values, f: Array) -> Any:
    angle, speed = x
    first, second = _rocker(angle, p)
    inertia = p["J"] + p["Jr"] * first**2
    force = u[0] - p["d"] * speed - p["Jr"] * first * second * speed**2
    return [speed, (force + f[0]) / inertia]


FOUR_BAR = System(
    name="four_bar",
    group="linkages",
    states=("q", "w"),
    tables="""
[definitions]
px = "a*cos(q)"
py = "a*sin(q)"
far = "sqrt((g - px)**2 + py**2)"
h = "(b**2 - c**2 + far**2)/(2*far)"
up = "sqrt(b**2 - h**2)"
jx = "px + ((g - px)*h + py*up)/far"
jy = "py + (-py*h + (g - px)*up)/far"
phi = "atan2(jy - py, jx - px)"
psi = "atan2(jy, jx - g)"
dpsi = "a*sin(q - phi)/(c*sin(psi - phi))"
dphi = "a*sin(q - psi)/(b*sin(psi - phi))"
ddpsi = "(a*cos(q - phi) + b*dphi**2 - c*dpsi**2*cos(psi - phi))/(c*sin(psi - phi))"

[equations]
q = "w"
w = "(T - d*w - Jr*dpsi*ddpsi*w**2)/(J + Jr*dpsi**2)"
""",
    motion=_four_bar,
    constants={
        "a": Constant(0.05, 0.07),
        "b": Constant(0.18, 0.22),
        "c": Constant(0.14, 0.18),
        "g": Constant(0.19, 0.22),
        "J": Constant(0.004, 0.01, free=True),
        "Jr": Constant(0.03, 0.08, free=True),
        "d": Constant(0.01, 0.03, free=True),
    },
    drives={"T": Drive(0.15, (2.0, 14.0))},
    axes=(Axis("w", "q", turning=True, without=("viscous_damping",)),),
    gauges=(Gauge("q", "position"),),
    inertial=(Gauge("q", "position"), Gauge("w", "acceleration")),
    dt=0.01,
    start={"q": 1.0},
    springs=False,
)


def _yoke(x: Array, u: Array, p: Values, f: Array) -> Any:
    angle, speed = x
    slope = -p["r"] * np.sin(angle)
    spring = p["k"] * p["r"] ** 2 * np.cos(angle) * -np.sin(angle)
    force = u[0] - p["b"] * speed - spring - p["m"] * slope * -p["r"] * np.cos(angle) * speed**2
    return [speed, (force + f[0]) / (p["J"] + p["m"] * slope**2)]


SCOTCH_YOKE = System(
    name="scotch_yoke",
    group="linkages",
    states=("q", "w"),
    tables="""
[equations]
q = "w"
w = "M + 0.5*k*r**2*sin(2*q) - b*w - 0.5*m*r**2*sin(2*q)*w**2"

[inertia]
w = { w = "J + m*r**2*sin(q)**2" }
""",
    motion=_yoke,
    constants={
        "r": Constant(0.1, 0.15),
        "m": Constant(1.0, 3.0, free=True),
        "k": Constant(60.0, 150.0, free=True),
        "J": Constant(0.01, 0.03),
        "b": Constant(0.03, 0.08, free=True),
    },
    drives={"M": Drive(0.5, (2.0, 12.0))},
    axes=(Axis("w", "q", turning=True, without=("viscous_damping",)),),
    gauges=(Gauge("q", "position"),),
    inertial=(Gauge("q", "position"), Gauge("w", "acceleration")),
    dt=0.01,
    start={"q": 1.6},
    springs=True,
)

SYSTEMS = (CRANK_SLIDER, FOUR_BAR, SCOTCH_YOKE)
