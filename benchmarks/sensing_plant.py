"""A plant of the sensing benchmark: its motion as a model file and as a function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.recordings import Recording

FREE_PLAY = 3.0
"""Bounds of a free parameter: its given value divided and multiplied by this."""
STICK = 1e-3
"""Width of the sign function that the truth is integrated with, relative to the rms speed."""

Values = Mapping[str, float]


@dataclass(frozen=True)
class Sensor:
    """How an output is read.

    Attributes
    ----------
    step : float
        Steps of the converter over the range of the reading (0: none); negative: the step itself.
    noise : float
        Standard deviation over that of the reading, before the converter.
    differenced : str
        The output whose stepped samples are differenced for it: a speed from an encoder.
    """

    step: float = 0.0
    noise: float = 0.0
    differenced: str = ""


@dataclass(frozen=True, eq=False)
class Run:
    """A motion at its samples: arrays (states, samples) and (outputs, samples)."""

    time: np.ndarray
    u: np.ndarray
    states: np.ndarray
    rates: np.ndarray
    readings: np.ndarray


@dataclass(frozen=True)
class Plant:
    """A system.

    Attributes
    ----------
    equations, readings, inertia : dict of str to str
        Of the given model, by state, output, and state.
    motion : callable
        dx/dt of (x, u, values, missing); `missing` is the force that the model leaves out.
    read : callable
        Outputs, in order, of (x, dx/dt, values), arrays over the samples.
    ranges : dict of str to (low, high)
        Parameters, drawn log-uniformly; free in the model.
    sensors : dict of str to Sensor
    speed, mass : int, str
        Which state the missing force brakes, and the parameter that is its inertia.
    amplitude, band : float, (low, high)
        Of the input, and its frequencies in rad/s.
    """

    name: str
    states: tuple[str, ...]
    equations: Mapping[str, str]
    readings: Mapping[str, str]
    motion: Callable[..., Any]
    read: Callable[..., Any]
    ranges: Mapping[str, tuple[float, float]]
    sensors: Mapping[str, Sensor]
    speed: int
    mass: str
    amplitude: float
    band: tuple[float, float]
    inertia: Mapping[str, str] = field(default_factory=dict)
    definitions: Mapping[str, str] = field(default_factory=dict)
    delays: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    sample_time: float = 0.01
    samples: int = 400

    def drawn(self, rng: np.random.Generator) -> dict[str, float]:
        """Return values of the parameters."""
        return {
            name: float(f"{np.exp(rng.uniform(*np.log(ends))):.4g}")
            for name, ends in self.ranges.items()
        }

    def model(self, values: Values) -> str:
        """Return the model file with these values, every one free."""
        tables: dict[str, list[str]] = {
            "definitions": [f'{k} = "{v}"' for k, v in self.definitions.items()],
            "equations": [f'{k} = "{v}"' for k, v in self.equations.items()],
            "inertia": [f'{k} = {{ {k} = "{v}" }}' for k, v in self.inertia.items()],
            "readings": [f'{k} = "{v}"' for k, v in self.readings.items()],
            "parameters": [
                f"{k} = {{ value = {v}, bounds = [{v / FREE_PLAY}, {v * FREE_PLAY}] }}"
                for k, v in values.items()
            ],
            "delays": [f"{k} = {v}" for k, v in self.delays.items()],
            "units": [f'{k} = "{v}"' for k, v in self.units.items()],
        }
        head = (
            f'[model]\nname = "{self.name}"\nstates = {_names(self.states)}\ninputs = ["u"]\n'
            f"outputs = {_names(self.readings)}\n"
        )
        return head + "".join(f"[{k}]\n" + "\n".join(v) + "\n" for k, v in tables.items() if v)

    def records(
        self,
        rng: np.random.Generator,
        values: Values,
        missing: Callable[..., Any] | None = None,
        sensors: Mapping[str, Sensor] | None = None,
    ) -> list[Recording]:
        """Return two recordings, the second excited anew, read by the same sensors."""
        runs = [self.exact(rng, values, missing) for _ in range(2)]
        sensors = self.sensors if sensors is None else sensors
        both = np.concatenate([run.readings for run in runs], axis=1)
        steps = dict(zip(self.readings, _steps(self.readings, sensors, both), strict=True))
        found = []
        for k, run in enumerate(runs):
            row: dict[str, np.ndarray] = {}
            for output, y in zip(self.readings, run.readings, strict=True):
                sensor, step = sensors.get(output, Sensor()), steps[output]
                noisy = y + sensor.noise * y.std() * rng.normal(size=y.size)
                if sensor.differenced:
                    before = row[sensor.differenced]
                    row[output] = np.diff(before, prepend=2 * before[0] - before[1])
                    row[output] /= self.sample_time
                else:
                    row[output] = step * np.round(noisy / step) if step else noisy
            name = f"{self.name.replace(' ', '_').replace(',', '')}_{k}.csv"
            found.append(Recording(name, run.time, {"u": run.u, **row}))
        return found

    def errors(self, run: Run, sensors: Mapping[str, Sensor]) -> np.ndarray:
        """Return the standard deviation of every sensor's error."""
        steps = _steps(self.readings, sensors, run.readings)
        found = []
        for output, y, step in zip(self.readings, run.readings, steps, strict=True):
            sensor = sensors.get(output, Sensor())
            error = float(np.hypot(sensor.noise * y.std(), step / np.sqrt(12.0)))
            if sensor.differenced:
                at = list(self.readings).index(sensor.differenced)
                error = float(np.sqrt(2.0 / 12.0) * steps[at] / self.sample_time)
            found.append(error)
        return np.array(found)

    def exact(
        self, rng: np.random.Generator, values: Values, missing: Callable[..., Any] | None = None
    ) -> Run:
        """Move under four random sines, which the input follows in lines between samples."""
        time = self.sample_time * np.arange(self.samples)
        line, phase = rng.uniform(*self.band, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
        u = np.sin(np.multiply.outer(time, line) + phase).sum(1)
        u *= self.amplitude / np.std(u)
        force = missing or (lambda q, v: 0.0 * v)

        def rates(t: float, x: np.ndarray) -> Any:
            return self.motion(x, np.interp(t, time, u), values, force)

        found = solve_ivp(
            rates,
            (0.0, time[-1]),
            np.zeros(len(self.states)),
            method="LSODA",
            t_eval=time,
            rtol=1e-8,
            atol=1e-10,
            max_step=self.sample_time,
        )
        change = np.array([rates(t, x) for t, x in zip(time, found.y.T, strict=True)]).T
        return Run(time, u, found.y, change, np.array(self.read(found.y, change, values)))


def _steps(
    readings: Mapping[str, str], sensors: Mapping[str, Sensor], y: np.ndarray
) -> list[float]:
    """Return the step of every output's converter, shape of y (outputs, samples)."""
    asked = [sensors.get(output, Sensor()).step for output in readings]
    spans = [float(np.ptp(row)) for row in y]
    found = [span / s if s > 0 else -s for s, span in zip(asked, spans, strict=True)]
    return [float(f"{step:.4g}") for step in found]


def _names(names: Any) -> str:
    return "[" + ", ".join(f'"{n}"' for n in names) + "]"


def rough(x: Any, width: float) -> Any:
    """Return sign(x) over a width."""
    return np.tanh(np.asarray(x) / width)
