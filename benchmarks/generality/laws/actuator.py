"""Actuators that give something else than what was commanded."""

from __future__ import annotations

import numpy as np

from benchmarks.generality.law import Law, Scene, Values


def _about_zero(scene: Scene) -> bool:
    return bool(abs(scene.u.mean()) < 0.5 * scene.u.std())


def _draw_gain(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    return {"g": 0.9}


def _gain_ends(scene: Scene, c: Values) -> tuple[float, float]:
    return 0.55, 0.999


def _limit_ends(scene: Scene, c: Values) -> tuple[float, float]:
    top = float(np.abs(scene.u).max())
    return 0.35 * top, 0.97 * top


def _dead_ends(scene: Scene, c: Values) -> tuple[float, float]:
    top = float(np.abs(scene.u).max())
    return 0.01 * top, 0.5 * top


def _lag_ends(scene: Scene, c: Values) -> tuple[float, float]:
    return 0.5 * scene.dt, 30.0 * scene.dt


LAWS = (
    Law("input_gain", "actuator", "parameter", "drive", _draw_gain, ("g",),
        lambda m, c: c["g"] * m.u, _gain_ends),
    Law("input_saturation", "actuator", "structure", "drive", lambda rng, s: {"us": 1.0}, ("us",),
        lambda m, c: np.clip(m.u, -c["us"], c["us"]), _limit_ends),
    Law("input_deadzone", "actuator", "structure", "drive", lambda rng, s: {"ud": 1.0}, ("ud",),
        lambda m, c: m.u - np.clip(m.u, -c["ud"], c["ud"]), _dead_ends, where=_about_zero),
    Law("actuator_lag", "actuator", "structure", "drive", lambda rng, s: {"tau": 1.0}, ("tau",),
        lambda m, c: m.z[0], _lag_ends, states=1,
        rates=lambda m, c: [(m.u - m.z[0]) / c["tau"]], begin=lambda m, c: [m.u]),
    Law("input_delay", "actuator", "measurement", "late_drive", lambda rng, s: {"tau": 1.0},
        ("tau",), lambda m, c: m.t - c["tau"],
        lambda s, c: (0.3 * s.dt, 12.0 * s.dt)),
)  # fmt: skip
