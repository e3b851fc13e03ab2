"""Small plants with something left out, for diagnoses that are ended before their time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.recordings import Recording

SAMPLES, RECORDINGS, SMOOTH = 300, 2, 1e-3
Rates = Callable[[np.ndarray, float], list[float]]


@dataclass(frozen=True)
class Effect:
    """What the truth has and the given model has not.

    Attributes
    ----------
    name : str
    rates : callable
        (state, input) -> rates of the truth.
    causes : frozenset of (mechanism, site)
        What names it, those that count as one with it included; empty where nothing is wrong.
    reading : callable
        Offset of the first reading, (state) -> number.
    """

    name: str
    rates: Rates
    causes: frozenset[tuple[str, str]]
    reading: Callable[[np.ndarray], float] = lambda x: 0.0


@dataclass(frozen=True)
class Plant:
    """A given model, and effects that it leaves out.

    Attributes
    ----------
    model : str
        The given model file.
    seen : tuple of int
        States that are read, in the order of the outputs.
    noise : tuple of float
    start : tuple of float
    drive : tuple of float
        Mean, amplitude and least and largest angular frequency of the input.
    step : float
        Sample interval in s.
    """

    name: str
    model: str
    seen: tuple[int, ...]
    noise: tuple[float, ...]
    start: tuple[float, ...]
    drive: tuple[float, float, float, float]
    step: float
    effects: tuple[Effect, ...]

    def record(self, effect: Effect, seed: int) -> list[Recording]:
        """Simulate under four random sines, with noise on every reading."""
        rng, found = np.random.default_rng([seed, len(self.name)]), []
        mean, size, slow, fast = self.drive
        time = self.step * np.arange(SAMPLES)
        for number in range(RECORDINGS):
            line, phase = rng.uniform(slow, fast, 4), rng.uniform(0.0, 6.28, 4)

            def u(t: float | np.ndarray, line=line, phase=phase) -> np.ndarray:
                waves = np.sin(np.multiply.outer(t, line) + phase).sum(-1)
                return np.asarray(mean + 0.5 * size * waves)

            def rates(t: float, x: np.ndarray, u=u) -> list[float]:
                return effect.rates(x, float(u(t)))

            x = solve_ivp(
                rates,
                (0.0, time[-1]),
                self.start,
                t_eval=time,
                rtol=1e-8,
                atol=1e-10,
                max_step=self.step,
            ).y
            channels = {"u": u(time)}
            for k, (state, noise) in enumerate(zip(self.seen, self.noise, strict=True)):
                y = x[state] + noise * rng.normal(size=SAMPLES)
                if k == 0:
                    y = y + np.array([effect.reading(column) for column in x.T])
                channels[f"y{k + 1}"] = y
            found.append(Recording(f"{self.name}-{number}.csv", time, channels))
        return found


def _cart(extra: Callable[[float, float, float], float], mass: float = 2.0) -> Rates:
    def rates(x: np.ndarray, u: float) -> list[float]:
        q, v = x
        return [v, (u - 1.5 * v - 30.0 * q + extra(q, v, u)) / mass]

    return rates


def _pendulum(extra: Callable[[float, float, float], float], weight: float = 4.0) -> Rates:
    def rates(x: np.ndarray, u: float) -> list[float]:
        q, v = x
        return [v, (u - 0.1 * v - weight * np.sin(q) + extra(q, v, u)) / 0.25]

    return rates


def _motor(extra: Callable[[float, float], float], constant: float = 0.05) -> Rates:
    def rates(x: np.ndarray, u: float) -> list[float]:
        i, w = x
        current = (u - 1.5 * i - constant * w) / 0.02
        return [current, (constant * i - 3e-4 * w + extra(i, w)) / 2e-4]

    return rates


def _tank(extra: Callable[[float, float], float], flow: float = 10.0) -> Rates:
    def rates(x: np.ndarray, u: float) -> list[float]:
        (h,) = x
        return [(flow * u - 15.0 * np.sqrt(max(h, 0.0)) + extra(h, u)) / 150.0]

    return rates


def _one(mechanism: str, *sites: str) -> set[tuple[str, str]]:
    return {(mechanism, site) for site in sites}


NOTHING = frozenset[tuple[str, str]]()
CART = """
[model]
name = "cart"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y1"]
[equations]
q = "v"
v = "u - c*v - k*q"
[inertia]
v = { v = "M" }
[readings]
y1 = "q"
[parameters]
M = { value = 2.0, bounds = [0.5, 8.0] }
c = { value = 1.5, bounds = [0.0, 20.0] }
k = { value = 30.0, bounds = [1.0, 200.0] }
"""
PENDULUM = """
[model]
name = "pendulum"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y1"]
[equations]
q = "v"
v = "(u - b*v - G*sin(q))/J"
[readings]
y1 = "q"
[parameters]
J = { value = 0.25, bounds = [0.05, 1.0] }
b = { value = 0.1, bounds = [0.0, 2.0] }
G = { value = 4.0, bounds = [1.0, 20.0] }
"""
MOTOR = """
[model]
name = "motor"
states = ["i", "w"]
inputs = ["u"]
outputs = ["y1", "y2"]
[equations]
i = "(u - R*i - K*w)/L"
w = "(K*i - B*w)/J"
[readings]
y1 = "w"
y2 = "i"
[parameters]
R = { value = 1.5, bounds = [0.1, 10.0] }
L = { value = 0.02, bounds = [0.001, 0.2] }
K = { value = 0.05, bounds = [0.005, 0.5] }
J = { value = 2e-4, bounds = [1e-5, 1e-2] }
B = { value = 3e-4, bounds = [0.0, 1e-2] }
"""
TANK = """
[model]
name = "tank"
states = ["h"]
inputs = ["u"]
outputs = ["y1"]
[equations]
h = "(kq*u - c*sqrt(Max(h, 0)))/A"
[readings]
y1 = "h"
[parameters]
A = { value = 150.0 }
kq = { value = 10.0, bounds = [1.0, 50.0] }
c = { value = 15.0, bounds = [1.0, 60.0] }
"""


def _coulomb(size: float, v: float) -> float:
    return float(-size * np.tanh(v / SMOOTH))


_SPRING = _one("sensor_bias", "output:y1") | _one("constant_force", "equation:v")
_GAIN = _one("wrong_value", "parameter:kq") | _one("input_gain", "input:u")

PLANTS = (
    Plant(
        "cart",
        CART,
        (0,),
        (2e-4,),
        (0.05, 0.0),
        (0.0, 6.0, 0.8, 8.0),
        0.02,
        (
            Effect(
                "coulomb",
                _cart(lambda q, v, u: _coulomb(1.2, v)),
                frozenset(_one("coulomb_friction", "equation:v")),
            ),
            Effect(
                "cubic",
                _cart(lambda q, v, u: -150.0 * q**3),
                frozenset(_one("cubic_stiffness", "equation:v")),
            ),
            Effect(
                "drag",
                _cart(lambda q, v, u: -2.0 * v * abs(v)),
                frozenset(_one("quadratic_drag", "equation:v")),
            ),
            Effect(
                "mass",
                _cart(lambda q, v, u: 0.0, 2.4),
                frozenset(_one("wrong_value", "parameter:M") | _one("added_mass", "equation:v")),
            ),
            Effect("bias", _cart(lambda q, v, u: 0.0), frozenset(_SPRING), lambda x: 0.01),
            Effect("nothing", _cart(lambda q, v, u: 0.0), NOTHING),
        ),
    ),
    Plant(
        "pendulum",
        PENDULUM,
        (0,),
        (5e-4,),
        (0.4, 0.0),
        (0.0, 2.0, 1.0, 7.0),
        0.02,
        (
            Effect(
                "coulomb",
                _pendulum(lambda q, v, u: _coulomb(0.25, v)),
                frozenset(_one("coulomb_friction", "equation:v")),
            ),
            Effect(
                "constant",
                _pendulum(lambda q, v, u: 0.5),
                frozenset(_one("constant_force", "equation:v")),
            ),
            Effect(
                "spring",
                _pendulum(lambda q, v, u: -1.5 * q),
                frozenset(_one("linear_stiffness", "equation:v")),
            ),
            Effect(
                "saturation",
                _pendulum(lambda q, v, u: float(np.clip(u, -1.0, 1.0)) - u),
                frozenset(_one("input_saturation", "input:u")),
            ),
            Effect(
                "weight",
                _pendulum(lambda q, v, u: 0.0, 5.0),
                frozenset(_one("wrong_value", "parameter:G")),
            ),
        ),
    ),
    Plant(
        "motor",
        MOTOR,
        (1, 0),
        (0.2, 0.01),
        (0.0, 0.0),
        (0.0, 6.0, 1.0, 20.0),
        0.005,
        (
            Effect(
                "coulomb",
                _motor(lambda i, w: float(-0.01 * np.tanh(w / 0.5))),
                frozenset(_one("coulomb_friction", "equation:w")),
            ),
            Effect(
                "constant",
                _motor(lambda i, w: -0.01),
                frozenset(_one("constant_force", "equation:w")),
            ),
            Effect(
                "torque",
                _motor(lambda i, w: 0.0, 0.06),
                frozenset(_one("wrong_value", "parameter:K")),
            ),
            Effect("nothing", _motor(lambda i, w: 0.0), NOTHING),
        ),
    ),
    Plant(
        "tank",
        TANK,
        (0,),
        (0.01,),
        (6.0,),
        (4.0, 1.5, 0.02, 0.2),
        1.0,
        (
            Effect(
                "leak",
                _tank(lambda h, u: -6.0),
                frozenset(_one("constant_force", "equation:h") | _one("input_offset", "input:u")),
            ),
            Effect("flow", _tank(lambda h, u: 0.0, 11.5), frozenset(_GAIN)),
            Effect(
                "bias",
                _tank(lambda h, u: 0.0),
                frozenset(_one("sensor_bias", "output:y1")),
                lambda x: -1.0,
            ),
        ),
    ),
)
