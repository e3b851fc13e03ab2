"""Small plants with dry friction switched exactly: what the search by evidence is studied on.

Between two samples the input runs straight. In one mode of every joint (slipping either way, or
sticking) the motion is smooth and is followed by RK4; where a speed falls to zero, or a force grows
beyond what friction holds, the place is found by bisection and the mode changes. No width of a
rounded jump enters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording

SUBSTEPS, HALVINGS, MOST = 8, 60, 40
"""Steps of RK4 between two samples, halvings that locate a change of mode, and changes in a step.
"""
Speed = np.ndarray
Smooth = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""Accelerations of all joints (q, v, u) without dry friction."""


@dataclass(frozen=True)
class Dry:
    """Dry friction along one joint, as an acceleration; `peak` at standstill decays over `speed`.

    With peak = slide it is Coulomb's law.
    """

    slide: float
    peak: float
    speed: float = 1.0

    def at(self, speed: float) -> float:
        """Return its size at a speed."""
        return self.slide + (self.peak - self.slide) * float(np.exp(-((speed / self.speed) ** 2)))


@dataclass(frozen=True)
class Plant:
    """A given model and the motion that it should have had.

    Attributes
    ----------
    text : str
        Model file; states are the positions, then the speeds.
    smooth : callable
        Accelerations by positions, speeds and input without dry friction, with what is missing.
    dry : mapping of int to Dry
        Joint to its dry friction.
    start : tuple of float
        Positions at the start; at rest.
    """

    text: str
    smooth: Smooth
    dry: Mapping[int, Dry] = field(default_factory=dict)
    start: tuple[float, ...] = (0.2,)

    @property
    def simulator(self) -> Simulator:
        """The given model."""
        return Simulator(parse_model(self.text))

    def recorded(
        self,
        rng: np.random.Generator,
        drive: np.ndarray,
        interval: float,
        noise: float,
        name: str = "run",
    ) -> Recording:
        """Run it and read every position with white noise, a share of how far it moves."""
        positions = self.states(drive, interval)[:, : len(self.start)]
        sigma = noise * positions.std(axis=0)
        read = positions + sigma * rng.normal(size=positions.shape)
        outputs = {f"y{j}": read[:, j] for j in range(positions.shape[1])}
        return Recording(name, interval * np.arange(len(drive)), {"u": drive, **outputs})

    def states(self, drive: np.ndarray, interval: float) -> np.ndarray:
        """Return positions, then speeds, at all samples: shape (samples, states)."""
        walk = _Walk(self, np.array([*self.start, *np.zeros(len(self.start))]))
        rows = [walk.x]
        for before, after in pairwise(drive):
            for k in range(SUBSTEPS):
                shares = k / SUBSTEPS, (k + 1) / SUBSTEPS
                ends = [before + s * (after - before) for s in shares]
                walk.advance(interval / SUBSTEPS, *ends)
            rows.append(walk.x)
        return np.array(rows)


class _Walk:
    """A state on its way, and which joints stick (0) or slip (1, -1)."""

    def __init__(self, plant: Plant, x: np.ndarray) -> None:
        self.plant, self.x, self.mode = plant, x, dict.fromkeys(plant.dry, 0)

    def advance(self, h: float, first: float, last: float) -> None:
        """Go on by one step along which the input runs straight from `first` to `last`."""
        self._released(first)
        for _ in range(MOST):
            end = self._stepped(h, first, last)
            if not self._changed(end, last):
                self.x = end
                return
            low, high = 0.0, 1.0
            for _ in range(HALVINGS):
                share = 0.5 * (low + high)
                u = first + share * (last - first)
                if self._changed(self._stepped(share * h, first, u), u):
                    high = share
                else:
                    low = share
            u = first + high * (last - first)
            end = self._stepped(high * h, first, u)
            changed = self._changed(end, u)
            self.x, first, h = end, u, (1.0 - high) * h
            for j in changed:
                if self.mode[j]:
                    self.x[len(self.plant.start) + j] = 0.0
                    self.mode[j] = 0
            self._released(first)
            if h <= 0.0:
                return
        raise RuntimeError("more changes of mode in a step than can be followed")

    def _pushes(self, x: np.ndarray, u: float) -> np.ndarray:
        n = len(self.plant.start)
        return np.asarray(self.plant.smooth(x[:n], x[n:], u), dtype=float)

    def _released(self, u: float) -> None:
        """Let joints go that friction does not hold."""
        pushes = self._pushes(self.x, u)
        for j, dry in self.plant.dry.items():
            if self.mode[j] == 0 and abs(pushes[j]) > dry.peak:
                self.mode[j] = int(np.sign(pushes[j]))

    def _changed(self, x: np.ndarray, u: float) -> list[int]:
        """Joints whose mode is over at a state."""
        n, pushes, found = len(self.plant.start), self._pushes(x, u), []
        for j, dry in self.plant.dry.items():
            over = abs(pushes[j]) > dry.peak if self.mode[j] == 0 else x[n + j] * self.mode[j] < 0.0
            if over:
                found.append(j)
        return found

    def _rates(self, x: np.ndarray, u: float) -> np.ndarray:
        n, a = len(self.plant.start), self._pushes(x, u)
        for j, dry in self.plant.dry.items():
            a[j] = a[j] - self.mode[j] * dry.at(x[n + j]) if self.mode[j] else 0.0
        return np.concatenate([x[n:], a])

    def _stepped(self, h: float, first: float, last: float) -> np.ndarray:
        x, middle = self.x, 0.5 * (first + last)
        k1 = self._rates(x, first)
        k2 = self._rates(x + h / 2 * k1, middle)
        k3 = self._rates(x + h / 2 * k2, middle)
        k4 = self._rates(x + h * k3, last)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def drive(
    rng: np.random.Generator, samples: int, interval: float, size: float, rates: tuple[float, ...]
) -> np.ndarray:
    """A sum of sines of random sizes and phases."""
    sizes, phases = size * rng.uniform(0.4, 1.0, len(rates)), rng.uniform(0.0, 6.0, len(rates))
    times = interval * np.arange(samples)
    return (sizes * np.sin(np.outer(times, rates) + phases)).sum(axis=1)


def _text(states: str, equations: str, inertia: str, readings: str, parameters: str) -> str:
    return f"""
[model]
name = "plant"
states = [{states}]
inputs = ["u"]
outputs = [{", ".join(line.split(" = ")[0].join('""') for line in readings.splitlines())}]
input_hold = "linear"
[equations]
{equations}
[inertia]
{inertia}
[readings]
{readings}
[parameters]
{parameters}
"""


CART = _text(
    '"q", "v"',
    'q = "v"\nv = "u - k*q - d*v"',
    'v = { v = "m" }',
    'y0 = "q"',
    "m = { value = 1.3, bounds = [0.5, 4.0] }\n"
    "k = { value = 6.0, bounds = [1.0, 20.0] }\n"
    "d = { value = 0.4, bounds = [0.0, 3.0] }",
)
PENDULUM = _text(
    '"q", "v"',
    'q = "v"\nv = "u - g*sin(q) - d*v"',
    'v = { v = "J" }',
    'y0 = "q"',
    "J = { value = 0.12, bounds = [0.03, 0.5] }\n"
    "g = { value = 1.1, bounds = [0.3, 4.0] }\n"
    "d = { value = 0.05, bounds = [0.0, 0.5] }",
)
TWO_MASS = _text(
    '"a", "b", "v", "w"',
    'a = "v"\nb = "w"\nv = "u - k*(a - b) - c*(v - w) - d*v"\nw = "k*(a - b) + c*(v - w)"',
    'v = { v = "M" }\nw = { w = "L" }',
    'y0 = "a"\ny1 = "b"',
    "M = { value = 0.8, bounds = [0.2, 3.0] }\n"
    "L = { value = 1.5, bounds = [0.4, 6.0] }\n"
    "k = { value = 40.0, bounds = [10.0, 200.0] }\n"
    "c = { value = 0.3, bounds = [0.0, 3.0] }\n"
    "d = { value = 0.5, bounds = [0.0, 3.0] }",
)
Force = Callable[[np.ndarray, np.ndarray], np.ndarray]


def cart(force: Force | None = None, dry: Mapping[int, Dry] | None = None, k: float = 6.0) -> Plant:
    """A sprung cart with another force; dry friction in newton over its mass."""

    def smooth(q: np.ndarray, v: np.ndarray, u: float) -> np.ndarray:
        more = 0.0 if force is None else force(q, v)
        return (u - k * q - 0.4 * v + more) / 1.3

    return Plant(CART, smooth, dry or {}, (0.2,))


def pendulum(
    force: Force | None = None, dry: Mapping[int, Dry] | None = None, g: float = 1.1
) -> Plant:
    """A driven pendulum with another moment."""

    def smooth(q: np.ndarray, v: np.ndarray, u: float) -> np.ndarray:
        more = 0.0 if force is None else force(q, v)
        return (u - g * np.sin(q) - 0.05 * v + more) / 0.12

    return Plant(PENDULUM, smooth, dry or {}, (0.4,))


def two_mass(
    force: Force | None = None, dry: Mapping[int, Dry] | None = None, k: float = 40.0
) -> Plant:
    """A drive and its load on a shaft that twists, with other forces on both."""

    def smooth(q: np.ndarray, v: np.ndarray, u: float) -> np.ndarray:
        shaft = k * (q[0] - q[1]) + 0.3 * (v[0] - v[1])
        more = np.zeros(2) if force is None else force(q, v)
        return np.array([(u - shaft - 0.5 * v[0] + more[0]) / 0.8, (shaft + more[1]) / 1.5])

    return Plant(TWO_MASS, smooth, dry or {}, (0.0, 0.0))
