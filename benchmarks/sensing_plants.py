"""Plants of the sensing benchmark: systems with encoders, converters and accelerometers.

A plant says its motion twice: as a model file, which the diagnosis reads, and as a function that
SciPy integrates. Parameters, excitation and noise are drawn by a seed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.sensing_plant import Plant, Sensor, Values

# -- motors: current and speed measured, the angle not ---------------------------------------------


def _dc(x: Any, u: Any, p: Values, f: Callable[..., Any]) -> Any:
    th, w, i = x
    return [
        w,
        (p["K"] * i - p["b"] * w + f(th, w)) / p["J"],
        (u - p["R"] * i - p["K"] * w) / p["L"],
    ]


DC_MOTOR = Plant(
    "DC motor",
    ("th", "w", "i"),
    {"th": "w", "w": "(K*i - b*w)/J", "i": "(u - R*i - K*w)/L"},
    {"i_m": "i", "w_m": "w"},
    _dc,
    lambda x, dx, p: [x[2], x[1]],
    {
        "J": (8e-5, 3e-4),
        "K": (0.03, 0.08),
        "b": (5e-5, 2e-4),
        "R": (0.6, 2.0),
        "L": (2e-3, 8e-3),
    },
    {"i_m": Sensor(4096, 0.003), "w_m": Sensor(0, 0.003)},
    1,
    "J",
    5.0,
    (3.0, 30.0),
    units={"w": "rad/s", "i": "A", "u": "V", "th": "rad", "i_m": "A", "w_m": "rad/s"},
    sample_time=0.005,
)

GEARED = Plant(
    "geared motor",
    ("q", "v", "i"),
    {"q": "v", "v": "20*kt*i - d*v", "i": "(u - R*i - 20*kt*v)/L"},
    {"cur": "i", "rpm": "v*30/pi"},
    lambda x, u, p, f: [
        x[1],
        (20.0 * p["kt"] * x[2] - p["d"] * x[1] + f(x[0], x[1])) / p["Jo"],
        (u - p["R"] * x[2] - 20.0 * p["kt"] * x[1]) / p["L"],
    ],
    lambda x, dx, p: [x[2], x[1] * 30.0 / np.pi],
    {
        "kt": (0.02, 0.05),
        "d": (0.05, 0.2),
        "Jo": (0.04, 0.12),
        "R": (0.8, 2.0),
        "L": (2e-3, 6e-3),
    },
    {"cur": Sensor(0, 0.004), "rpm": Sensor(2000, 0.002)},
    1,
    "Jo",
    8.0,
    (2.0, 25.0),
    inertia={"v": "Jo"},
    sample_time=0.005,
)

FAN = Plant(  # never looked at during development
    "fan",
    ("th", "w", "i"),
    {"th": "w", "w": "(kt*i - D*w*Abs(w))/J", "i": "(u - R*i - kt*w)/L"},
    {"i_m": "i", "w_m": "w"},
    lambda x, u, p, f: [
        x[1],
        (p["kt"] * x[2] - p["D"] * x[1] * np.abs(x[1]) + f(x[0], x[1])) / p["J"],
        (u - p["R"] * x[2] - p["kt"] * x[1]) / p["L"],
    ],
    lambda x, dx, p: [x[2], x[1]],
    {
        "kt": (0.03, 0.06),
        "D": (2e-6, 8e-6),
        "J": (1e-4, 3e-4),
        "R": (0.8, 2.0),
        "L": (2e-3, 6e-3),
    },
    {"i_m": Sensor(1024, 0.005), "w_m": Sensor(1000, 0.002)},
    1,
    "J",
    6.0,
    (2.0, 20.0),
    sample_time=0.005,
)

# -- accelerometers --------------------------------------------------------------------------------


def _sprung(x: Any, u: Any, p: Values, f: Callable[..., Any]) -> Any:
    return [x[1], (u - p["c"] * x[1] - p["k"] * x[0] + f(*x)) / p["m"]]


_SPRUNG: dict[str, Any] = {
    "states": ("q", "v"),
    "motion": _sprung,
    "ranges": {"m": (0.8, 2.5), "c": (0.5, 2.0), "k": (30.0, 120.0)},
    "speed": 1,
    "mass": "m",
    "amplitude": 12.0,
    "band": (2.0, 15.0),
}
_DIVIDED = {"q": "v", "v": "(u - c*v - k*q)/m"}


def _with_position(x: Any, dx: Any, p: Values) -> Any:
    return [x[0], dx[1]]


ACCELEROMETERS = (
    Plant(
        "shaker, accelerometer alone",
        equations=_DIVIDED,
        readings={"acc": "d(v)"},
        read=lambda x, dx, p: [dx[1]],
        sensors={"acc": Sensor(0, 0.005)},
        **_SPRUNG,
    ),
    Plant(
        "shaker with encoder, right-hand side in another order",
        equations=_DIVIDED,
        readings={"y": "q", "acc": "(-k*q + u - v*c)/m"},
        read=_with_position,
        sensors={"y": Sensor(2000), "acc": Sensor(0, 0.01)},
        **_SPRUNG,
    ),
    Plant(
        "shaker with inertia, gravity and a scale",
        equations={"q": "v", "v": "u - c*v - k*q"},
        inertia={"v": "m"},
        readings={"y": "q", "acc": "0.102*(d(v) + 9.81)"},
        read=lambda x, dx, p: [x[0], 0.102 * (dx[1] + 9.81)],
        sensors={"y": Sensor(1000), "acc": Sensor(1024, 0.005)},
        **_SPRUNG,
    ),
    Plant(
        "shaker, right-hand side through definitions",
        definitions={"pull": "u - k*q"},
        equations={"q": "v", "v": "(pull - c*v)/m"},
        readings={"y": "q", "acc": "pull/m - c*v/m + 9.81"},
        read=lambda x, dx, p: [x[0], dx[1] + 9.81],
        sensors={"y": Sensor(0, 0.003), "acc": Sensor(0, 0.01)},
        **_SPRUNG,
    ),
    Plant(  # never looked at during development
        "pendulum with a tangential accelerometer",
        states=("q", "w"),
        equations={"q": "w", "w": "(u - b*w - G*sin(q))/J"},
        readings={"enc": "q", "acc": "0.4*((u - b*w - G*sin(q))/J)"},
        motion=lambda x, u, p, f: [
            x[1],
            (u - p["b"] * x[1] - p["G"] * np.sin(x[0]) + f(*x)) / p["J"],
        ],
        read=lambda x, dx, p: [x[0], 0.4 * dx[1]],
        ranges={"b": (0.02, 0.08), "G": (0.8, 2.0), "J": (0.03, 0.08)},
        sensors={"enc": Sensor(1000), "acc": Sensor(0, 0.01)},
        speed=1,
        mass="J",
        amplitude=0.5,
        band=(1.5, 9.0),
    ),
)

# -- encoders --------------------------------------------------------------------------------------

PENDULUM = Plant(
    "pendulum",
    ("q", "w"),
    {"q": "w", "w": "(u - b*w - G*sin(q))/J"},
    {"enc": "q"},
    lambda x, u, p, f: [x[1], (u - p["b"] * x[1] - p["G"] * np.sin(x[0]) + f(*x)) / p["J"]],
    lambda x, dx, p: [x[0]],
    {"b": (0.02, 0.08), "G": (0.8, 2.0), "J": (0.03, 0.08)},
    {"enc": Sensor(-2.0 * np.pi / 4096)},
    1,
    "J",
    0.5,
    (1.5, 9.0),
)

SERVO = Plant(
    "servo",
    ("th", "w", "i"),
    {"th": "w", "w": "(K*i - b*w - ks*th)/J", "i": "(u - R*i - K*w)/L"},
    {"enc": "th", "cur": "i"},
    lambda x, u, p, f: [
        x[1],
        (p["K"] * x[2] - p["b"] * x[1] - p["ks"] * x[0] + f(x[0], x[1])) / p["J"],
        (u - p["R"] * x[2] - p["K"] * x[1]) / p["L"],
    ],
    lambda x, dx, p: [x[0], x[2]],
    {
        "J": (1e-4, 3e-4),
        "K": (0.03, 0.08),
        "b": (1e-4, 4e-4),
        "ks": (0.02, 0.06),
        "R": (0.8, 2.0),
        "L": (3e-3, 8e-3),
    },
    {"enc": Sensor(-2.0 * np.pi / 2000), "cur": Sensor(4096, 0.001)},
    1,
    "J",
    4.0,
    (3.0, 25.0),
    sample_time=0.005,
)

AXIS = Plant(
    "belt axis",
    ("x", "v"),
    {"x": "v", "v": "u - Fv*v"},
    {"pos": "x", "vel": "v"},
    lambda x, u, p, f: [x[1], (u - p["Fv"] * x[1] + f(*x)) / p["M"]],
    lambda x, dx, p: [x[0], x[1]],
    {"Fv": (4.0, 12.0), "M": (1.0, 4.0)},
    {"pos": Sensor(2000), "vel": Sensor(differenced="pos")},
    1,
    "M",
    10.0,
    (2.0, 12.0),
    delays={"vel": 0.005},  # a backward difference is the speed half a sample ago
    inertia={"v": "M"},
)

TWO_MASSES = Plant(  # never looked at during development
    "two masses",
    ("q1", "q2", "v1", "v2"),
    {
        "q1": "v1",
        "q2": "v2",
        "v1": "(u - k*(q1 - q2) - c*(v1 - v2) - b1*v1)/m1",
        "v2": "(k*(q1 - q2) + c*(v1 - v2) - k2*q2)/m2",
    },
    {"e1": "q1", "e2": "q2"},
    lambda x, u, p, f: [
        x[2],
        x[3],
        (u - p["k"] * (x[0] - x[1]) - p["c"] * (x[2] - x[3]) - p["b1"] * x[2] + f(x[0], x[2]))
        / p["m1"],
        (p["k"] * (x[0] - x[1]) + p["c"] * (x[2] - x[3]) - p["k2"] * x[1]) / p["m2"],
    ],
    lambda x, dx, p: [x[0], x[1]],
    {
        "k": (60.0, 150.0),
        "c": (0.5, 2.0),
        "b1": (1.0, 3.0),
        "m1": (0.8, 2.0),
        "k2": (30.0, 80.0),
        "m2": (0.5, 1.5),
    },
    {"e1": Sensor(1500), "e2": Sensor(400)},
    2,
    "m1",
    10.0,
    (2.0, 15.0),
)

MOTORS = (DC_MOTOR, GEARED, FAN)
ENCODERS = (PENDULUM, SERVO, AXIS, TWO_MASSES)
