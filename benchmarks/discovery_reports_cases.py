"""Recordings after public reports on the discovery of laws, for the benchmark discovery_reports.

Every case is a function of a random generator that returns recordings, options of ``discover`` and
the law that made them. Noise is a share of every column's spread.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import jaxsr

Rates = Callable[[float, np.ndarray], Sequence[float]]


@dataclass(frozen=True)
class Case:
    """Recordings, and the law that made them.

    Attributes
    ----------
    recordings : list of Recording
    states : list of str
    law : callable
        Time and states to rates, vectorised.
    terms : list of int
        Terms of each rate, expanded.
    options : dict
        Of ``discover``.
    origin : float
        Time of the recordings' clock at the law's time zero, seconds.
    """

    recordings: list[jaxsr.Recording]
    states: list[str]
    law: Rates
    terms: list[int]
    options: dict[str, Any] = field(default_factory=dict)
    origin: float = 0.0


def record(
    rng: np.random.Generator, law: Rates, start: Sequence[float], t: np.ndarray, share: float
) -> np.ndarray:
    """Return a noisy solution at ``t`` (states, samples), its start moved by a tenth."""
    first = np.asarray(start, float) * (1.0 + 0.1 * rng.normal(size=len(start)))
    y = solve_ivp(law, (t[0], t[-1]), first, t_eval=t, method="LSODA", rtol=1e-9, atol=1e-12).y
    return y + share * np.std(y, axis=1, keepdims=True) * rng.normal(size=y.shape)


def uneven(rng: np.random.Generator, span: float, rows: int) -> np.ndarray:
    """Return instants drawn by chance, from 0 to ``span``."""
    return np.concatenate([[0.0], np.sort(rng.uniform(0.0, span, rows - 2)), [span]])


# ---- laws


def cubic(_: float, x: np.ndarray) -> list[Any]:
    """Oscillator with cubic damping in both states (PySINDy's second example)."""
    return [-0.1 * x[0] ** 3 + 2.0 * x[1] ** 3, -2.0 * x[0] ** 3 - 0.1 * x[1] ** 3]


def hardening(_: float, x: np.ndarray) -> list[Any]:
    """Spring that hardens, with friction; a sine looks alike where it is short."""
    return [x[1], -4.0 * x[0] - 1.5 * x[0] ** 3 - 0.3 * x[1]]


def predators(_: float, x: np.ndarray) -> list[Any]:
    """Lotka and Volterra."""
    return [1.1 * x[0] - 0.4 * x[0] * x[1], 0.1 * x[0] * x[1] - 0.4 * x[1]]


def driven(t: float, x: np.ndarray) -> list[Any]:
    """Pendulum with friction, driven by a torque that nobody recorded."""
    return [x[1], -9.81 * np.sin(x[0]) - 0.2 * x[1] + 1.5 * np.sin(1.3 * t)]


def cells(_: float, x: np.ndarray) -> list[Any]:
    """Chemostat: cells in 1e8 a litre, nutrient in grams a litre."""
    growth = 0.9 * x[0] * x[1]
    return [growth - 0.3 * x[0], 0.6 - 0.3 * x[1] - 4e-9 * growth]


def hydraulics(_: float, x: np.ndarray) -> list[Any]:
    """Piston against oil: pressure in Pa, velocity in m/s."""
    return [-3e8 * x[1] - 0.5 * x[0] + 1e8, 2e-8 * x[0] - 0.8 * x[1] - 1.0]


def repressilator(_: float, x: np.ndarray) -> list[Any]:
    """Three genes in a ring, each repressed with the Hill exponent 10."""
    return [3.0 / (1.0 + x[k - 1] ** 10) - x[k] for k in range(3)]


# ---- kinds


def uneven_cubic(rng: np.random.Generator) -> Case:
    """Instants drawn by chance, 1 % noise."""
    t = uneven(rng, 25.0, 1000)
    return _one(rng, cubic, [2.0, 0.5], t, 0.01, [2, 2])


def uneven_hardening(rng: np.random.Generator) -> Case:
    """Instants drawn by chance, 2 % noise."""
    t = uneven(rng, 20.0, 600)
    return _one(rng, hardening, [1.5, 0.5], t, 0.02, [1, 3])


def short_predators(rng: np.random.Generator) -> Case:
    """A hundred runs of twenty rows, 1 % noise."""
    runs = []
    for k in range(100):
        t = 0.25 * np.arange(20.0)
        x = record(rng, predators, rng.uniform([2.0, 1.0], [12.0, 6.0]).tolist(), t, 0.01)
        runs.append(jaxsr.Recording(f"run{k}", t, {"a": x[0], "b": x[1]}))
    return Case(runs, ["a", "b"], predators, [2, 2])


def short_hardening(rng: np.random.Generator) -> Case:
    """A hundred runs of twenty rows, 1 % noise."""
    runs = []
    for k in range(100):
        t = 0.1 * np.arange(20.0)
        x = record(rng, hardening, rng.uniform(-2.0, 2.0, 2).tolist(), t, 0.01)
        runs.append(jaxsr.Recording(f"run{k}", t, {"a": x[0], "b": x[1]}))
    return Case(runs, ["a", "b"], hardening, [1, 3])


def scales_cells(rng: np.random.Generator) -> Case:
    """1e8 beside 1, 0.5 % noise."""
    t = np.linspace(0.0, 30.0, 800)
    return _one(rng, cells, [2e6, 1.8], t, 0.005, [2, 3])


def scales_hydraulics(rng: np.random.Generator) -> Case:
    """1e8 beside 1, clean."""
    t = np.linspace(0.0, 10.0, 1500)
    return _one(rng, hydraulics, [2e8, 0.5], t, 0.0, [3, 3])


def origin_hardening(rng: np.random.Generator) -> Case:
    """A clock that counts from 1970, 1 % noise, no input."""
    t = np.linspace(0.0, 20.0, 1000)
    return _one(rng, hardening, [1.5, 0.5], t, 0.01, [1, 3], 1.7e9)


def origin_driven(rng: np.random.Generator) -> Case:
    """A clock that is a million seconds on, a drive that nobody recorded, 0.5 % noise."""
    t = np.linspace(0.0, 40.0, 2000)
    return _one(rng, driven, [1.0, 0.3], t, 0.005, [1, 3], 1e6)


def autonomous_predators(rng: np.random.Generator) -> Case:
    """Little more than a period with 5 % noise, no input: time would explain it too."""
    t = np.linspace(0.0, 14.0, 150)
    return _one(rng, predators, [10.0, 5.0], t, 0.05, [2, 2])


def hill(rng: np.random.Generator) -> Case:
    """Rational laws of three states with exponents of 10, 0.1 % noise."""
    t = np.linspace(0.0, 20.0, 1000)
    return _one(rng, repressilator, [1.2, 0.6, 0.9], t, 0.001, [2, 2, 2])


def _one(
    rng: np.random.Generator,
    law: Rates,
    start: Sequence[float],
    t: np.ndarray,
    share: float,
    terms: list[int],
    origin: float = 0.0,
) -> Case:
    x = record(rng, law, start, t, share)
    names = list("abc"[: len(x)])
    channels = dict(zip(names, x, strict=True))
    return Case([jaxsr.Recording("run", origin + t, channels)], names, law, terms, origin=origin)


KINDS: dict[str, Callable[[np.random.Generator], Case]] = {
    "uneven-cubic": uneven_cubic,
    "uneven-hardening": uneven_hardening,
    "short-predators": short_predators,
    "short-hardening": short_hardening,
    "scales-cells": scales_cells,
    "scales-hydraulics": scales_hydraulics,
    "origin-hardening": origin_hardening,
    "origin-driven": origin_driven,
    "autonomous-predators": autonomous_predators,
    "hill": hill,
}
