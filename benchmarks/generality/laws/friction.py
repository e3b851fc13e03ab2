"""Dry friction."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.law import Law, Motion, Scene, Values


def _reverses(scene: Scene) -> bool:
    return bool(min(np.mean(scene.v > 0.0), np.mean(scene.v < 0.0)) > 0.1)


def _coulomb(m: Motion, c: Values) -> Any:
    return -c["Fc"] * m.sign


def _asymmetric(m: Motion, c: Values) -> Any:
    return -c["Fa"] * m.v * m.sign


def _stribeck(m: Motion, c: Values) -> Any:
    peak = (c["Fs"] - c["Fc"]) * np.exp(-((m.v / c["vs"]) ** 2))
    return -(c["Fc"] + peak) * m.sign


def _draw_stribeck(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    typical = float(np.sqrt(np.mean(scene.v**2)))
    return {"Fc": 1.0, "Fs": rng.uniform(1.6, 2.4), "vs": typical * rng.uniform(0.15, 0.35)}


LAWS = (
    Law("coulomb_friction", "friction", "structure", "force", lambda rng, s: {"Fc": 1.0}, ("Fc",),
        _coulomb, where=_reverses),
    Law("asymmetric_friction", "friction", "structure", "force", lambda rng, s: {"Fa": 1.0},
        ("Fa",), _asymmetric, where=_reverses),
    Law("stribeck_friction", "friction", "structure", "force", _draw_stribeck, ("Fc", "Fs"),
        _stribeck, where=_reverses,
        # with either exponent of the peak, which no parameter tells
        unchecked=("Fs", "vs")),
)  # fmt: skip
