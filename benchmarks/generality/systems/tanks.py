"""Tanks and thermal systems: stores of the first order."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values

_NO_MOTION = ("coulomb_friction", "asymmetric_friction", "stribeck_friction", "power_law_drag")


def _tanks(x: Array, u: Array, p: Values, f: Array) -> Any:
    upper, lower = np.sqrt(2.0 * 9.81 * np.maximum(x, 1e-12))
    through = p["a1"] * upper
    return [
        (p["kp"] * u[0] - through + f[0]) / p["A1"],
        (through - p["a2"] * lower + f[1]) / p["A2"],
    ]


TWO_TANKS = System(
    name="coupled_tanks",
    group="tanks",
    states=("h1", "h2"),
    tables="""
[definitions]
q12 = "a1*sqrt(2*9.81*Max(h1, 1e-12))"
qout = "a2*sqrt(2*9.81*Max(h2, 1e-12))"

[equations]
h1 = "(kp*up - q12)/A1"
h2 = "(q12 - qout)/A2"
""",
    motion=_tanks,
    constants={
        "kp": Constant(3e-5, 5e-5),
        "a1": Constant(5e-5, 8e-5, free=True),
        "a2": Constant(4e-5, 7e-5, free=True),
        "A1": Constant(0.003, 0.005),
        "A2": Constant(0.003, 0.005, free=True),
    },
    drives={"up": Drive(1.2, (0.02, 0.25), offset=3.0, steps=True)},
    axes=(Axis("h1", without=_NO_MOTION), Axis("h2", without=_NO_MOTION)),
    gauges=(Gauge("h1", "other", 100.0), Gauge("h2", "other", 100.0)),
    dt=1.0,
    start={"h1": 0.2, "h2": 0.25},
    without=("added_mass", "viscous_damping", "quadratic_drag"),
)


def _heated(x: Array, u: Array, p: Values, f: Array) -> Any:
    heater, body = x
    passed = p["h"] * (heater - body)
    return [
        (u[0] - passed + f[0]) / p["Ch"],
        (passed - p["k"] * (body - u[1]) + f[1]) / p["Cb"],
    ]


HEATED_BODY = System(
    name="heated_body",
    group="tanks",
    states=("Th", "Tb"),
    tables="""
[equations]
Th = "(P - h*(Th - Tb))/Ch"
Tb = "(h*(Th - Tb) - k*(Tb - Ta))/Cb"
""",
    motion=_heated,
    constants={
        "h": Constant(1.5, 3.5, free=True, unit="W/K"),
        "k": Constant(0.8, 2.0, free=True, unit="W/K"),
        "Ch": Constant(25.0, 60.0, unit="J/K"),
        "Cb": Constant(100.0, 250.0, free=True, unit="J/K"),
    },
    drives={
        "P": Drive(25.0, (0.01, 0.12), offset=50.0, steps=True),
        "Ta": Drive(1.5, (0.005, 0.05), offset=20.0, actuator=False),
    },
    axes=(Axis("Th", without=_NO_MOTION), Axis("Tb", without=_NO_MOTION)),
    gauges=(Gauge("Th", "other"), Gauge("Tb", "other")),
    dt=2.0,
    start={"Th": 60.0, "Tb": 45.0},
    without=("added_mass", "viscous_damping"),
)

SYSTEMS = (TWO_TANKS, HEATED_BODY)
