"""Sensors: what is read, in which scale, with which noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.concealed.effects import Effect
from benchmarks.concealed.systems import Array, System
from benchmarks.concealed.units import TIME, Dims, times

AFTER_NOISE = ("clipping", "quantisation")
"""Effects of the converter, behind the noise of the sensor."""


@dataclass(frozen=True)
class Sensor:
    """A sensor of a coordinate or of its velocity.

    Attributes
    ----------
    coordinate : int
    rate : bool
    dims : Dims
    gain : float
        Column value per SI unit; its sign is random.
    sigma, rho : float
        Standard deviation (SI) and lag-one correlation of the coloured noise.
    step : float
        Of the converter, in SI; 0 for none.
    jitter : float
        Standard deviation of the sampling instant, in seconds.
    """

    coordinate: int
    rate: bool
    dims: Dims
    gain: float
    sigma: float = 0.0
    rho: float = 0.0
    step: float = 0.0
    jitter: float = 0.0

    def row(self, system: System) -> int:
        """Row of the state that it reads."""
        return self.coordinate + (system.size if self.rate else 0)


def choose(
    rng: np.random.Generator, system: System, closed: bool, complete: bool
) -> list[tuple[int, bool]]:
    """Draw which coordinates and velocities are read."""
    count = system.size
    read = list(range(count))
    if count > 1 and not complete and rng.uniform() < 0.2:
        controlled = {c for _, c in system.loops} if closed else set()
        hidden = [c for c in read if c not in controlled]
        if hidden and len(read) > 1:
            read.remove(int(rng.choice(hidden)))
    chosen = [(c, False) for c in read]
    if system.order == 2 and rng.uniform() < 0.4:
        chosen += [(c, True) for c in read if rng.uniform() < 0.7]
    return chosen


def fitted_out(
    rng: np.random.Generator,
    system: System,
    which: list[tuple[int, bool]],
    x: Array,
    dx: Array,
    dt: float,
    level: tuple[float, float] = (3e-4, 3e-2),
) -> tuple[Sensor, ...]:
    """Give every sensor a scale and noise, relative to the undisturbed motion x."""
    sensors = []
    for coordinate, rate in which:
        dims = system.rate_dims(coordinate) if rate else system.coordinates[coordinate]
        row = coordinate + (system.size if rate else 0)
        size = float(x[row].std())
        sigma = size * float(np.exp(rng.uniform(*np.log(level))))
        gain = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(0.05), np.log(500.0))))
        slope = float(np.sqrt(np.mean(dx[row] ** 2)))
        jitter = rng.uniform(0.0, 0.03) * dt if rng.uniform() < 0.4 else 0.0
        sensors.append(
            Sensor(
                coordinate,
                rate,
                dims,
                float(f"{gain:.3g}"),
                sigma,
                float(rng.uniform(0.3, 0.9)) if rng.uniform() < 0.5 else 0.0,
                sigma * float(rng.uniform(0.3, 2.0)) if rng.uniform() < 0.7 else 0.0,
                min(jitter, sigma / max(slope, 1e-300)),
            )
        )
    return tuple(sensors)


def noise(rng: np.random.Generator, sensor: Sensor, shape: tuple[int, int]) -> Array:
    """Draw coloured noise in SI; shape (samples, experiments)."""
    white = rng.normal(size=shape) * sensor.sigma
    white[1:] *= np.sqrt(1.0 - sensor.rho**2)
    return np.asarray(lfilter([1.0], [1.0, -sensor.rho], white, axis=0))


def at(x: Array, dx: Array, position: Array, dt: float) -> Array:
    """Return x between samples by cubic Hermite interpolation.

    Parameters
    ----------
    x, dx : ndarray, shape (samples, runs)
        Values and time derivatives.
    position : ndarray, broadcastable to (samples, runs)
        In samples; held at the ends.
    """
    samples, runs = x.shape
    position = np.broadcast_to(np.clip(position, 0.0, samples - 1.0), (np.shape(position)[0], runs))
    k = np.minimum(position.astype(int), samples - 2)
    s, r = position - k, np.arange(runs)[None, :]
    a, b, c, d = x[k, r], x[k + 1, r], dt * dx[k, r], dt * dx[k + 1, r]
    return (
        a * (1 + 2 * s) * (1 - s) ** 2
        + b * s**2 * (3 - 2 * s)
        + c * s * (1 - s) ** 2
        - d * s**2 * (1 - s)
    )


def converted(sensor: Sensor, reading: Array, effects: list[tuple[Effect, dict]]) -> Array:
    """Return what the converter makes of a noisy reading, in SI."""
    for effect, e in effects:
        if effect.mechanism in AFTER_NOISE and effect.reading is not None:
            reading = effect.reading(reading, e)
    coarse = any(effect.mechanism == "quantisation" for effect, _ in effects)
    if sensor.step and not coarse:
        reading = sensor.step * np.round(reading / sensor.step)
    return reading


def unit_of_rate(dims: Dims) -> Dims:
    """Dimensions of a rate of change."""
    return times(dims, TIME, -1)
