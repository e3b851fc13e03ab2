"""Structures of 5 to 20 masses."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.system import Array, Axis, Constant, Drive, Gauge, System, Values


def _chain_text(count: int, drive: str, at: int) -> str:
    """Equations of masses in a row between two walls, each divided by its mass."""
    lines = ["[equations]"]
    lines += [f'x{i} = "v{i}"' for i in range(1, count + 1)]
    for i in range(1, count + 1):
        left = f"(x{i} - x{i - 1})" if i > 1 else "x1"
        right = f"(x{i} - x{i + 1})" if i < count else f"x{count}"
        push = f"{drive} " if i == at else ""
        lines.append(f'v{i} = "({push}- k*{left} - k*{right} - d*v{i})/m"')
    return "\n".join(lines)


def _chain(at: int, axes: tuple[int, ...]) -> Any:
    def field(x: Array, u: Array, p: Values, f: Array) -> Any:
        count = len(x) // 2
        place, speed = x[:count], x[count:]
        stretch = np.diff(place, axis=0, prepend=0.0 * place[:1], append=0.0 * place[:1])
        force = p["k"] * np.diff(stretch, axis=0) - p["d"] * speed
        force[at - 1] += u[0]
        for k, axis in enumerate(axes):
            force[axis - 1] += f[k]
        return [*speed, *(force / p["m"])]

    return field


CHAIN_5 = System(
    name="five_masses",
    group="structures",
    states=(*(f"x{i}" for i in range(1, 6)), *(f"v{i}" for i in range(1, 6))),
    tables=_chain_text(5, "F", 2),
    motion=_chain(2, (1, 2, 3, 4, 5)),
    constants={
        "k": Constant(400.0, 900.0, free=True),
        "d": Constant(0.5, 1.5, free=True),
        "m": Constant(0.5, 1.5, free=True),
    },
    drives={"F": Drive(12.0, (3.0, 45.0))},
    axes=tuple(
        Axis(f"v{i}", f"x{i}", without=("viscous_damping",) if i == 0 else ()) for i in range(1, 6)
    ),
    gauges=(
        Gauge("x1", "position"),
        Gauge("x2", "position"),
        Gauge("x4", "position"),
        Gauge("x5", "position"),
    ),
    inertial=(
        Gauge("v1", "acceleration"),
        Gauge("v2", "acceleration"),
        Gauge("v4", "acceleration"),
        Gauge("x5", "position"),
    ),
    dt=0.01,
    pairs=((0, 2), (1, 4), (0, 4)),
)


def _storeys_text(count: int) -> str:
    lines = ["[definitions]"]
    for i in range(1, count + 1):
        below = (f"(x{i} - x{i - 1})", f"(v{i} - v{i - 1})") if i > 1 else ("x1", "v1")
        stiffness = "k1" if i == 1 else "k"
        lines.append(f's{i} = "{stiffness}*{below[0]} + c*{below[1]}"')
    lines += ["", "[equations]"]
    lines += [f'x{i} = "v{i}"' for i in range(1, count + 1)]
    for i in range(1, count + 1):
        above = f" + s{i + 1}" if i < count else ""
        lines.append(f'v{i} = "-s{i}{above} - m*ag"')
    lines += ["", "[inertia]"]
    lines += [f'v{i} = {{ v{i} = "m" }}' for i in range(1, count + 1)]
    return "\n".join(lines)


def _storeys(x: Array, u: Array, p: Values, f: Array) -> Any:
    count = len(x) // 2
    drift = np.diff(x[:count], axis=0, prepend=0.0 * x[:1])
    rate = np.diff(x[count:], axis=0, prepend=0.0 * x[:1])
    shear = p["k"] * drift + p["c"] * rate
    shear[0] = p["k1"] * drift[0] + p["c"] * rate[0]
    force = np.diff(shear, axis=0, append=0.0 * x[:1]) - p["m"] * u[0]
    return [*x[count:], *((force + f) / p["m"])]


BUILDING = System(
    name="eight_storeys",
    group="structures",
    states=(*(f"x{i}" for i in range(1, 9)), *(f"v{i}" for i in range(1, 9))),
    tables=_storeys_text(8),
    motion=_storeys,
    constants={
        "m": Constant(900.0, 1400.0),
        "k": Constant(8e5, 1.6e6, free=True),
        "k1": Constant(6e5, 1.4e6, free=True),
        "c": Constant(1500.0, 4000.0, free=True),
    },
    drives={"ag": Drive(1.5, (2.0, 40.0), actuator=False)},
    axes=tuple(Axis(f"v{i}", f"x{i}") for i in range(1, 9)),
    gauges=tuple(Gauge(f"x{i}", "position", 1e3) for i in (1, 2, 3, 5, 8)),
    inertial=(
        Gauge("v1", "acceleration"),
        Gauge("v3", "acceleration"),
        Gauge("v5", "acceleration"),
        Gauge("v8", "acceleration"),
        Gauge("x1", "position", 1e3),
    ),
    dt=0.01,
    pairs=((0, 3), (1, 4)),
    without=("added_mass",),
)

CHAIN_20 = System(
    name="twenty_masses",
    group="structures",
    states=(*(f"x{i}" for i in range(1, 21)), *(f"v{i}" for i in range(1, 21))),
    tables=_chain_text(20, "F", 7),
    motion=_chain(7, (2, 7, 12, 18)),
    constants={
        "k": Constant(1500.0, 3000.0, free=True),
        "d": Constant(0.5, 1.2, free=True),
        "m": Constant(0.4, 0.8),
    },
    drives={"F": Drive(30.0, (3.0, 45.0))},
    axes=tuple(Axis(f"v{i}", f"x{i}") for i in (2, 7, 12, 18)),
    gauges=tuple(Gauge(f"x{i}", "position", 1e3) for i in (2, 5, 7, 10, 12, 15, 18, 20)),
    inertial=tuple(Gauge(f"v{i}", "acceleration") for i in (2, 5, 7, 10, 12, 15, 18, 20)),
    dt=0.01,
    pairs=((0, 1), (1, 2)),
)

SYSTEMS = (CHAIN_5, BUILDING, CHAIN_20)
