"""Two systems with inputs, their recordings and exact solutions, for the tests of roll-outs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.discovery.rollout import System, cut
from jaxsr.discovery.rollout.simulate import simulate
from jaxsr.expressions import parse


def system_of(terms: Mapping[str, list[str]], known: Mapping[str, str] | None = None) -> System:
    given = {s: parse(text) for s, text in (known or {}).items()}
    return System({s: tuple(parse(t) for t in texts) for s, texts in terms.items()}, given)


def trace_of(
    t: np.ndarray,
    values: Mapping[str, np.ndarray],
    measured: Mapping[str, np.ndarray] | None = None,
    noise: float = 1.0,
) -> dict[str, dict[str, np.ndarray]]:
    seen = dict(values if measured is None else measured)
    level = {name: np.full(len(t), noise) for name in seen}
    return {"time": {"t": t}, "values": dict(values), "measured": seen, "noise": level}


# A driven pendulum: nonlinear and smooth, with an input and with time in the equation.
PENDULUM = system_of({"q": [], "v": ["sin(1.3*q)", "v**3", "u", "cos(0.7*t)"]}, known={"q": "v"})
TRUE = np.array([-4.0, 1.3, -0.3, 0.8, 0.5, 0.7])


def pendulum(c: np.ndarray, u: Callable[[float], float]) -> Callable:
    def rates(t: float, x: np.ndarray) -> list[float]:
        pull = c[0] * np.sin(c[1] * x[0]) + c[2] * x[1] ** 3
        return [x[1], pull + c[3] * u(t) + c[4] * np.cos(c[5] * t)]

    return rates


def solved(rates: Callable, start: list[float], t: np.ndarray) -> np.ndarray:
    """Solve from sample to sample: an input that is linear between samples has kinks at them."""
    out = [np.array(start)]
    for a, b in itertools.pairwise(t):
        found = solve_ivp(rates, (a, b), out[-1], method="DOP853", rtol=1e-12, atol=1e-13)
        out.append(found.y[:, -1])
    return np.array(out).T


def experiment(seed: int, n: int, noise: float, count: int = 3) -> list[dict]:
    """x' = -a x + b sin(1.7 x + t) + u with a = 0.8, b = 1.4, an input linear between samples."""
    rng = np.random.default_rng([seed, 2])
    t = np.linspace(0.0, 4.0, n)
    traces = []
    for _ in range(count):
        u = np.cos(rng.uniform(0.5, 3.0) * t + rng.uniform(0.0, 6.0))
        x = _fine(t, u, rng.uniform(-1.0, 1.0))
        seen = x + noise * rng.normal(size=n)
        traces.append(trace_of(t, {"x": seen, "u": u}, {"x": seen}, max(noise, 1e-9)))
    return traces


DRIVEN = system_of({"x": ["x", "sin(1.7*x + t)"]}, known={"x": "u"})
DRIVEN_TRUE = np.array([-0.8, 1.4, 1.7])


def _fine(t: np.ndarray, u: np.ndarray, start: float) -> np.ndarray:
    segments = cut([trace_of(t, {"x": u, "u": u})], len(t), 1)
    starts = np.full((1, 1, 1), start)
    rates = DRIVEN.function()
    return simulate(rates, ("x",), "t", segments, DRIVEN_TRUE[None], starts, 16)[:, 0, 0, 0]
