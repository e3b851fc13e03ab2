"""Recordings of one damped pendulum as people have them: what is lost, odd, large or uneven."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.recordings import Recording

Channels = dict[str, np.ndarray]
Change = Callable[[np.random.Generator, np.ndarray, Channels], tuple[np.ndarray, Channels]]


def pendulum(rng: np.random.Generator, rows: int = 300, noise: float = 0.003) -> Recording:
    """Return q'' = -9 sin(q) - 0.3 q' + u, sampled for 12 s."""

    def force(t):
        return 2.0 * np.sin(1.7 * t)

    def rates(t, x):
        return [x[1], -9.0 * np.sin(x[0]) - 0.3 * x[1] + force(t)]

    t = np.linspace(0.0, 12.0, rows)
    start = [1.0 + 0.3 * rng.random(), 0.0]
    q, v = solve_ivp(rates, (0.0, 12.0), start, rtol=1e-9, atol=1e-9, t_eval=t).y
    q, v = (x + noise * np.std(x) * rng.normal(size=rows) for x in (q, v))
    return Recording("pendulum.csv", t, {"q": q, "v": v, "u": force(t)})


def _lost(share: float, columns: tuple[str, ...] = ("q", "v", "u")) -> Change:
    def change(rng, t, channels):
        for name in columns:
            channels[name][rng.random(len(t)) < share] = np.nan
        return t, channels

    return change


def _gap(start: float, stop: float, columns: tuple[str, ...]) -> Change:
    def change(rng, t, channels):
        for name in columns:
            channels[name][int(start * len(t)) : int(stop * len(t))] = np.nan
        return t, channels

    return change


def _every(step: int, columns: tuple[str, ...]) -> Change:
    def change(rng, t, channels):
        for name in columns:
            kept = np.arange(len(t)) % step == 0
            channels[name][~kept] = np.nan
        return t, channels

    return change


def _set(name: str, values: Callable[[np.ndarray, Channels], np.ndarray]) -> Change:
    def change(rng, t, channels):
        return t, channels | {name: np.asarray(values(t, channels), float)}

    return change


def _timed(clock: Callable[[np.random.Generator, np.ndarray], np.ndarray]) -> Change:
    return lambda rng, t, channels: (clock(rng, t), channels)


def _scaled(**factors: float) -> Change:
    def change(rng, t, channels):
        return t, {n: v * factors.get(n, 1.0) for n, v in channels.items()}

    return change


def _first(rows: int) -> Change:
    return lambda rng, t, channels: (t[:rows], {n: v[:rows] for n, v in channels.items()})


def _with_offset(offset: float) -> Change:
    return _timed(lambda rng, t: t + offset)


FORMS: dict[str, Change] = {
    "whole": lambda rng, t, channels: (t, channels),
    "2 % lost": _lost(0.02),
    "10 % lost": _lost(0.1),
    "20 % lost": _lost(0.2),
    "60 % lost": _lost(0.6),
    "20 % of the input lost": _lost(0.2, ("u",)),
    "a long gap": _gap(0.3, 0.55, ("q", "v")),
    "gaps in turn": lambda rng, t, c: _gap(0.5, 1.0, ("v",))(
        rng, *_gap(0.0, 0.5, ("q",))(rng, t, c)
    ),
    "an input that ends early": _gap(0.5, 1.0, ("u",)),
    "every second v": _every(2, ("v",)),
    "every tenth v": _every(10, ("v",)),
    "every tenth q and v": _every(10, ("q", "v")),
    "every 2nd q, every 10th v": lambda rng, t, c: _every(10, ("v",))(
        rng, *_every(2, ("q",))(rng, t, c)
    ),
    "q constant": _set("q", lambda t, c: np.full(len(t), 0.7)),
    "q zero": _set("q", lambda t, c: np.zeros(len(t))),
    "all zero": lambda rng, t, c: (t, {n: np.zeros(len(t)) for n in c}),
    "u zero": _set("u", lambda t, c: np.zeros(len(t))),
    "v equal to q": _set("v", lambda t, c: c["q"].copy()),
    "v equal to u": _set("v", lambda t, c: c["u"].copy()),
    "u equal to v": _set("u", lambda t, c: c["v"].copy()),
    "u is time": _set("u", lambda t, c: t.copy()),
    "v saturated": _set("v", lambda t, c: np.clip(c["v"], -0.5, 0.5)),
    "v coarse": _set("v", lambda t, c: np.round(c["v"], 1)),
    "v of two levels": _set("v", lambda t, c: np.sign(c["v"])),
    "q a ramp": _set("q", lambda t, c: 2.0 * t),
    "q a step": _set("q", lambda t, c: (t > 6.0).astype(float)),
    "spikes": _set("q", lambda t, c: np.where(np.arange(len(t)) % 37 == 5, 50.0, c["q"])),
    "3 rows": _first(3),
    "5 rows": _first(5),
    "20 rows": _first(20),
    "40 rows": _first(40),
    "epoch seconds": _with_offset(1.7e9),
    "minus an hour": _with_offset(-3600.0),
    "jitter": _timed(lambda rng, t: t + 0.3 * (t[1] - t[0]) * rng.uniform(-1, 1, len(t))),
    "a pause": _timed(lambda rng, t: np.where(t > 6.0, t + 100.0, t)),
    "random times": _timed(lambda rng, t: np.sort(rng.uniform(0.0, 12.0, len(t)))),
    "nanoseconds": _timed(lambda rng, t: 1e-9 * t),
    "1e8 beside 1": _scaled(q=1e8),
    "1e-12 beside 1e12": _scaled(q=1e-12, v=1e12),
    "1e150": _scaled(q=1e150),
    "noise alone": lambda rng, t, c: (t, {n: rng.normal(size=len(t)) for n in c}),
    "q far from zero": _set("q", lambda t, c: c["q"] + 1e9),
}


def form(name: str, seed: int = 0, rows: int = 300, noise: float = 0.003) -> Recording:
    """Return a pendulum's recording in one form."""
    rng = np.random.default_rng([seed, sorted(FORMS).index(name)])
    plain = pendulum(rng, rows, noise)
    channels = {n: v.copy() for n, v in plain.channels.items()}
    t, channels = FORMS[name](rng, plain.time.copy(), channels)
    return Recording(f"{name}.csv", t, channels)
