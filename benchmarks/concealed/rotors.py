"""Plants that turn: pendulums, a geared servo drive, an arm of two joints."""

from __future__ import annotations

import numpy as np

from benchmarks.concealed.systems import ANGLE, Array, Constant, Drive, System, Values
from benchmarks.concealed.units import NONE, TIME, TORQUE, times

INERTIA = times(TORQUE, TIME, 2)
SPIN = times(TORQUE, TIME)
GRAVITY = 9.81


def _pendulum() -> System:
    return System(
        name="pendulum",
        coordinates=(ANGLE,),
        force_dims=(TORQUE,),
        drives=(Drive("u1", 0, TORQUE),),
        constants={
            "j1": Constant(0.05, 0.2, INERTIA),
            "c1": Constant(0.03, 0.12, SPIN),
            "g1": Constant(1.5, 4.0, TORQUE),
        },
        inertia={0: {0: "j1"}},
        forces=("u1 - c1*v1 - g1*sin(q1)",),
        mass=lambda q, p: [[p["j1"]]],
        applied=lambda q, v, u, p: u - p["c1"] * v,
        bias=lambda q, v, p: -p["g1"] * np.sin(q),
        twins={
            ("viscous_damping", 0): ("c1",),
            ("added_mass", 0): ("j1",),
            ("gravity", 0): ("g1",),
        },
        loops=((0, 0),),
        target=0.7,
        turning=(0,),
    )


def _double_pendulum() -> System:
    def mass(q: Array, p: Values) -> list[list[Array | float]]:
        cross = p["b1"] * np.cos(q[0] - q[1])
        return [[p["j1"], cross], [cross, p["j2"]]]

    def bias(q: Array, v: Array, p: Values) -> Array:
        cross = p["b1"] * np.sin(q[0] - q[1])
        return np.stack(
            [
                -cross * v[1] ** 2 - p["g1"] * np.sin(q[0]),
                cross * v[0] ** 2 - p["g2"] * np.sin(q[1]),
            ]
        )

    def applied(q: Array, v: Array, u: Array, p: Values) -> Array:
        hinge = p["c2"] * (v[0] - v[1])
        return np.stack([u[0] - p["c1"] * v[0] - hinge, hinge])

    def derive(p: dict[str, float]) -> dict[str, float]:
        # drawn: masses in place of j1 and j2, lengths in place of b1 and g1
        m1, m2, l1, l2 = p["j1"], p["j2"], p["b1"], p["g1"]
        return {
            **p,
            "j1": (m1 + m2) * l1**2,
            "j2": m2 * l2**2,
            "b1": m2 * l1 * l2,
            "g1": (m1 + m2) * l1 * GRAVITY,
            "g2": m2 * l2 * GRAVITY,
        }

    return System(
        name="double_pendulum",
        coordinates=(ANGLE, ANGLE),
        force_dims=(TORQUE, TORQUE),
        drives=(Drive("u1", 0, TORQUE),),
        constants={
            "j1": Constant(0.5, 1.5, INERTIA),
            "j2": Constant(0.3, 1.0, INERTIA),
            "b1": Constant(0.3, 0.5, INERTIA),
            "g1": Constant(0.3, 0.5, TORQUE),
            "g2": Constant(1.0, 1.0, TORQUE),
            "c1": Constant(0.05, 0.2, SPIN),
            "c2": Constant(0.02, 0.08, SPIN),
        },
        inertia={0: {0: "j1", 1: "b1*cos(q1 - q2)"}, 1: {0: "b1*cos(q1 - q2)", 1: "j2"}},
        forces=(
            "u1 - c1*v1 - c2*(v1 - v2) - b1*sin(q1 - q2)*v2**2 - g1*sin(q1)",
            "c2*(v1 - v2) + b1*sin(q1 - q2)*v1**2 - g2*sin(q2)",
        ),
        mass=mass,
        applied=applied,
        bias=bias,
        twins={
            ("viscous_damping", 0): ("c1",),
            ("added_mass", 0): ("j1",),
            ("added_mass", 1): ("j2",),
            ("gravity", 0): ("g1",),
            ("gravity", 1): ("g2",),
            ("coupling_damping", 0): ("c2",),
            ("coupling_damping", 1): ("c2",),
        },
        loops=((0, 0),),
        target=0.35,
        turning=(0, 1),
        derive=derive,
    )


def _servo() -> System:
    def applied(q: Array, v: Array, u: Array, p: Values) -> Array:
        twist = p["k1"] * (q[0] / p["n1"] - q[1]) + p["d1"] * (v[0] / p["n1"] - v[1])
        friction = p["h1"] * np.tanh(v[0] / p["w1"])
        return np.stack(
            [
                p["b1"] * u[0] - p["c1"] * v[0] - friction - twist / p["n1"],
                twist - p["c2"] * v[1],
            ]
        )

    def derive(p: dict[str, float]) -> dict[str, float]:
        # the load is drawn as a ratio to the motor's inertia seen through the gear
        return {**p, "j2": p["j2"] * p["j1"] * p["n1"] ** 2}

    return System(
        name="servo",
        coordinates=(ANGLE, ANGLE),
        force_dims=(TORQUE, TORQUE),
        drives=(Drive("u1", 0, NONE, scale="b1"),),
        constants={
            "j1": Constant(2e-4, 5e-4, INERTIA),
            "j2": Constant(0.6, 2.0, INERTIA),
            "n1": Constant(5.0, 20.0, NONE, free=False),
            "b1": Constant(0.05, 0.1, TORQUE, free=False),
            "c1": Constant(5e-4, 2e-3, SPIN),
            "c2": Constant(0.02, 0.06, SPIN),
            "h1": Constant(0.005, 0.015, TORQUE),
            "w1": Constant(0.6, 1.0, (0, 0, -1), free=False),
            "k1": Constant(20.0, 60.0, TORQUE),
            "d1": Constant(0.03, 0.1, SPIN),
        },
        inertia={0: {0: "j1"}, 1: {1: "j2"}},
        forces=(
            "b1*u1 - c1*v1 - h1*tanh(v1/w1) - (k1*(q1/n1 - q2) + d1*(v1/n1 - v2))/n1",
            "k1*(q1/n1 - q2) + d1*(v1/n1 - v2) - c2*v2",
        ),
        mass=lambda q, p: [[p["j1"], 0.0], [0.0, p["j2"]]],
        applied=applied,
        twins={
            ("viscous_damping", 0): ("c1",),
            ("viscous_damping", 1): ("c2",),
            ("coulomb_friction", 0): ("h1",),
            ("added_mass", 0): ("j1",),
            ("added_mass", 1): ("j2",),
        },
        loops=((0, 0),),
        target=8.0,
        derive=derive,
    )


def _arm() -> System:
    def mass(q: Array, p: Values) -> list[list[Array | float]]:
        cosine = np.cos(q[1])
        cross = p["j3"] + p["j2"] * cosine
        return [[p["j1"] + 2.0 * p["j2"] * cosine, cross], [cross, p["j3"]]]

    def bias(q: Array, v: Array, p: Values) -> Array:
        sine, fore = p["j2"] * np.sin(q[1]), p["g2"] * np.sin(q[0] + q[1])
        return np.stack(
            [
                sine * (2.0 * v[0] * v[1] + v[1] ** 2) - p["g1"] * np.sin(q[0]) - fore,
                -sine * v[0] ** 2 - fore,
            ]
        )

    def applied(q: Array, v: Array, u: Array, p: Values) -> Array:
        return np.stack([u[0] - p["c1"] * v[0], u[1] - p["c2"] * v[1]])

    return System(
        name="arm",
        coordinates=(ANGLE, ANGLE),
        force_dims=(TORQUE, TORQUE),
        drives=(Drive("u1", 0, TORQUE), Drive("u2", 1, TORQUE)),
        constants={
            # drawn: masses m1, m2 and lengths l1, l2 of two slender rods
            "j1": Constant(2.0, 5.0, INERTIA),
            "j2": Constant(1.0, 3.0, INERTIA),
            "j3": Constant(0.3, 0.5, INERTIA),
            "g1": Constant(0.3, 0.5, TORQUE),
            "g2": Constant(1.0, 1.0, TORQUE),
            "c1": Constant(0.3, 0.8, SPIN),
            "c2": Constant(0.15, 0.4, SPIN),
        },
        inertia={
            0: {0: "j1 + 2*j2*cos(q2)", 1: "j3 + j2*cos(q2)"},
            1: {0: "j3 + j2*cos(q2)", 1: "j3"},
        },
        forces=(
            "u1 - c1*v1 + j2*sin(q2)*(2*v1*v2 + v2**2) - g1*sin(q1) - g2*sin(q1 + q2)",
            "u2 - c2*v2 - j2*sin(q2)*v1**2 - g2*sin(q1 + q2)",
        ),
        mass=mass,
        applied=applied,
        bias=bias,
        twins={
            ("viscous_damping", 0): ("c1",),
            ("viscous_damping", 1): ("c2",),
            ("gravity", 0): ("g1",),
            ("added_mass", 0): ("j1",),
        },
        loops=((0, 0), (1, 1)),
        target=0.5,
        turning=(0, 1),
        derive=_rods,
        simulator="mujoco",
    )


def _rods(p: dict[str, float]) -> dict[str, float]:
    m1, m2, l1, l2 = p["j1"], p["j2"], p["j3"], p["g1"]
    return {
        **p,
        "j1": m1 * l1**2 / 3 + m2 * (l1**2 + l2**2 / 3),
        "j2": m2 * l1 * l2 / 2,
        "j3": m2 * l2**2 / 3,
        "g1": (m1 / 2 + m2) * l1 * GRAVITY,
        "g2": m2 * l2 / 2 * GRAVITY,
    }


ROTORS = (_pendulum(), _double_pendulum(), _servo(), _arm())
