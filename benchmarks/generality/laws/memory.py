"""Forces that remember: hysteresis, hidden resonators, drifts."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.law import Law, Motion, Scene, Values


def _draw_loop(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    yield_at = rng.uniform(0.25, 0.6) * float(scene.q.std())
    b = rng.uniform(0.5, 0.8) / yield_at
    return {"kz": 1.0, "a": 1.0, "b": b, "g": 1.0 / yield_at - b}


def _loop(m: Motion, c: Values) -> Any:
    """Wen, J. Eng. Mech. Div. ASCE 102 (1976), exponent 1."""
    z = m.z[0]
    return [c["a"] * m.v - c["b"] * np.abs(m.v) * z - c["g"] * m.v * np.abs(z)]


def _draw_resonator(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    return {"mh": 1.0, "wh": scene.pace * rng.uniform(0.8, 1.6), "zh": rng.uniform(0.02, 0.08)}


def _pull(m: Motion, c: Values) -> Any:
    return c["wh"] ** 2 * (m.q - m.z[0]) + 2.0 * c["zh"] * c["wh"] * (m.v - m.z[1])


def _draw_drift(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    return {"kt": float(rng.choice([-1.0, 1.0]))}


LAWS = (
    Law("hysteresis", "memory", "structure", "force", _draw_loop, ("kz",),
        lambda m, c: -c["kz"] * m.z[0], states=1, rates=_loop, unchecked=("kz", "a", "b", "g"),
        needs="position", where=lambda s: bool(min(np.mean(s.v > 0), np.mean(s.v < 0)) > 0.1)),
    Law("hidden_mode", "memory", "structure", "force", _draw_resonator, ("mh",),
        lambda m, c: -c["mh"] * _pull(m, c), states=2,
        rates=lambda m, c: [m.z[1], _pull(m, c)], begin=lambda m, c: [m.q, m.v],
        unchecked=("mh", "wh", "zh"), needs="position"),
    Law("drift", "memory", "structure", "force", _draw_drift, ("kt",),
        lambda m, c: c["kt"] * m.t + 0.0 * m.v, unchecked=("kt",)),
)  # fmt: skip
