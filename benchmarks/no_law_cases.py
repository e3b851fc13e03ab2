"""Recordings that hold no law that could be found, and some that do, for the benchmark no_law.

Every case is a function of a random generator that returns recordings and options of ``discover``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import jaxsr

Rates = Callable[[float, np.ndarray], Sequence[float]]


@dataclass(frozen=True)
class Case:
    """Recordings, the columns that are states, and further options of ``discover``."""

    recordings: list[jaxsr.Recording]
    states: list[str]
    options: dict[str, Any] = field(default_factory=dict)


def table(t: np.ndarray, columns: np.ndarray, name: str = "run", **options: Any) -> Case:
    """Return a case of one recording; columns (samples, states) are named a, b, c."""
    names = list("abcdefgh"[: columns.shape[1]])
    channels = dict(zip(names, columns.T, strict=True))
    return Case([jaxsr.Recording(name, t, channels)], names, options)


def solved(rates: Rates, start: Sequence[float], t: np.ndarray) -> np.ndarray:
    """Return the solution at ``t`` (samples, states)."""
    with np.errstate(all="ignore"):
        out = solve_ivp(rates, (t[0], t[-1]), start, t_eval=t, rtol=1e-9, atol=1e-10)
    return out.y.T


def noisy(rng: np.random.Generator, x: np.ndarray, share: float) -> np.ndarray:
    """Add noise of a share of every column's spread."""
    return x + share * np.std(x, axis=0) * rng.normal(size=x.shape)


# ---- systems


def lorenz(_: float, x: np.ndarray) -> list[float]:
    """Lorenz 1963."""
    return [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]]


def rossler(_: float, x: np.ndarray) -> list[float]:
    """Roessler 1976."""
    return [-x[1] - x[2], x[0] + 0.2 * x[1], 0.2 + x[2] * (x[0] - 5.7)]


def pendulum(_: float, x: np.ndarray) -> list[float]:
    """Pendulum with viscous friction."""
    return [x[1], -9.81 * np.sin(x[0]) - 0.3 * x[1]]


def predators(_: float, x: np.ndarray) -> list[float]:
    """Lotka and Volterra."""
    return [x[0] * (1.0 - 0.5 * x[1]), x[1] * (0.4 * x[0] - 0.8)]


def van_der_pol(_: float, x: np.ndarray) -> list[float]:
    """Relaxation oscillator."""
    return [x[1], 3.0 * (1 - x[0] ** 2) * x[1] - x[0]]


def chaotic_duffing(t: float, x: np.ndarray) -> list[float]:
    """Duffing's oscillator, driven into chaos."""
    return [x[1], x[0] - x[0] ** 3 - 0.3 * x[1] + 0.5 * np.cos(1.2 * t)]


def double_well_chain(t: float, x: np.ndarray) -> list[float]:
    """Two coupled double wells, driven."""
    a = x[0] - x[0] ** 3 - 0.2 * x[1] + 0.6 * (x[2] - x[0]) + 0.45 * np.sin(1.1 * t)
    return [x[1], a, x[3], x[2] - x[2] ** 3 - 0.2 * x[3] + 0.6 * (x[0] - x[2])]


def steps(rng: np.random.Generator, end: float, hold: float) -> Callable[[float], float]:
    """Return a signal that is held at levels drawn by chance."""
    levels = rng.normal(size=int(end / hold) + 2)
    return lambda t: float(levels[int(max(t, 0.0) / hold)])


def smooth_input(rng: np.random.Generator, end: float, step: float) -> Callable[[float], float]:
    """Return a signal drawn by chance, a line between instants ``step`` apart."""
    t = np.arange(0.0, end + 2 * step, step)
    values = lfilter([1.0], [1.0, -0.7], rng.normal(size=len(t)))
    return lambda s: float(np.interp(s, t, values))


# ---- no law: chance


def walk(rng: np.random.Generator, rows: int, count: int, start: float = 0.0) -> Case:
    """Random walks."""
    x = 20.0 + np.cumsum(rng.normal(size=(rows, count)), axis=0)
    return table(start + np.arange(float(rows)), np.round(x, 3))


def heavy_walk(rng: np.random.Generator) -> Case:
    """A random walk with heavy tails."""
    return table(0.1 * np.arange(400.0), np.cumsum(rng.standard_t(3, size=(400, 1)), axis=0))


def price(rng: np.random.Generator) -> Case:
    """A geometric random walk with a trend."""
    return table(np.arange(500.0), np.exp(np.cumsum(0.002 + 0.02 * rng.normal(size=(500, 1)), 0)))


def reverting(rng: np.random.Generator) -> Case:
    """Chance that forgets: two autoregressive sequences."""
    return table(
        0.05 * np.arange(600.0), lfilter([1.0], [1.0, -0.95], rng.normal(size=(600, 2)), 0)
    )


def white(rng: np.random.Generator) -> Case:
    """White noise."""
    return table(0.01 * np.arange(300.0), rng.normal(size=(300, 2)))


def pink(rng: np.random.Generator) -> Case:
    """Flicker noise."""
    spectrum = np.fft.rfft(rng.normal(size=(512, 2)), axis=0)
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))[:, None]
    return table(0.02 * np.arange(512.0), np.fft.irfft(spectrum, 512, axis=0))


def smooth_chance(rng: np.random.Generator) -> Case:
    """Chance, smooth: filtered so often that it can be differentiated."""
    x = rng.normal(size=(900, 2))
    for _ in range(4):
        x = lfilter([0.1], [1.0, -0.9], x, axis=0)
    return table(0.02 * np.arange(800.0), x[100:])


def counts(rng: np.random.Generator) -> Case:
    """A counter of rare events, less its mean."""
    x = np.cumsum(rng.poisson(0.3, size=(300, 1)) - 0.3, axis=0)
    return table(np.arange(300.0), x)


# ---- no law: aliased


def aliased(
    rng: np.random.Generator, rates: Rates, start: Sequence[float], step: float, rows: int
) -> Case:
    """A motion sampled too seldom."""
    t = step * np.arange(float(rows))
    first = np.asarray(start, float) * (1.0 + 0.1 * rng.normal(size=len(start)))
    return table(t, solved(rates, first, t))


def chirp(rng: np.random.Generator) -> Case:
    """A sweep that runs far beyond half of the sampling rate."""
    t = np.arange(0.0, 20.0, 0.05)
    phase = 2 * np.pi * (5.0 * t + 1.7 * t**2) + rng.uniform(0, 6)
    return table(t, np.column_stack([np.sin(phase), np.cos(phase + 0.3)]))


def henon(rng: np.random.Generator) -> Case:
    """A chaotic map: between its samples nothing moves."""
    x = [np.array([0.1, 0.1]) + 0.05 * rng.normal(size=2)]
    for _ in range(300):
        x.append(np.array([1 - 1.4 * x[-1][0] ** 2 + x[-1][1], 0.3 * x[-1][0]]))
    return table(0.1 * np.arange(301.0), np.array(x))


# ---- no law: too few rows


def few(
    rng: np.random.Generator,
    rates: Rates,
    start: Sequence[float],
    span: float,
    rows: int,
    share: float,
) -> Case:
    """A handful of noisy rows."""
    t = np.linspace(0.0, span, rows)
    first = np.asarray(start, float) * (1.0 + 0.1 * rng.normal(size=len(start)))
    return table(t, noisy(rng, solved(rates, first, t), share))


# ---- no law: what drives is not recorded


def motor(rng: np.random.Generator) -> Case:
    """A motor's speed and current under voltages that no column records."""
    u, t = steps(rng, 20.0, 0.7), np.arange(0.0, 20.0, 0.02)
    x = solved(
        lambda s, x: [4 * x[1] - 0.5 * x[0], (12 * u(s) - 2 * x[1] - 0.8 * x[0]) / 0.4], [0, 0], t
    )
    return table(t, noisy(rng, x, 0.005))


def shaken(rng: np.random.Generator) -> Case:
    """An oscillator on a base that moves by chance."""
    u, t = smooth_input(rng, 40.0, 0.4), np.arange(0.0, 40.0, 0.05)
    return table(t, solved(lambda s, x: [x[1], -9 * x[0] - 0.8 * x[1] + 6 * u(s)], [0, 0], t))


def tanks(rng: np.random.Generator) -> Case:
    """Two tanks with an inflow that no column records."""
    u, t = steps(rng, 400.0, 15.0), np.arange(0.0, 400.0, 0.5)

    def f(s: float, h: np.ndarray) -> list[float]:
        q = 0.5 * np.sqrt(max(h[0], 0.0))
        return [0.5 + 0.4 * abs(u(s)) - q, q - 0.4 * np.sqrt(max(h[1], 0.0))]

    return table(t, noisy(rng, solved(f, [1.0, 1.5], t), 0.003))


def arm(rng: np.random.Generator) -> Case:
    """An arm's angle, moved by torques that no column records."""
    u, t = smooth_input(rng, 30.0, 0.5), np.arange(0.0, 30.0, 0.02)
    x = solved(lambda s, x: [x[1], -4 * np.sin(x[0]) - 1.5 * x[1] + 5 * u(s)], [0.1, 0.0], t)
    return table(t, x)


def heated(rng: np.random.Generator) -> Case:
    """A room that is heated by a thermostat's unrecorded program."""
    u, t = steps(rng, 100.0, 4.0), np.arange(0.0, 100.0, 0.25)
    x = solved(
        lambda s, x: [0.4 * (x[1] - x[0]) - 0.2 * x[0], 0.6 * (x[0] - x[1]) + 3 * u(s)], [0, 0], t
    )
    return table(t, noisy(rng, x, 0.01))


def driven_duffing(rng: np.random.Generator) -> Case:
    """A hardening spring under an unrecorded force."""
    u, t = smooth_input(rng, 60.0, 0.8), np.arange(0.0, 60.0, 0.05)
    x = solved(lambda s, x: [x[1], -x[0] - x[0] ** 3 - 0.4 * x[1] + 3 * u(s)], [0.3, 0.0], t)
    return table(t, noisy(rng, x, 0.002))


def vehicle(rng: np.random.Generator) -> Case:
    """A vehicle's speed on hills that nobody mapped."""
    u, t = smooth_input(rng, 200.0, 6.0), np.arange(0.0, 200.0, 0.4)
    x = solved(lambda s, x: [1.0 - 0.05 * x[0] + 0.8 * u(s)], [10.0], t)
    return table(t, noisy(rng, x, 0.005))


NO_LAW: dict[str, Callable[[np.random.Generator], Case]] = {
    "walk-21": lambda r: walk(r, 21, 2),
    "walk-21-from-1900": lambda r: walk(r, 21, 2, 1900.0),
    "walk-60": lambda r: walk(r, 60, 2),
    "walk-250": lambda r: walk(r, 250, 1),
    "walk-1000": lambda r: walk(r, 1000, 2),
    "walk-heavy": heavy_walk,
    "walk-price": price,
    "chance-reverting": reverting,
    "chance-white": white,
    "chance-pink": pink,
    "chance-smooth": smooth_chance,
    "chance-counts": counts,
    "aliased-lorenz-20": lambda r: aliased(r, lorenz, [1, 2, 20], 0.5, 20),
    "aliased-lorenz-200": lambda r: aliased(r, lorenz, [1, 2, 20], 0.4, 200),
    "aliased-lorenz-slow": lambda r: aliased(r, lorenz, [-3, 2, 15], 1.0, 100),
    "aliased-rossler": lambda r: aliased(r, rossler, [1, 1, 1], 2.5, 200),
    "aliased-duffing": lambda r: aliased(r, chaotic_duffing, [0.5, 0], 2.0, 150),
    "aliased-relaxation": lambda r: aliased(r, van_der_pol, [2, 0], 3.1, 60),
    "aliased-wells": lambda r: aliased(r, double_well_chain, [1, 0, -1, 0], 2.3, 120),
    "aliased-chirp": chirp,
    "aliased-map": henon,
    "few-pendulum-10": lambda r: few(r, pendulum, [1.2, 0], 3.0, 10, 0.05),
    "few-pendulum-14": lambda r: few(r, pendulum, [2.0, 0], 5.0, 14, 0.1),
    "few-predators-8": lambda r: few(r, predators, [3, 1], 9.0, 8, 0.05),
    "few-predators-12": lambda r: few(r, predators, [4, 2], 12.0, 12, 0.1),
    "few-lorenz-12": lambda r: few(r, lorenz, [1, 2, 20], 1.5, 12, 0.02),
    "few-lorenz-20": lambda r: few(r, lorenz, [-4, 2, 18], 4.0, 20, 0.05),
    "few-rossler-15": lambda r: few(r, rossler, [1, 4, 0.5], 20.0, 15, 0.05),
    "few-relaxation-12": lambda r: few(r, van_der_pol, [2, 0], 9.0, 12, 0.05),
    "few-duffing-16": lambda r: few(r, chaotic_duffing, [0.5, 0.2], 14.0, 16, 0.1),
    "input-motor": motor,
    "input-motor-2": motor,
    "input-shaken": shaken,
    "input-shaken-2": shaken,
    "input-tanks": tanks,
    "input-arm": arm,
    "input-heated": heated,
    "input-duffing": driven_duffing,
    "input-duffing-2": driven_duffing,
    "input-vehicle": vehicle,
}
"""Forty recordings that hold no law; those whose kind was not developed on: ``UNSEEN``."""

UNSEEN = (
    *("walk-price", "chance-pink", "chance-smooth", "chance-counts", "aliased-wells"),
    *("aliased-chirp", "aliased-map", "few-rossler-15", "few-relaxation-12", "input-tanks"),
    *("input-heated", "input-vehicle", "input-duffing", "input-duffing-2"),
)


# ---- laws


def law(
    rates: Rates, start: Sequence[float], span: float, rows: int, share: float, **options: Any
) -> Callable[[np.random.Generator], Case]:
    """Return a case of a system that is wholly recorded, with modest noise."""

    def make(rng: np.random.Generator) -> Case:
        t = np.linspace(0.0, span, rows)
        return table(t, noisy(rng, solved(rates, start, t), share), **options)

    return make


def driven(rng: np.random.Generator) -> Case:
    """The shaken oscillator, its input recorded, in two recordings."""
    runs = []
    for name in ("one", "two"):
        t = np.arange(0.0, 20.0, 0.05)
        u = np.interp(t, np.arange(0.0, 20.1, 0.5), rng.normal(size=41))
        x = solved(
            lambda s, x, t=t, u=u: [x[1], -9 * x[0] - 0.8 * x[1] + 6 * np.interp(s, t, u)],
            [0, 0],
            t,
        )
        x = noisy(rng, x, 0.01)
        runs.append(jaxsr.Recording(name, t, {"a": x[:, 0], "b": x[:, 1], "u": u}))
    return Case(runs, ["a", "b"], {"inputs": ["u"]})


def chaos(rng: np.random.Generator) -> Case:
    """Duffing's oscillator in chaos, its input recorded."""
    t = np.linspace(0.0, 60.0, 1500)
    x = noisy(rng, solved(chaotic_duffing, [0.5, 0.0], t), 0.005)
    channels = {"a": x[:, 0], "b": x[:, 1], "u": 0.5 * np.cos(1.2 * t)}
    return Case([jaxsr.Recording("run", t, channels)], ["a", "b"], {"inputs": ["u"]})


def displacement(rng: np.random.Generator) -> Case:
    """A pendulum's angle alone."""
    t = np.arange(0.0, 12.0, 0.02)
    x = solved(pendulum, [1.5, 0.0], t)[:, :1]
    return table(t, x + 1e-3 * rng.normal(size=x.shape), order=2)


AUTONOMOUS = {"autonomous": True}
LAWS: dict[str, Callable[[np.random.Generator], Case]] = {
    "law-pendulum": law(pendulum, [1.5, 0.0], 12.0, 600, 0.01),
    "law-pendulum-noise": law(pendulum, [2.0, 0.0], 12.0, 600, 0.05, **AUTONOMOUS),
    "law-predators": law(predators, [3.0, 1.0], 20.0, 300, 0.02, **AUTONOMOUS),
    "law-lorenz": law(lorenz, [1, 2, 20], 10.0, 1000, 0.005, **AUTONOMOUS),
    "law-rossler": law(rossler, [1, 4, 0.5], 60.0, 1200, 0.005, **AUTONOMOUS),
    "law-relaxation": law(van_der_pol, [2.0, 0.0], 20.0, 600, 0.01, **AUTONOMOUS),
    "law-decay": law(lambda _, x: [-0.7 * x[0]], [3.0], 6.0, 100, 0.02),
    "law-logistic": law(lambda _, x: [x[0] * (1 - x[0] / 4)], [0.1], 10.0, 200, 0.03),
    "law-chaos": chaos,
    "law-driven": driven,
    "law-displacement": displacement,
}
"""Recordings that hold a law, with modest noise: what must not be lost."""
