"""Whether the sensors can show an effect beside everything that may be estimated.

The effect's course in the readings, over segments from the true state on, is projected on what
the starts of the segments and the free parameters can bring about, to first order, in units of the
noise: what is left, squared and summed, is the noncentrality of the likelihood ratio of a fit that
is told the effect against re-calibration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from benchmarks.generality.plant import Plant, Signal, Track, gauge_of
from benchmarks.generality.sensing import Channel
from benchmarks.generality.system import Array, Gauge, System, Values

LEVEL = 1e-3
SEGMENT = 100
"""Samples from one estimated start to the next."""
SUBSTEPS = 4
NUDGE = 1e-5
"""Change of a constant or start by which the readings are differentiated, in its size."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Products of an effect's course and derivatives by constants, starts projected out.

    Attributes
    ----------
    names : tuple of str
        Constants of the system, then the effect.
    gram : ndarray, shape (constants + 1, constants + 1)
    """

    names: tuple[str, ...]
    gram: Array

    def left(self, free: Sequence[str]) -> float:
        """Return the noncentrality beside some free constants."""
        return self.beside(free)[0]

    def beside(self, free: Sequence[str]) -> tuple[float, Array]:
        """Return the noncentrality and the relative changes of free constants that leave it."""
        at = [self.names.index(n) for n in free]
        if not at:
            return float(self.gram[-1, -1]), np.zeros(0)
        inner, side = self.gram[np.ix_(at, at)], self.gram[at, -1]
        size = np.sqrt(np.diag(inner))
        scale = np.where(size > 0.0, size, 1.0)  # what nothing shows explains nothing
        inner = inner / np.outer(scale, scale) + 1e-10 * np.eye(len(at))
        change = np.linalg.solve(inner, side / scale)
        left = self.gram[-1, -1] - side / scale @ change
        return float(max(left, 0.0)), change / scale


def detectable(left: float, constants: int) -> bool:
    """Whether the expected likelihood ratio is beyond what chance brings at `LEVEL`."""
    return bool(left + constants > chi2.isf(LEVEL, max(constants, 1)))


def shown(
    system: System,
    constants: Values,
    gauges: Sequence[Gauge],
    channels: Sequence[Channel],
    runs: Sequence[tuple[Signal, Track, Array, Array]],
) -> Shown:
    """Compare readings with an effect and those of the system without.

    Parameters
    ----------
    constants : mapping
        The model's, without the effect.
    runs : sequence of (signal, track, readings, seen)
        A recording's inputs; motion, and readings without noise (outputs, samples), with the
        effect; which readings there are.
    """
    names = tuple(system.constants)
    gram = np.zeros((len(names) + 1, len(names) + 1))
    for signal, track, y, seen in runs:
        for begin in range(0, y.shape[1] - SEGMENT // 2, SEGMENT):
            own = slice(begin, min(begin + SEGMENT, y.shape[1]))
            rows, starts = _columns(system, constants, gauges, signal, track, y, own)
            rows, starts = _white(channels, rows, starts, seen[:, own])
            basis, weights, _ = np.linalg.svd(starts, full_matrices=False)
            basis = basis[:, weights > 1e-9 * weights.max()]
            rows = rows - basis @ (basis.T @ rows)
            gram += rows.T @ rows
    return Shown(names, gram)


def _columns(
    system: System,
    constants: Values,
    gauges: Sequence[Gauge],
    signal: Signal,
    track: Track,
    y: Array,
    own: slice,
) -> tuple[Array, Array]:
    """Return derivatives by constants, the effect last, and by starts.

    Arrays (outputs, samples, columns).
    """
    n, names = len(system.states), list(system.constants)
    time, start = track.time[own], track.x[:n, own.start]
    reach = np.ptp(track.x[:n], axis=1) + 1e-9 * np.abs(track.x[:n]).max()
    lanes = 1 + len(names) + n
    x = np.repeat(start[:, None], lanes, axis=1)
    x[:, 1 + len(names) :] += np.diag(NUDGE * reach)
    p = {}
    for k, name in enumerate(names):
        p[name] = np.full(lanes, float(constants[name]))
        p[name][1 + k] *= 1.0 + NUDGE
    found = followed(Plant(system, p), signal, time, x)
    read = np.array([gauge_of(system, g, found[0], found[1]) for g in gauges])
    base = read[:, :, :1]
    # a constant's column is its effect when it changes by its own size
    change = (read[:, :, 1 : 1 + len(names)] - base) / NUDGE
    starts = (read[:, :, 1 + len(names) :] - base) / NUDGE
    effect = (y[:, own] - base[:, :, 0])[:, :, None]
    return np.concatenate([change, effect], axis=2), starts


def followed(plant: Plant, signal: Signal, time: Array, x: Array) -> tuple[Array, Array]:
    """Follow lanes side by side by RK4; return states and rates (states, samples, lanes)."""
    states, rates = [], []
    with np.errstate(all="ignore"):
        for k, t in enumerate(time):
            u = np.repeat(signal.at(t)[:, None], x.shape[1], axis=1)
            states.append(x)
            rates.append(plant.rates(t, x, u))
            if k + 1 == len(time):
                break
            h = (time[k + 1] - t) / SUBSTEPS
            for i in range(SUBSTEPS):
                x = _step(plant, signal, t + i * h, h, x)
    return np.array(states).transpose(1, 0, 2), np.array(rates).transpose(1, 0, 2)


def _step(plant: Plant, signal: Signal, t: float, h: float, x: Array) -> Array:
    if signal.hold == "zero":
        a = b = e = signal.at(t + 0.5 * h)[:, None]
    else:
        a, b, e = (signal.at(t + s * h)[:, None] for s in (0.0, 0.5, 1.0))
    wide = np.ones((1, x.shape[1]))
    k1 = plant.rates(t, x, a * wide)
    k2 = plant.rates(t + 0.5 * h, x + 0.5 * h * k1, b * wide)
    k3 = plant.rates(t + 0.5 * h, x + 0.5 * h * k2, b * wide)
    k4 = plant.rates(t + h, x + h * k3, e * wide)
    return x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _white(
    channels: Sequence[Channel], rows: Array, starts: Array, seen: Array
) -> tuple[Array, Array]:
    """Return columns in units of independent noise, outputs and samples in one."""
    both, out = np.concatenate([rows, starts], axis=2), []
    for channel, block, own in zip(channels, both, seen, strict=True):
        block = block[own] / channel.deviation
        rho = channel.rho
        after = (block[1:] - rho * block[:-1]) / np.sqrt(1.0 - rho**2)
        out.append(np.concatenate([block[:1], after]))
    whole = np.concatenate(out)
    whole = np.where(np.isfinite(whole), whole, 0.0)
    return whole[:, : rows.shape[2]], whole[:, rows.shape[2] :]
