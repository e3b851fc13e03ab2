"""Stores of the first order: temperatures, levels, and circuits beside which nothing is lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.models import Model, parse_model
from jaxsr.recordings import Recording

SAMPLES, NOISE = 300, 0.003

BODY = parse_model(
    """
[model]
name = "heated body"
states = ["Th", "Tb"]
inputs = ["P", "Ta"]
outputs = ["y1", "y2"]
[equations]
Th = "(P - h*(Th - Tb))/Ch"
Tb = "(h*(Th - Tb) - k*(Tb - Ta))/Cb"
[readings]
y1 = "Th"
y2 = "Tb"
[parameters]
h = { value = 2.3, bounds = [0.7, 7.0] }
k = { value = 1.5, bounds = [0.3, 6.0] }
Ch = { value = 40.0 }
Cb = { value = 130.0, bounds = [40.0, 400.0] }
"""
)
TANKS = parse_model(
    """
[model]
name = "tanks"
states = ["h1", "h2"]
inputs = ["u"]
outputs = ["y1", "y2"]
[equations]
h1 = "(kp*u - a1*sqrt(Max(h1, 1e-9)))/A1"
h2 = "(a1*sqrt(Max(h1, 1e-9)) - a2*sqrt(Max(h2, 1e-9)))/A2"
[readings]
y1 = "h1"
y2 = "h2"
[parameters]
kp = { value = 1.0 }
a1 = { value = 1.4, bounds = [0.5, 4.0] }
a2 = { value = 1.2, bounds = [0.5, 4.0] }
A1 = { value = 15.0 }
A2 = { value = 15.0, bounds = [5.0, 50.0] }
"""
)
CIRCUIT = parse_model(
    """
[model]
name = "choke and capacitor"
states = ["i", "uc"]
inputs = ["u"]
outputs = ["y1", "y2"]
[equations]
i = "(u - R*i - uc)/L"
uc = "(i - uc/Rp)/C"
[readings]
y1 = "i"
y2 = "uc"
[parameters]
R = { value = 2.0, bounds = [0.5, 8.0] }
L = { value = 0.05, bounds = [0.01, 0.3] }
C = { value = 0.002, bounds = [0.0005, 0.01] }
Rp = { value = 30.0 }
"""
)


@dataclass(frozen=True)
class Store:
    """A plant and how it is driven.

    Attributes
    ----------
    rates : callable
        Rates of the states by these and the inputs.
    step : float
        In s.
    begins : tuple of float
    drives : tuple of (float, float)
        Mean and half-width of each input.
    """

    model: Model
    rates: Callable[[np.ndarray, np.ndarray], list[float]]
    step: float
    begins: tuple[float, float]
    drives: tuple[tuple[float, float], ...]

    def recordings(self, seed: int) -> list[Recording]:
        """Two recordings, every input steps or swings slowly."""
        rng = np.random.default_rng(seed)
        return [self._recorded(rng, f"run{k}.csv") for k in range(2)]

    def _recorded(self, rng: np.random.Generator, name: str) -> Recording:
        time = np.arange(SAMPLES) * self.step
        inputs = []
        for number, (mean, half) in enumerate(self.drives):
            steps = np.repeat(rng.uniform(-1.0, 1.0, 12), SAMPLES // 12)
            slow = np.sin(2.0 * np.pi * 1.5 * time / time[-1] + rng.uniform(0.0, 6.0))
            inputs.append(mean + half * (slow if number else steps))
        table = np.stack(inputs, 1)

        def rates(t: float, x: np.ndarray) -> list[float]:
            at = min(int(t / self.step), SAMPLES - 2)
            share = t / self.step - at
            return self.rates(x, (1.0 - share) * table[at] + share * table[at + 1])

        begins = np.array(self.begins) * rng.uniform(0.8, 1.2, 2)
        run = solve_ivp(
            rates,
            (0.0, time[-1]),
            begins,
            t_eval=time,
            max_step=self.step / 2.0,
            rtol=1e-8,
            atol=1e-10,
        )
        channels = dict(zip(self.model.inputs, inputs, strict=True))
        for output, course in zip(self.model.outputs, run.y, strict=True):
            channels[output] = course + NOISE * np.std(course) * rng.standard_normal(SAMPLES)
        return Recording(name, time, channels)


def _body(lost: Callable[[float, float], float]) -> Store:
    """A heated body that loses something beside what it conducts."""

    def rates(x: np.ndarray, u: np.ndarray) -> list[float]:
        heater, body = x
        passed = 2.5 * (heater - body)
        left = 1.3 * (body - u[1]) + lost(body, u[1])
        return [(u[0] - passed) / 40.0, (passed - left) / 140.0]

    return Store(BODY, rates, 2.0, (70.0, 50.0), ((70.0, 50.0), (20.0, 3.0)))


def _tanks(x: np.ndarray, u: np.ndarray) -> list[float]:
    first, second = 1.5 * np.sqrt(x[0]), 1.3 * np.sqrt(x[1])
    return [(u[0] - first) / 15.0, (first - second) / 16.0]


def _leaking(x: np.ndarray, u: np.ndarray) -> list[float]:
    first, second = _tanks(x, u)
    return [first - 0.2 * x[0] / 15.0, second]


def _circuit(x: np.ndarray, u: np.ndarray) -> list[float]:
    return [(u[0] - 2.2 * x[0] - x[1]) / 0.06, (x[0] - x[1] / 30.0) / 0.0022]


LOSSES = {
    "convection": _body(lambda t, a: 0.12 * abs(t - a) ** 1.25 * np.sign(t - a)),
    "square": _body(lambda t, a: 0.012 * (t - a) * abs(t - a)),
    "radiation": _body(lambda t, a: 6e-9 * ((t + 273.15) ** 4 - (a + 273.15) ** 4)),
}
LEAK = Store(TANKS, _leaking, 1.0, (4.0, 5.0), ((3.0, 0.9),))
WHOLE = {
    "body": _body(lambda t, a: 0.0),
    "tanks": Store(TANKS, _tanks, 1.0, (4.0, 5.0), ((3.0, 0.9),)),
    "circuit": Store(CIRCUIT, _circuit, 0.002, (1.0, 5.0), ((20.0, 12.0),)),
}
