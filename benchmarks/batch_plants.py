"""Many small machines: masses on springs, each with one hidden law and constants of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

MODEL = """
[model]
name = "mass on a spring"
states = ["q", "v"]
inputs = ["force"]
outputs = ["q_meas"]
[equations]
q = "v"
v = "force - k*q - d*v"
[inertia]
v = { v = "M" }
[readings]
q_meas = "q"
[parameters]
M = { value = 1.0, unit = "kg", bounds = [0.5, 2.0] }
k = { value = 20.0, unit = "N/m", bounds = [5.0, 60.0] }
d = { value = 0.4, unit = "N*s/m", bounds = [0.0, 3.0] }
"""
SAMPLES, INTERVAL, NOISE = 300, 0.02, 2e-4
_SHARP = 1e-3  # m/s over which dry friction turns, for the solver

LAWS = {
    "cubic": lambda c, q, v: -400.0 * c * q**3,
    "drag": lambda c, q, v: -2.0 * c * v * abs(v),
    "friction": lambda c, q, v: -0.4 * c * np.tanh(v / _SHARP),
    "constant": lambda c, q, v: 0.5 * c,
    "nothing": lambda c, q, v: 0.0,
}
"""Hidden forces of a strength near one, displacement and speed, in N."""


def write_cases(folder: Path, count: int, seed: int, budget: float) -> None:
    """Write so many recordings, their model and ``cases.toml``, unless they are there."""
    if (folder / "cases.toml").exists():
        return
    (folder / "plant.toml").write_text(MODEL, encoding="utf-8")
    lines = ["[defaults]", 'model = "plant.toml"', f"budget = {budget}"]
    for k in range(count):
        law = list(LAWS)[k % len(LAWS)]
        name = f"{law}_{k:03d}"
        _record(folder / f"{name}.csv", law, np.random.default_rng([seed, k]))
        lines += [f"[cases.{name}]", f'data = "{name}.csv"']
    (folder / "cases.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _record(path: Path, law: str, rng: np.random.Generator) -> None:
    """Write a machine's answer to a sum of sines, with the noise of its sensor."""
    mass, stiff, damp = np.array([1.0, 20.0, 0.4]) * rng.uniform(0.9, 1.1, 3)
    strength = rng.uniform(0.7, 1.3)
    waves = np.array([0.3, 0.7, 1.3]) * rng.uniform(0.9, 1.1, 3)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    t = np.arange(SAMPLES) * INTERVAL
    forces = 1.5 * np.sum(np.sin(2.0 * np.pi * np.outer(t, waves) + phases), axis=1)

    def rate(time: float, x: np.ndarray) -> list[float]:
        q, v = x
        force = np.interp(time, t, forces) + LAWS[law](strength, q, v)
        return [v, (force - stiff * q - damp * v) / mass]

    run = solve_ivp(
        rate, (0.0, t[-1]), [0.0, 0.0], "LSODA", t, rtol=1e-8, atol=1e-10, max_step=INTERVAL
    )
    q = run.y[0] + NOISE * rng.standard_normal(SAMPLES)
    rows = "\n".join(f"{a:.2f},{b:.9g},{c:.9g}" for a, b, c in zip(t, forces, q, strict=True))
    path.write_text(f"t,force,q_meas\n{rows}\n", encoding="utf-8")
