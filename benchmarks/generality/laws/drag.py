"""Viscous and aerodynamic resistance."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.law import Law, Motion, Scene, Values


def _power(m: Motion, c: Values) -> Any:
    return -c["kd"] * np.sign(m.v) * np.abs(m.v) ** c["p"]


def _draw_power(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    return {"kd": 1.0, "p": float(rng.choice([1.5, 2.6, 3.0]))}


LAWS = (
    Law("viscous_damping", "drag", "structure", "force", lambda rng, s: {"Fv": 1.0}, ("Fv",),
        lambda m, c: -c["Fv"] * m.v),
    Law("quadratic_drag", "drag", "structure", "force", lambda rng, s: {"kd": 1.0}, ("kd",),
        lambda m, c: -c["kd"] * m.v * np.abs(m.v)),
    Law("power_law_drag", "drag", "structure", "force", _draw_power, ("kd",), _power),
)  # fmt: skip
