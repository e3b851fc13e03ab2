"""Springs, hardening, stops and play."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.law import Law, Motion, Scene, Values


def _centred(scene: Scene) -> bool:
    return scene.centred


def _draw_piecewise(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    low, high = float(np.quantile(scene.q, 0.5)), float(scene.q.max())
    return {"ks": 1.0, "qs": low + rng.uniform(0.25, 0.6) * (high - low)}


def _draw_stop(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    low, high = float(np.quantile(scene.q, 0.5)), float(scene.q.max())
    return {"ks": 1.0, "qs": low + rng.uniform(0.7, 0.85) * (high - low)}


def _draw_play(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    return {"kb": 1.0, "b": rng.uniform(0.15, 0.4) * float(np.abs(scene.q).max())}


def _piecewise(m: Motion, c: Values) -> Any:
    return -c["ks"] * np.maximum(m.q - c["qs"], 0.0)


def _play(m: Motion, c: Values) -> Any:
    return -c["kb"] * (m.q - np.clip(m.q, -c["b"], c["b"]))


LAWS = (
    Law("linear_stiffness", "elastic", "structure", "force", lambda rng, s: {"k1": 1.0}, ("k1",),
        lambda m, c: -c["k1"] * m.q, needs="position", where=_centred),
    Law("quadratic_stiffness", "elastic", "structure", "force", lambda rng, s: {"k2": 1.0},
        ("k2",), lambda m, c: -c["k2"] * m.q**2, needs="position", where=_centred),
    Law("cubic_stiffness", "elastic", "structure", "force", lambda rng, s: {"k3": 1.0}, ("k3",),
        lambda m, c: -c["k3"] * m.q**3, needs="position", where=_centred),
    Law("piecewise_stiffness", "elastic", "structure", "force", _draw_piecewise, ("ks",),
        _piecewise, needs="position"),
    Law("end_stop", "elastic", "structure", "force", _draw_stop, ("ks",), _piecewise,
        needs="position"),
    Law("backlash", "elastic", "structure", "force", _draw_play, ("kb",), _play,
        needs="position", where=_centred),
)  # fmt: skip
