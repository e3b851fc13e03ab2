"""Plants on a straight axis: carts, chains of masses, a quarter of a car, a crane."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.systems import (
    ANGLE,
    DAMPING,
    STIFFNESS,
    Array,
    Constant,
    Drive,
    System,
    Values,
)
from benchmarks.concealed.units import FORCE, LENGTH, MASS, NONE, TIME, TORQUE, times

_U = Drive("u1", 0)


def _rail_cart() -> System:
    return System(
        name="rail_cart",
        coordinates=(LENGTH,),
        force_dims=(FORCE,),
        drives=(_U,),
        constants={"m1": Constant(2, 20, MASS), "c1": Constant(6, 30, DAMPING)},
        inertia={0: {0: "m1"}},
        forces=("u1 - c1*v1",),
        mass=lambda q, p: [[p["m1"]]],
        applied=lambda q, v, u, p: u - p["c1"] * v,
        twins={("viscous_damping", 0): ("c1",), ("added_mass", 0): ("m1",)},
        loops=((0, 0),),
        target=0.1,
    )


def _oscillator() -> System:
    return System(
        name="oscillator",
        coordinates=(LENGTH,),
        force_dims=(FORCE,),
        drives=(_U,),
        constants={
            "m1": Constant(0.5, 3, MASS),
            "c1": Constant(0.4, 2, DAMPING),
            "k1": Constant(40, 160, STIFFNESS),
        },
        inertia={0: {0: "m1"}},
        forces=("u1 - c1*v1 - k1*q1",),
        mass=lambda q, p: [[p["m1"]]],
        applied=lambda q, v, u, p: u - p["c1"] * v - p["k1"] * q,
        springs={"k1": (1.0,)},
        twins={
            ("viscous_damping", 0): ("c1",),
            ("added_mass", 0): ("m1",),
            ("linear_stiffness", 0): ("k1",),
        },
        loops=((0, 0),),
        target=0.05,
    )


def chain(count: int) -> System:
    """Return a chain of masses, the first tied to the wall and pushed."""

    def applied(q: Array, v: Array, u: Array, p: Values) -> Array:
        out = np.empty_like(q)
        out[0] = u[0]
        for i in range(count):
            stretch = q[i] - (q[i - 1] if i else 0.0)
            rate = v[i] - (v[i - 1] if i else 0.0)
            pull = p[f"k{i + 1}"] * stretch + p[f"c{i + 1}"] * rate
            if i:
                out[i] = 0.0
                out[i - 1] += pull
            out[i] -= pull
        return out

    def text(i: int) -> str:
        own = (
            f"- k{i + 1}*(q{i + 1} - q{i}) - c{i + 1}*(v{i + 1} - v{i})"
            if i
            else "u1 - k1*q1 - c1*v1"
        )
        n = i + 2
        more = f" + k{n}*(q{n} - q{n - 1}) + c{n}*(v{n} - v{n - 1})" if i + 1 < count else ""
        return own + more

    constants = {f"m{i + 1}": Constant(0.6, 2.5, MASS) for i in range(count)}
    constants |= {f"c{i + 1}": Constant(0.4, 1.5, DAMPING) for i in range(count)}
    constants |= {f"k{i + 1}": Constant(50, 150, STIFFNESS) for i in range(count)}
    springs = {}
    for i in range(count):
        g = [0.0] * count
        g[i] = 1.0
        if i:
            g[i - 1] = -1.0
        springs[f"k{i + 1}"] = tuple(g)
    twins = {("added_mass", i): (f"m{i + 1}",) for i in range(count)}
    twins |= {("viscous_damping", 0): ("c1",), ("linear_stiffness", 0): ("k1",)}
    return System(
        name={2: "two_mass", 3: "three_mass"}[count],
        coordinates=(LENGTH,) * count,
        force_dims=(FORCE,) * count,
        drives=(_U,),
        constants=constants,
        inertia={i: {i: f"m{i + 1}"} for i in range(count)},
        forces=tuple(text(i) for i in range(count)),
        mass=lambda q, p: [
            [p[f"m{i + 1}"] if i == j else 0.0 for j in range(count)] for i in range(count)
        ],
        applied=applied,
        springs=springs,
        twins=twins,
        loops=((0, 0),),
        target=0.05,
    )


def _quarter_car() -> System:
    def applied(q: Array, v: Array, u: Array, p: Values) -> Array:
        strut = p["k1"] * (q[0] - q[1]) + p["c1"] * (v[0] - v[1])
        return np.stack([-strut, strut - p["k2"] * (q[1] - u[0])])

    return System(
        name="quarter_car",
        coordinates=(LENGTH, LENGTH),
        force_dims=(FORCE, FORCE),
        drives=(Drive("u1", 1, LENGTH, actuated=False, scale="k2"),),
        constants={
            "m1": Constant(250, 450, MASS),
            "m2": Constant(40, 60, MASS),
            "k1": Constant(15e3, 30e3, STIFFNESS),
            "c1": Constant(800, 1800, DAMPING),
            "k2": Constant(120e3, 200e3, STIFFNESS),
        },
        inertia={0: {0: "m1"}, 1: {1: "m2"}},
        forces=(
            "-k1*(q1 - q2) - c1*(v1 - v2)",
            "k1*(q1 - q2) + c1*(v1 - v2) - k2*(q2 - u1)",
        ),
        mass=lambda q, p: [[p["m1"], 0.0], [0.0, p["m2"]]],
        applied=applied,
        springs={"k1": (1.0, -1.0)},
        twins={("added_mass", 0): ("m1",), ("added_mass", 1): ("m2",)},
        target=0.02,
    )


def _crane() -> System:
    def mass(q: Array, p: Values) -> list[list[Array | float]]:
        cross = p["s1"] * np.cos(q[1])
        return [[p["m1"], cross], [cross, p["j1"]]]

    def bias(q: Array, v: Array, p: Values) -> Array:
        sine = np.sin(q[1])
        return np.stack([p["s1"] * v[1] ** 2 * sine, -p["s1"] * p["g0"] * sine])

    def derive(p: dict[str, float]) -> dict[str, float]:
        load, rope = p["s1"], p["j1"]
        return {**p, "m1": p["m1"] + load, "s1": load * rope, "j1": load * rope**2}

    return System(
        name="crane",
        coordinates=(LENGTH, ANGLE),
        force_dims=(FORCE, TORQUE),
        drives=(_U,),
        constants={
            # drawn as the trolley's mass, the load's mass and the length of the rope
            "m1": Constant(1.0, 3.0, MASS),
            "s1": Constant(0.2, 1.0, times(MASS, LENGTH)),
            "j1": Constant(0.3, 0.8, times(MASS, LENGTH, 2)),
            "c1": Constant(2.0, 6.0, DAMPING),
            "c2": Constant(0.004, 0.02, times(TORQUE, TIME)),
            "g0": Constant(9.81, 9.81, (0, 1, -2), free=False),
        },
        inertia={0: {0: "m1", 1: "s1*cos(q2)"}, 1: {0: "s1*cos(q2)", 1: "j1"}},
        forces=(
            "u1 - c1*v1 + s1*v2**2*sin(q2)",
            "-s1*g0*sin(q2) - c2*v2",
        ),
        mass=mass,
        applied=lambda q, v, u, p: np.stack([u[0] - p["c1"] * v[0], -p["c2"] * v[1]]),
        bias=bias,
        twins={
            ("viscous_damping", 0): ("c1",),
            ("viscous_damping", 1): ("c2",),
            ("added_mass", 0): ("m1",),
            ("added_mass", 1): ("j1",),
            ("gravity", 1): ("g0",),
        },
        loops=((0, 0),),
        target=0.25,
        turning=(1,),
        derive=derive,
        simulator="mujoco",
    )


def _tanks() -> System:
    def applied(q: Array, v: Array, u: Array, p: Values) -> Array:
        first = p["a1"] * np.sqrt(np.maximum(q[0], 0.0))
        second = p["a2"] * np.sqrt(np.maximum(q[1], 0.0))
        return np.stack([p["b1"] * u[0] - first, first - second])

    def rest(p: Values) -> tuple[Array, Array]:
        first = 0.25
        flow = p["a1"] * np.sqrt(first)
        return np.array([first, float((flow / p["a2"]) ** 2)]), np.array([flow / p["b1"]])

    outlet = (0, 2.5, -1)  # a flow over the root of a length
    return System(
        name="tanks",
        coordinates=(LENGTH, LENGTH),
        force_dims=((0, 3, -1), (0, 3, -1)),
        drives=(Drive("u1", 0, NONE, scale="b1"),),
        constants={
            "f1": Constant(0.01, 0.03, (0, 2, 0), free=False),
            "f2": Constant(0.01, 0.03, (0, 2, 0), free=False),
            "a1": Constant(0.0017, 0.0023, outlet),
            "a2": Constant(0.0017, 0.0023, outlet),
            "b1": Constant(0.0002, 0.0006, (0, 3, -1)),
        },
        inertia={0: {0: "f1"}, 1: {1: "f2"}},
        forces=(
            "b1*u1 - a1*sqrt(Max(q1, 0))",
            "a1*sqrt(Max(q1, 0)) - a2*sqrt(Max(q2, 0))",
        ),
        mass=lambda q, p: [[p["f1"], 0.0], [0.0, p["f2"]]],
        applied=applied,
        twins={("added_mass", 0): ("f1",), ("added_mass", 1): ("f2",)},
        loops=((0, 0),),
        target=0.06,
        order=1,
        rest=rest,
    )


CHAINS = (_rail_cart(), _oscillator(), chain(2), chain(3), _quarter_car(), _crane(), _tanks())
