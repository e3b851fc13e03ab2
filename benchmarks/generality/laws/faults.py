"""Sensors that read something else than what is there, or at another time."""

from __future__ import annotations

import numpy as np

from benchmarks.generality.law import Law, Scene, Values


def _gain_ends(scene: Scene, c: Values) -> tuple[float, float]:
    return 0.55, 0.999


def _clip_ends(scene: Scene, c: Values) -> tuple[float, float]:
    top = float(np.abs(scene.y).max())
    return 0.4 * top, 0.98 * top


LAWS = (
    # the size of a gain counts on the whole reading, as that of a bias does
    Law("sensor_gain", "faults", "measurement", "reading", lambda rng, s: {"g": 0.9}, ("g",),
        lambda m, c: c["g"] * m.q, _gain_ends),
    Law("sensor_bias", "faults", "measurement", "reading",
        lambda rng, s: {"y0": float(rng.choice([-1.0, 1.0]))}, ("y0",),
        lambda m, c: m.q + c["y0"]),
    Law("clipping", "faults", "measurement", "reading", lambda rng, s: {"ymax": 1.0}, ("ymax",),
        lambda m, c: np.clip(m.q, -c["ymax"], c["ymax"]), _clip_ends,
        where=lambda s: bool(abs(s.y.mean()) < 0.5 * s.y.std())),
    Law("sensor_delay", "faults", "measurement", "instants", lambda rng, s: {"tau": 1.0},
        ("tau",), lambda m, c: m.t - c["tau"], lambda s, c: (0.3 * s.dt, 12.0 * s.dt)),
    Law("clock_skew", "faults", "measurement", "instants", lambda rng, s: {"s": 1.0}, ("s",),
        lambda m, c: (1.0 + c["s"]) * m.t,
        lambda s, c: (0.3 * s.dt / s.duration, 12.0 * s.dt / s.duration)),
)  # fmt: skip
