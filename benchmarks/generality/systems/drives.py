"""Drives with electrical states: what moves is pushed by a current that has a rate of its own."""

from __future__ import annotations

from typing import Any

from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values


def _motor(x: Array, u: Array, p: Values, f: Array) -> Any:
    speed, current = x
    return [
        (p["K"] * current - p["b"] * speed + f[0]) / p["J"],
        (u[0] - p["R"] * current - p["K"] * speed) / p["L"],
    ]


DC_MOTOR = System(
    name="dc_motor",
    group="drives",
    states=("w", "i"),
    tables="""
[equations]
w = "(K*i - b*w)/J"
i = "(V - R*i - K*w)/L"
""",
    motion=_motor,
    constants={
        "K": Constant(0.03, 0.08),
        "b": Constant(5e-5, 2e-4, free=True),
        "J": Constant(1e-4, 3e-4, free=True),
        "R": Constant(0.8, 2.0, free=True),
        "L": Constant(3e-3, 8e-3),
    },
    drives={"V": Drive(6.0, (2.0, 25.0))},
    axes=(Axis("w", without=("viscous_damping",)),),
    gauges=(Gauge("w", "speed"), Gauge("i", "other")),
    dt=0.005,
)


def _coil(x: Array, u: Array, p: Values, f: Array) -> Any:
    place, speed, current = x
    pull = p["Bl"] * current - p["Rm"] * speed - place / p["Cm"]
    return [speed, (pull + f[0]) / p["Mm"], (u[0] - p["Re"] * current - p["Bl"] * speed) / p["Le"]]


VOICE_COIL = System(
    name="voice_coil",
    group="drives",
    states=("x", "v", "i"),
    tables="""
[equations]
x = "v"
v = "Bl*i - Rm*v - x/Cm"
i = "(e - Re*i - Bl*v)/Le"

[inertia]
v = { v = "Mm" }
""",
    motion=_coil,
    constants={
        "Bl": Constant(4.0, 9.0),
        "Rm": Constant(0.8, 2.5, free=True),
        "Cm": Constant(3e-4, 9e-4, free=True),
        "Mm": Constant(0.02, 0.05),
        "Re": Constant(3.5, 7.0, free=True),
        "Le": Constant(2e-4, 6e-4),
    },
    drives={"e": Drive(5.0, (40.0, 500.0))},
    axes=(Axis("v", "x", without=("viscous_damping", "linear_stiffness")),),
    gauges=(Gauge("x", "position", 1e3), Gauge("i", "other")),
    inertial=(Gauge("v", "acceleration"), Gauge("i", "other")),
    dt=0.0004,
)


def _belt(x: Array, u: Array, p: Values, f: Array) -> Any:
    motor, load, motor_speed, load_speed, current = x
    belt = p["k"] * (motor - load) + p["c"] * (motor_speed - load_speed)
    return [
        motor_speed,
        load_speed,
        (p["K"] * current - belt + f[0]) / p["Jm"],
        (belt - p["bl"] * load_speed + f[1]) / p["Jl"],
        (u[0] - p["R"] * current - p["K"] * motor_speed) / p["L"],
    ]


BELT_DRIVE = System(
    name="belt_drive",
    group="drives",
    states=("qm", "ql", "wm", "wl", "i"),
    tables="""
[definitions]
belt = "k*(qm - ql) + c*(wm - wl)"

[equations]
qm = "wm"
ql = "wl"
wm = "(K*i - belt)/Jm"
wl = "(belt - bl*wl)/Jl"
i = "(V - R*i - K*wm)/L"
""",
    motion=_belt,
    constants={
        "K": Constant(0.05, 0.1),
        "k": Constant(0.6, 1.5, free=True),
        "c": Constant(1e-3, 3e-3),
        "Jm": Constant(2e-4, 5e-4),
        "Jl": Constant(6e-4, 2e-3, free=True),
        "bl": Constant(5e-4, 2e-3, free=True),
        "R": Constant(1.0, 2.5),
        "L": Constant(4e-3, 9e-3),
    },
    drives={"V": Drive(6.0, (2.0, 30.0))},
    axes=(
        Axis("wm", "qm", turning=True),
        Axis("wl", "ql", turning=True, without=("viscous_damping",)),
    ),
    gauges=(Gauge("qm", "position"), Gauge("ql", "position"), Gauge("i", "other")),
    dt=0.005,
    springs=False,
    without=("coupling_stiffness", "coupling_damping"),
)

SYSTEMS = (DC_MOTOR, VOICE_COIL, BELT_DRIVE)
