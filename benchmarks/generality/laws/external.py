"""Forces that come with time or along the path, and pushes that no column records."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.generality.law import Law, Motion, Scene, Values


def _wave(rng: np.random.Generator, scene: Scene) -> tuple[float, float]:
    least = 2.0 * np.pi * 3.0 / scene.duration  # three periods in a recording, or more
    return max(least, scene.pace * rng.uniform(0.5, 1.5)), rng.uniform(-np.pi, np.pi)


def _draw_harmonic(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    w, phi = _wave(rng, scene)
    return {"A": 1.0, "w": w, "phi": phi}


def _draw_ripple(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    turns = float(np.ptp(scene.q)) / (2.0 * np.pi)
    return {
        "A": 1.0,
        "n": max(1.0, round(rng.uniform(2.0, 6.0) / turns)),
        "phi": rng.uniform(-np.pi, np.pi),
    }


def _draw_parametric(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    w, phi = _wave(rng, scene)
    return {"kp": 1.0, "w": w, "phi": phi}


def _draw_push(rng: np.random.Generator, scene: Scene) -> dict[str, float]:
    length = rng.uniform(0.06, 0.2) * scene.duration
    return {
        "A": float(rng.choice([-1.0, 1.0])),
        "begin": rng.uniform(0.2, 0.6) * scene.duration,
        "length": length,
        "run": float(rng.integers(scene.runs)),
    }


def _push(m: Motion, c: Values) -> Any:
    """Half a period of a squared sine, in one recording."""
    phase = (m.t - c["begin"]) / c["length"]
    inside = (phase > 0.0) & (phase < 1.0) & (np.asarray(m.run) == c["run"])
    return np.where(inside, c["A"] * np.sin(np.pi * np.clip(phase, 0.0, 1.0)) ** 2, 0.0)


LAWS = (
    Law("harmonic_force", "external", "structure", "force", _draw_harmonic, ("A",),
        lambda m, c: c["A"] * np.sin(c["w"] * m.t + c["phi"]), unchecked=("phi",)),
    Law("position_ripple", "external", "structure", "force", _draw_ripple, ("A",),
        lambda m, c: c["A"] * np.sin(c["n"] * m.q + c["phi"]), unchecked=("phi",),
        needs="turning", where=lambda s: bool(np.ptp(s.q) > 0.6)),
    Law("parametric_excitation", "external", "structure", "force", _draw_parametric, ("kp",),
        lambda m, c: -c["kp"] * m.q * np.cos(c["w"] * m.t + c["phi"]), unchecked=("phi",),
        needs="position", where=lambda s: s.centred),
    Law("transient_force", "external", "external_input", "force", _draw_push, ("A",), _push,
        unchecked=("A", "begin", "length", "run")),
)  # fmt: skip
