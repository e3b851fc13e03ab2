"""True systems behind the generated forms, run by plain code that shares nothing with jaxsr.

A `Plant` holds the true laws as Python texts of its states, inputs and constants. They are run by
the classical Runge-Kutta method with small steps and read between steps by cubic Hermite
interpolation, so that recordings may be sampled at any times.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicHermiteSpline

Inputs = Callable[[float], tuple[float, ...]]


def _sqrt(x: float) -> float:
    return math.sqrt(x) if x >= 0.0 else math.nan


NAMES = {
    **{n: getattr(math, n) for n in ("sin", "cos", "tan", "exp", "tanh", "atan", "log")},
    **{"Abs": abs, "Max": max, "Min": min, "sqrt": _sqrt, "pi": math.pi},
    "sign": lambda x: math.tanh(x / 0.02),
}
"""Functions of the true laws; a sign is smooth enough for fixed steps."""


@dataclass(frozen=True)
class Plant:
    """A true system.

    Attributes
    ----------
    states, inputs : str
        Names, separated by blanks.
    laws : dict of str to str
        State to the rate of the state.
    values : dict of str to float
        The true constants.
    start : tuple of float
    step : float
        Of the integration, in seconds; samples lie no closer on average than twice this.
    longest : float
        Seconds after which nothing more happens, or the system leaves its range.
    drive : tuple of float
        Amplitude of each input.
    effects : dict of str to dict of str to str
        Effect that a model may lack: state to the text added to its rate.
    offset : tuple of float
        Mean of each input.
    frequencies : tuple of float
        Range of the inputs' sines, in Hz.
    bounce : tuple of str, optional
        A state that falls through zero, a state whose sign then turns, and the factor's name.
    """

    states: str
    inputs: str
    laws: Mapping[str, str]
    values: Mapping[str, float]
    start: tuple[float, ...]
    step: float = 0.005
    longest: float = 1e9
    drive: tuple[float, ...] = ()
    offset: tuple[float, ...] = ()
    effects: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    bounce: tuple[str, str, str] | None = None
    frequencies: tuple[float, float] = (0.2, 2.0)  # Hz

    def rate(self, effect: str = "") -> Callable[..., tuple[float, ...]]:
        """Return ``f(t, x, u) -> dx``, with an effect."""
        added = self.effects[effect] if effect else {}
        rows = [
            f"({law})" + (f" + ({added[s]})" if s in added else "") for s, law in self.laws.items()
        ]
        left = {"x": self.states.split(), "u": self.inputs.split()}
        lines = [f"    ({', '.join(n)},) = {k}" for k, n in left.items() if n]
        text = "def f(t, x, u):\n" + "\n".join(lines) + f"\n    return ({', '.join(rows)},)"
        space = {**NAMES, **self.values}
        exec(text, space)
        return space["f"]


def excitation(plant: Plant, rng: np.random.Generator, still: bool = False) -> Inputs:
    """Return the inputs as functions of time: sums of five sines, or constants."""
    count = len(plant.inputs.split())
    drive = np.array(plant.drive or (1.0,) * count)
    offset = np.array(plant.offset or (0.0,) * count)
    if still:
        constant = tuple(offset + drive)
        return lambda t: constant
    omega = 2 * np.pi * rng.uniform(*plant.frequencies, (count, 5))
    phase = rng.uniform(0.0, 2 * np.pi, (count, 5))
    size = rng.uniform(0.2, 0.6, (count, 5)) * drive[:, None]

    def at(t: float) -> tuple[float, ...]:
        return tuple(offset + (size * np.sin(omega * t + phase)).sum(1))

    return at


def simulate(
    plant: Plant, times: np.ndarray, inputs: Inputs, effect: str, start: tuple[float, ...]
) -> np.ndarray:
    """Return the states at `times` (from zero, in seconds), shape (samples, states)."""
    f, h = plant.rate(effect), plant.step
    steps = int(np.ceil(times[-1] / h)) + 1
    half = np.array([inputs(0.5 * h * k) for k in range(2 * steps + 1)]).tolist()
    x, n = tuple(start), len(start)
    path, slopes = np.empty((steps + 1, n)), np.empty((steps + 1, n))
    turns: list[int] = []
    for k in range(steps + 1):
        t, u = k * h, half[2 * k]
        a = f(t, x, u)
        path[k], slopes[k] = x, a
        if k == steps:
            break
        middle, last = half[2 * k + 1], half[2 * k + 2]
        b = f(t + h / 2, tuple(x[i] + h / 2 * a[i] for i in range(n)), middle)
        c = f(t + h / 2, tuple(x[i] + h / 2 * b[i] for i in range(n)), middle)
        d = f(t + h, tuple(x[i] + h * c[i] for i in range(n)), last)
        x = tuple(x[i] + h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]) for i in range(n))
        if plant.bounce is not None and _bounced(plant, x):
            x = _turned(plant, x)
            turns.append(k)
    grid = h * np.arange(steps + 1)
    read = CubicHermiteSpline(grid, path, slopes)(times)
    for k in turns:  # across a jump the last value before it holds
        inside = (times > grid[k]) & (times < grid[k + 1])
        read[inside] = path[k]
    return read


def _bounced(plant: Plant, x: tuple[float, ...]) -> bool:
    names = plant.states.split()
    assert plant.bounce is not None
    return x[names.index(plant.bounce[0])] < 0.0 and x[names.index(plant.bounce[1])] < 0.0


def _turned(plant: Plant, x: tuple[float, ...]) -> tuple[float, ...]:
    assert plant.bounce is not None
    names = plant.states.split()
    where, which, factor = plant.bounce
    after = list(x)
    after[names.index(where)] = 0.0
    after[names.index(which)] *= -plant.values[factor]
    return tuple(after)
