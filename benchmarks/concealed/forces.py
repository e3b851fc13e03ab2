"""Forces that a model may leave out, as laws of their own: friction, springs, inertia, waves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.concealed.effects import E, Effect, Look, Scene, on
from benchmarks.concealed.systems import per
from benchmarks.concealed.units import NONE, TIME, Dims, times

Law = Callable[[Look, E], np.ndarray]
CRISP = 0.01
"""Width of the reversal of dry friction, as a share of the rms velocity."""


def _law(
    mechanism: str,
    row: int,
    law: Law,
    values: dict[str, float],
    dims: dict[str, Dims],
    masters: tuple[str, ...],
    **more: Any,
) -> Effect:
    return Effect(
        mechanism,
        "equation",
        row,
        values,
        dims,
        masters,
        force=lambda look, e: on(look, row, law(look, e)),
        **more,
    )


def _crisp_sign(scene: Scene, row: int) -> Callable[[np.ndarray], np.ndarray]:
    width = CRISP * scene.v_rms(row)
    return lambda v: np.tanh(v / width)


def dissipative(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return a friction or a drag in a row."""
    x, force = scene.system.coordinates[row], scene.system.force_dims[row]
    sign = _crisp_sign(scene, row)
    v_rms, q_max = scene.v_rms(row), scene.q_max(row)
    viscous, square = per(force, x, 1, 1), per(force, x, 2, 2)
    if mechanism == "viscous_damping":
        return _law(
            mechanism, row, lambda w, e: -e["Fv"] * w.v[row], {"Fv": 1.0}, {"Fv": viscous}, ("Fv",)
        )
    if mechanism == "coulomb_friction":
        return _law(
            mechanism,
            row,
            lambda w, e: -e["Fc"] * sign(w.v[row]),
            {"Fc": 1.0},
            {"Fc": force},
            ("Fc",),
        )
    if mechanism == "asymmetric_friction":
        return _law(
            mechanism,
            row,
            lambda w, e: -e["Fa"] * np.abs(w.v[row]),
            {"Fa": float(rng.choice([-1.0, 1.0]))},
            {"Fa": viscous},
            ("Fa",),
        )
    if mechanism == "stribeck_friction":
        ratio, share = rng.uniform(1.4, 2.2), rng.uniform(0.1, 0.4)

        def stribeck(w: Look, e: E) -> np.ndarray:
            v = w.v[row]
            fall = np.exp(-((np.abs(v) / e["vs"]) ** 2))
            return -(e["Fc"] + (e["Fs"] - e["Fc"]) * fall) * sign(v)

        return _law(
            mechanism,
            row,
            stribeck,
            {"Fc": 1.0, "Fs": ratio, "vs": share * v_rms},
            {"Fc": force, "Fs": force, "vs": times(x, TIME, -1)},
            ("Fc", "Fs"),
        )
    if mechanism == "position_dependent_friction":
        slope = float(rng.choice([-1.0, 1.0])) * rng.uniform(0.4, 0.8) / q_max
        q0 = scene.q0[row]
        return _law(
            mechanism,
            row,
            lambda w, e: -(e["Fc"] + e["g"] * (w.q[row] - q0)) * sign(w.v[row]),
            {"Fc": 1.0, "g": slope},
            {"Fc": force, "g": per(force, x)},
            ("Fc", "g"),
            shape=("g",),
        )
    if mechanism == "quadratic_drag":
        return _law(
            mechanism,
            row,
            lambda w, e: -e["kd"] * w.v[row] * np.abs(w.v[row]),
            {"kd": 1.0},
            {"kd": square},
            ("kd",),
        )
    power = float(rng.choice([rng.uniform(1.35, 1.65), rng.uniform(2.4, 2.8)]))
    rate = times(x, TIME, -1)
    return _law(
        mechanism,
        row,
        lambda w, e: -e["kd"] * sign(w.v[row]) * np.abs(w.v[row]) ** e["p"],
        {"kd": 1.0, "p": power},
        {"kd": times(force, rate, -power), "p": NONE},
        ("kd",),
    )


def elastic(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return a spring in a row, or a dead zone in one of the plant's springs."""
    system = scene.system
    x, force = system.coordinates[row], system.force_dims[row]
    if mechanism == "backlash":
        return _backlash(rng, scene)
    if mechanism in ("piecewise_stiffness", "end_stop"):
        low, high = (0.6, 0.85) if mechanism == "piecewise_stiffness" else (0.93, 0.97)
        side = float(rng.choice([-1.0, 1.0]))
        edge = float(np.quantile(side * scene.q[row], rng.uniform(low, high)))
        return _law(
            mechanism,
            row,
            lambda w, e: -side * e["ks"] * np.maximum(side * w.q[row] - e["qs"], 0.0),
            {"ks": 1.0, "qs": edge},
            {"ks": per(force, x), "qs": x},
            ("ks",),
        )
    power = {"linear_stiffness": 1, "quadratic_stiffness": 2, "cubic_stiffness": 3}[mechanism]
    name = f"k{power}"
    return _law(
        mechanism,
        row,
        lambda w, e: -e[name] * w.q[row] ** power,
        {name: 1.0},
        {name: per(force, x, power)},
        (name,),
    )


def _backlash(rng: np.random.Generator, scene: Scene) -> Effect:
    system = scene.system
    name = str(rng.choice(list(system.springs))) if system.springs else "k1"
    gear = scene.p.get("n1")
    incidence = (1.0 / gear, -1.0) if gear else system.springs[name]
    g = np.array(incidence)[:, None]
    rows = tuple(int(i) for i in np.flatnonzero(g[:, 0]))
    stretch = np.abs((g * scene.q).sum(0))

    def gap(w: Look, e: E) -> np.ndarray:
        elongation = (g * w.q).sum(0)
        # what the spring of the model pulls too much while the gap is open
        return g * w.p[name] * np.clip(elongation, -e["b"], e["b"])

    return Effect(
        "backlash",
        "equation",
        rows[0],
        {"b": 0.01 * float(stretch.max())},
        {"b": system.coordinates[rows[0]]},
        ("b",),
        linear=False,
        force=gap,
        rows=rows,
    )


def inertial(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return an added inertia, a weight, a constant force or a product of velocities."""
    system = scene.system
    x, force = system.coordinates[row], system.force_dims[row]
    if mechanism == "added_mass":
        # of a tank: an area, since its "force" is a flow
        dims = per(force, x, 1, 2) if system.order == 2 else per(force, x, 1, 1)
        return Effect(mechanism, "equation", row, {"ma": 1.0}, {"ma": dims}, ("ma",), inertia="ma")
    if mechanism == "gravity" and row in system.turning:
        return _law(
            mechanism,
            row,
            lambda w, e: -e["mg"] * np.sin(w.q[row]),
            {"mg": 1.0},
            {"mg": force},
            ("mg",),
        )
    if mechanism in ("gravity", "constant_force"):
        name = "mg" if mechanism == "gravity" else "F0"
        return _law(
            mechanism,
            row,
            lambda w, e: e[name] + 0.0 * w.q[row],
            {name: float(rng.choice([-1.0, 1.0]))},
            {name: force},
            (name,),
        )
    other = int(rng.choice([j for j in range(system.size) if j != row]))
    return _law(
        mechanism,
        row,
        lambda w, e: e["h"] * w.v[other] ** 2,
        {"h": float(rng.choice([-1.0, 1.0]))},
        {"h": per(force, system.coordinates[other], 2, 2)},
        ("h",),
    )


def coupling(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return a spring or a damper between two coordinates that the model does not tie."""
    system = scene.system
    other = (row + 2) % 3 if system.size == 3 else 1 - row
    if system.size == 3:
        row, other = 0, 2
    x, force = system.coordinates[row], system.force_dims[row]
    name = "kc" if mechanism == "coupling_stiffness" else "cc"

    def pull(w: Look, e: E) -> np.ndarray:
        motion = w.q if name == "kc" else w.v
        out = on(w, row, -e[name] * (motion[row] - motion[other]))
        out[other] = -out[row]
        return out

    dims = per(force, x) if name == "kc" else per(force, x, 1, 1)
    return Effect(
        mechanism,
        "equation",
        row,
        {name: 1.0},
        {name: dims},
        (name,),
        force=pull,
        rows=(row, other),
    )


def periodic(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return a wave over time or over position."""
    x, force = scene.system.coordinates[row], scene.system.force_dims[row]
    phase = float(rng.uniform(-np.pi, np.pi))
    pace = float(scene.omega * rng.uniform(0.3, 1.5))
    frequency = times(NONE, TIME, -1)
    if mechanism == "harmonic_force":
        return _law(
            mechanism,
            row,
            lambda w, e: e["A"] * np.sin(e["w"] * w.t + e["phi"]) + 0.0 * w.q[row],
            {"A": 1.0, "w": pace, "phi": phase},
            {"A": force, "w": frequency},
            ("A",),
            shape=("phi",),
        )
    if mechanism == "position_ripple":
        waves = float(rng.uniform(2.0, 5.0) * np.pi / scene.q_max(row))
        return _law(
            mechanism,
            row,
            lambda w, e: e["A"] * np.sin(e["n"] * w.q[row] + e["phi"]),
            {"A": 1.0, "n": waves, "phi": phase},
            {"A": force, "n": times(NONE, x, -1)},
            ("A",),
            shape=("phi",),
        )
    return _law(
        mechanism,
        row,
        lambda w, e: -e["kp"] * w.q[row] * np.cos(e["w"] * w.t + e["phi"]),
        {"kp": 1.0, "w": pace, "phi": phase},
        {"kp": per(force, x), "w": frequency},
        ("kp",),
        shape=("phi",),
    )


def unnamed(rng: np.random.Generator, scene: Scene, mechanism: str, row: int) -> Effect:
    """Return a law that no name of the library covers."""
    scale, force = scene.q_max(row), scene.system.force_dims[row]
    q0, v_rms = scene.q0[row], max(scene.v_rms(row), 1e-12)

    def magnet(w: Look, e: E) -> np.ndarray:
        s = (w.q[row] - q0) / (0.4 * scale)
        return -e["A"] * s * np.exp(-(s**2))

    def squeeze(w: Look, e: E) -> np.ndarray:
        s = (w.q[row] - q0) / scale
        return -e["A"] * (w.v[row] / v_rms) * s**2

    def slanted(w: Look, e: E) -> np.ndarray:
        s = (w.q[row] - q0) / scale
        return -e["A"] * (w.v[row] / v_rms) ** 2 * np.tanh(4.0 * s)

    law = (magnet, squeeze, slanted)[int(rng.integers(3))]
    return _law(mechanism, row, law, {"A": 1.0}, {"A": force}, ("A",), shape=("A",))


__all__ = [
    "coupling",
    "dissipative",
    "elastic",
    "inertial",
    "periodic",
    "unnamed",
]
