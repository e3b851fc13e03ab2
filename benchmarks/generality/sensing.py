"""Kinds of sensing, laid over any system: what stands in the columns in place of the readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.generality.law import log_uniform
from benchmarks.generality.system import Array, Gauge

NOISE = (1e-3, 8e-3)
"""Standard deviation of noise, in that of the reading."""


@dataclass(frozen=True)
class Channel:
    """What a sensor does to its reading.

    Attributes
    ----------
    sigma : float
        Standard deviation of the noise, the converter's aside.
    rho : float
        Lag-one correlation of the noise.
    step : float
        Of an encoder or a converter; 0 for none.
    every : int
        Samples from one reading to the next.
    lost : float
        Share of readings that are lost.
    pause : int
        Samples of one long gap in every recording.
    drift : float
        Standard deviation that a bias has wandered at the end, in that of the noise.
    """

    sigma: float
    rho: float = 0.0
    step: float = 0.0
    every: int = 1
    lost: float = 0.0
    pause: int = 0
    drift: float = 0.0

    @property
    def deviation(self) -> float:
        """Standard deviation of noise and converter together."""
        return float(np.hypot(self.sigma, self.step / np.sqrt(12.0)))

    def read(self, rng: np.random.Generator, y: Array) -> Array:
        """Return a column of what was read; NaN where nothing was."""
        n = y.size
        white = rng.normal(size=n)
        noise = np.empty(n)
        noise[0] = white[0]
        for k in range(1, n):
            noise[k] = self.rho * noise[k - 1] + np.sqrt(1.0 - self.rho**2) * white[k]
        bias = self.drift * self.sigma * np.cumsum(rng.normal(size=n)) / np.sqrt(n)
        out = y + self.sigma * noise + bias
        if self.step:
            out = self.step * np.round(out / self.step)
        out[np.arange(n) % self.every != 0] = np.nan
        # the first readings stay, as those of a recording that someone cut by hand do
        out[5:][rng.uniform(size=n - 5) < self.lost] = np.nan
        if self.pause:
            begin = int(rng.integers(n // 4, 3 * n // 4))
            out[begin : begin + self.pause] = np.nan
        return out


Channels = list[Channel]
Kind = Callable[[np.random.Generator, Sequence[Gauge], Array], Channels]


def _sigmas(rng: np.random.Generator, y: Array) -> list[float]:
    return [log_uniform(rng, *NOISE) * float(np.std(row)) for row in y]


def _plain(rng: np.random.Generator, gauges: Sequence[Gauge], y: Array) -> Channels:
    return [Channel(s) for s in _sigmas(rng, y)]


def _coloured(rng: np.random.Generator, gauges: Sequence[Gauge], y: Array) -> Channels:
    return [Channel(s, rho=rng.uniform(0.4, 0.85)) for s in _sigmas(rng, y)]


def _encoder(rng: np.random.Generator, gauges: Sequence[Gauge], y: Array) -> Channels:
    """Positions by counts, without any noise of their own; the rest by a converter of 12 bits."""
    found = []
    for gauge, row, sigma in zip(gauges, y, _sigmas(rng, y), strict=True):
        reach = float(np.ptp(row))
        if gauge.kind == "position":
            found.append(Channel(0.0, step=float(f"{reach / log_uniform(rng, 400, 4000):.3g}")))
        else:
            found.append(Channel(sigma, step=float(f"{2.0 * reach / 4096:.3g}")))
    return found


def _lost(rng: np.random.Generator, gauges: Sequence[Gauge], y: Array) -> Channels:
    pause = int(rng.integers(10, 30)) if rng.uniform() < 0.5 else 0
    return [
        Channel(s, lost=log_uniform(rng, 0.005, 0.2), pause=pause if k == 0 else 0)
        for k, s in enumerate(_sigmas(rng, y))
    ]


def _rates(rng: np.random.Generator, gauges: Sequence[Gauge], y: Array) -> Channels:
    """The first sensor reads every sample where there are others; they are slower."""
    slow = [int(rng.integers(2, 6)) for _ in gauges]
    if len(slow) > 1:
        slow[0] = 1
    return [Channel(s, every=k) for s, k in zip(_sigmas(rng, y), slow, strict=True)]


def _drifting(rng: np.random.Generator, gauges: Sequence[Gauge], y: Array) -> Channels:
    """A bias that wanders by less than two deviations of the noise: no fault of a sensor."""
    return [Channel(s, drift=rng.uniform(0.7, 1.8)) for s in _sigmas(rng, y)]


SENSING: dict[str, Kind] = {
    "white": _plain,
    "coloured": _coloured,
    "encoder": _encoder,
    "inertial": _plain,
    "lost": _lost,
    "rates": _rates,
    "jitter": _plain,
    "drift": _drifting,
}
"""Kinds by name; `inertial` reads a system's accelerometers and gyros."""
JITTER = (0.05, 0.3)
"""Standard deviation of sampling instants under `jitter`, in the sample time."""


def sampled(rng: np.random.Generator, kind: str, dt: float, samples: int, lead: int) -> Array:
    """Return the instants of a recording from zero, and of the lead before it."""
    time = dt * np.arange(-lead, samples)
    if kind == "jitter":
        spread = rng.uniform(*JITTER)
        time = time + dt * np.clip(spread * rng.normal(size=time.size), -0.45, 0.45)
        time -= time[lead]
    return np.round(time, 9)
