"""Plants whose memory is not at rest when the recordings begin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.models import Model, parse_model
from jaxsr.recordings import Recording

SAMPLES = 300

MASS = parse_model(
    """
[model]
name = "mass on a spring"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "(u - k*q - c*v)/m"
[readings]
y = "q"
[parameters]
m = { value = 2.0 }
k = { value = 30.0, bounds = [5.0, 150.0] }
c = { value = 2.0, bounds = [0.2, 20.0] }
"""
)
BODY = parse_model(
    """
[model]
name = "heated body"
states = ["T"]
inputs = ["P", "Ta"]
outputs = ["y"]
[equations]
T = "(P - k*(T - Ta))/C"
[readings]
y = "T"
[parameters]
k = { value = 1.5, bounds = [0.3, 6.0] }
C = { value = 120.0, bounds = [30.0, 500.0] }
"""
)


@dataclass(frozen=True)
class Plant:
    """A model with a memory, and how it moves.

    Attributes
    ----------
    field : callable
        Rates of all states, the memory's last, by these and the inputs.
    known : int
        States of the model.
    begins : tuple of float
        Mean and spread of the memory's states at the first sample.
    """

    model: Model
    mechanism: str
    site: str
    constants: dict[str, float]
    field: Callable[[np.ndarray, np.ndarray], list[float]]
    step: float
    begins: tuple[tuple[float, float], ...]
    noise: float

    def recordings(self, seed: int, number: int = 2) -> list[Recording]:
        """Drive the plant by steps and waves, from another start in every recording."""
        rng = np.random.default_rng(seed)
        return [self._record(rng, f"run{k}.csv") for k in range(number)]

    def _record(self, rng: np.random.Generator, name: str) -> Recording:
        time = np.arange(SAMPLES) * self.step
        inputs = self._inputs(rng, time)
        known = [0.1 * rng.standard_normal(), 0.0] if self.model is MASS else [45.0]
        memory = [mean + spread * rng.standard_normal() for mean, spread in self.begins]

        def rates(t: float, x: np.ndarray) -> list[float]:
            return self.field(x, np.array([np.interp(t, time, u) for u in inputs]))

        run = solve_ivp(
            rates,
            (0.0, time[-1]),
            [*known, *memory],
            t_eval=time,
            max_step=self.step,
            rtol=1e-8,
            atol=1e-10,
        )
        y = run.y[0] + self.noise * np.std(run.y[0]) * rng.standard_normal(SAMPLES)
        return Recording(name, time, {**dict(zip(self.model.inputs, inputs, strict=True)), "y": y})

    def _inputs(self, rng: np.random.Generator, time: np.ndarray) -> list[np.ndarray]:
        span = time[-1]
        rates = 2.0 * np.pi * rng.uniform((1.0, 3.0, 6.0, 10.0), (2.0, 5.0, 9.0, 16.0)) / span
        wave = np.sin(rates * time[:, None] + rng.uniform(0.0, 6.0, 4)).sum(1)
        if self.model is MASS:
            return [6.0 * wave]
        slow = np.sin(2.0 * np.pi * 1.3 * time / span + rng.uniform(0.0, 6.0))
        return [50.0 + 12.0 * wave, 20.0 + slow]


def _mode(x: np.ndarray, u: np.ndarray) -> list[float]:
    q, v, qh, vh = x
    pull = 7.0**2 * (q - qh) + 2.0 * 0.03 * 7.0 * (v - vh)
    return [v, (u[0] - 33.0 * q - 2.0 * v - 0.15 * pull) / 2.0, vh, pull]


def _loop(x: np.ndarray, u: np.ndarray) -> list[float]:
    q, v, z = x
    rate = v - 4.0 * abs(v) * z - 2.0 * v * abs(z)
    return [v, (u[0] - 33.0 * q - 2.0 * v - 12.0 * z) / 2.0, rate]


def _lag(x: np.ndarray, u: np.ndarray) -> list[float]:
    q, v, uf = x
    return [v, (uf - 33.0 * q - 2.0 * v) / 2.0, (u[0] - uf) / 0.5]


def _heater(x: np.ndarray, u: np.ndarray) -> list[float]:
    body, pf = x
    return [(pf - 1.7 * (body - u[1])) / 120.0, (u[0] - pf) / 60.0]


PLANTS = {
    "resonance": Plant(
        MASS, "hidden_mode", "equation:v", {"wh": 7.0}, _mode, 0.02, ((0.0, 0.5), (0.0, 3.0)), 0.005
    ),
    "loop": Plant(
        MASS, "hysteresis", "equation:v", {"kz": 12.0}, _loop, 0.02, ((0.0, 0.15),), 0.005
    ),
    "lag": Plant(MASS, "actuator_lag", "input:u", {"tau": 0.5}, _lag, 0.02, ((0.0, 20.0),), 0.005),
    "heater": Plant(
        BODY, "actuator_lag", "input:P", {"tau": 60.0}, _heater, 2.0, ((20.0, 30.0),), 0.005
    ),
}  # fmt: skip
