"""The truth: a system with an effect, integrated from sample to sample at tight tolerance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.generality.law import Law, Motion
from benchmarks.generality.system import Array, Drive, Gauge, System

LEAD = 25
"""Samples before the recording in which the system is in motion already."""
RTOL = 1e-9
WILD = 30.0
"""Reach of a state, in that of the undisturbed motion, beyond which a motion has escaped."""


@dataclass(frozen=True, eq=False)
class Effect:
    """A law at its place.

    Attributes
    ----------
    place : tuple of int
        An axis, two axes, an input or an output.
    soft : float
        Speed over which dry friction reverses.
    """

    law: Law
    place: tuple[int, ...]
    values: Mapping[str, float]
    soft: float = 1.0


@dataclass(frozen=True, eq=False)
class Signal:
    """Inputs (inputs, instants) in straight lines, or held, between instants.

    `number` counts the recordings.
    """

    time: Array
    values: Array
    hold: str
    number: int

    def at(self, t: Any, late: Mapping[int, float] | None = None) -> Array:
        """Return the inputs at times, shape (inputs, *t.shape)."""
        late = late or {}
        rows = []
        for k, row in enumerate(self.values):
            when = np.asarray(t) - late.get(k, 0.0)
            if self.hold == "zero":
                before = np.searchsorted(self.time, when + 1e-12, side="right") - 1
                rows.append(row[np.clip(before, 0, len(row) - 1)])
            else:
                rows.append(np.interp(when, self.time, row))
        return np.array(rows)


@dataclass(frozen=True, eq=False)
class Track:
    """A motion at instants: states, rates and inputs that acted, (rows, instants)."""

    time: Array
    x: Array
    dx: Array
    u: Array


class Escaped(ArithmeticError):
    """A motion that leaves every bound."""


@dataclass(frozen=True, eq=False)
class Plant:
    """A system, its constants and perhaps an effect."""

    system: System
    constants: Mapping[str, Any]
    effect: Effect | None = None

    @property
    def extra(self) -> int:
        """How many states the effect has."""
        return self.effect.law.states if self.effect else 0

    def rates(self, t: float, state: Array, u: Array, run: int = 0) -> Array:
        """Return the rates of system and effect, shape (states + extra, lanes)."""
        n, axes = len(self.system.states), len(self.system.axes)
        x, z, effect = state[:n], state[n:], self.effect
        force = np.zeros((axes, x.shape[1]))
        own: list[Any] = []
        if effect is None:
            return np.array(self.system.motion(x, u, self.constants, force), dtype=float)
        law, values = effect.law, effect.values
        motion = self._seen(t, x, u, z, run)
        if law.kind == "drive":
            u = u.copy()
            u[effect.place[0]] = law.act(motion, values)
        elif law.kind in ("force", "pair"):
            acts = law.act(motion, values)
            force[effect.place[0]] = acts
            if law.kind == "pair":
                force[effect.place[1]] = -acts
        if law.rates is not None:
            own = list(law.rates(motion, values))
        dx = np.array(self.system.motion(x, u, self.constants, force), dtype=float)
        if law.kind == "inertia":
            # rates are linear in the force: with g per unit of it, a = a0 + g F and F = -ma a
            axis = effect.place[0]
            force[axis] = 1.0
            per_force = np.array(self.system.motion(x, u, self.constants, force)) - dx
            k = self.system.index(self.system.axes[axis].state)
            dx = dx - per_force * values["ma"] * dx[k] / (1.0 + values["ma"] * per_force[k])
        return np.concatenate([dx, np.array(own).reshape(-1, x.shape[1])])

    def begun(self, t: float, x: Array, u: Array) -> Array:
        """Return the start of the effect's states, shape (extra,)."""
        effect = self.effect
        if effect is None or not effect.law.states:
            return np.zeros(0)
        motion = self._seen(t, x[:, None], u[:, None], np.zeros((self.extra, 1)), 0)
        if effect.law.begin is None:
            return np.zeros(self.extra)
        return np.array(effect.law.begin(motion, effect.values), dtype=float).reshape(-1)

    def moved(self, signal: Signal, instants: Array, reach: Array | None = None) -> Track:
        """Integrate from `LEAD` samples before zero; return the motion at instants.

        Raises
        ------
        Escaped
            A state leaves `WILD` times its reach, or what is finite.
        """
        system = self.system
        late = {}
        if self.effect is not None and self.effect.law.kind == "late_drive":
            late = {self.effect.place[0]: float(self.effect.values["tau"])}
        first = signal.time[0]
        kinks = [signal.time, *(signal.time + shift for shift in late.values())]
        nodes = np.unique(np.concatenate([*kinks, instants, [first]]))
        nodes = nodes[(nodes >= first) & (nodes <= max(instants.max(), first))]
        nodes = nodes[np.concatenate([[True], np.diff(nodes) > 1e-12])]
        u0 = signal.at(first, late)
        start = system.at_start()
        state = np.concatenate([start, self.begun(float(first), start, u0)])
        found = [state]
        typical = np.maximum(np.abs(start), 1e-6) if reach is None else reach
        scale = np.concatenate([typical, np.full(self.extra, 1e-3)])

        for a, b in pairwise(nodes):
            middle = 0.5 * (a + b)
            held = signal.at(middle, late)[:, None] if signal.hold == "zero" else None

            def rates(t: float, y: Array, held: Array | None = held) -> Array:
                u = signal.at(t, late)[:, None] if held is None else held
                return self.rates(t, y[:, None], u, signal.number)[:, 0]

            with np.errstate(all="ignore"):
                step = solve_ivp(rates, (a, b), state, "DOP853", rtol=RTOL, atol=1e-9 * scale)
            state = step.y[:, -1]
            if not step.success or not np.isfinite(state).all():
                raise Escaped("the motion cannot be followed")
            if reach is not None and np.any(np.abs(state[: len(reach)]) > WILD * reach):
                raise Escaped("the motion leaves every bound")
            found.append(state)
        at = np.searchsorted(nodes, instants - 1e-12)
        whole = np.array(found)[at].T
        u = signal.at(instants, late)
        dx = np.array(
            [
                self.rates(t, y[:, None], u[:, [k]], signal.number)[:, 0]
                for k, (t, y) in enumerate(zip(instants, whole.T, strict=True))
            ]
        ).T
        return Track(instants, whole, dx, u)

    def _seen(self, t: float, x: Array, u: Array, z: Array, run: int) -> Motion:
        """Return the motion that the law sees at its place."""
        effect, system = self.effect, self.system
        assert effect is not None
        if effect.law.kind in ("drive", "late_drive"):
            return Motion(t, 0.0, 0.0, u[effect.place[0]], z, run=run)
        if effect.law.kind in ("reading", "instants"):
            return Motion(t, 0.0, 0.0, run=run)
        q: Any = 0.0
        v: Any = 0.0
        for sign, axis in zip((1.0, -1.0), effect.place, strict=False):
            place = system.axes[axis]
            v = v + sign * x[system.index(place.state)]
            q = q + sign * (x[system.index(place.position)] if place.position else 0.0)
        return Motion(t, q, v, z=z, soft=effect.soft, run=run)


def instants_of(effect: Effect | None, time: Array, output: int) -> Array:
    """Return when an output was read that is stamped with `time`."""
    if effect is not None and effect.law.kind == "instants" and effect.place[0] == output:
        return np.asarray(effect.law.act(Motion(time, 0.0, 0.0), effect.values))
    return time


def readings(
    plant: Plant, signal: Signal, gauges: Sequence[Gauge], time: Array, reach: Array | None = None
) -> tuple[Track, Array]:
    """Return the motion at the samples and what the sensors would read without noise.

    The second array has the shape (outputs, samples).
    """
    when = [instants_of(plant.effect, time, k) for k in range(len(gauges))]
    every = np.unique(np.concatenate([time, *when]))
    every = every[np.concatenate([[True], np.diff(every) > 1e-12])]
    track = plant.moved(signal, every, reach)

    def at(t: Array) -> Array:
        return np.searchsorted(every, t - 1e-12)

    rows = []
    for k, gauge in enumerate(gauges):
        own = at(when[k])
        rows.append(gauge_of(plant.system, gauge, track.x[:, own], track.dx[:, own]))
    y = np.array(rows)
    effect = plant.effect
    if effect is not None and effect.law.kind == "reading":
        k = effect.place[0]
        y[k] = effect.law.act(Motion(time, y[k], 0.0, run=signal.number), effect.values)
    own = at(time)
    return Track(time, track.x[:, own], track.dx[:, own], track.u[:, own]), y


def gauge_of(system: System, gauge: Gauge, x: Array, dx: Array) -> Array:
    """Return a gauge's reading of states and rates (states, samples)."""
    source = dx if gauge.kind == "acceleration" else x
    return gauge.gain * source[system.index(gauge.state)]


def excited(
    rng: np.random.Generator, drives: Mapping[str, Drive], time: Array, hold: str, number: int
) -> Signal:
    """Draw the inputs of a recording at its instants, the lead included."""
    rows = [_driven(rng, drive, time) for drive in drives.values()]
    return Signal(time, np.array(rows), hold, number)


def _driven(rng: np.random.Generator, drive: Drive, time: Array) -> Array:
    low, high = drive.band
    if drive.steps:
        period = 2.0 * np.pi / np.sqrt(low * high)
        edges = np.cumsum(rng.uniform(0.4, 1.6, 400) * period / 2.0) + time[0]
        levels = rng.uniform(-1.7, 1.7, 401)
        return drive.offset + drive.amplitude * levels[np.searchsorted(edges, time)]
    lines = np.exp(rng.uniform(np.log(low), np.log(high), 6))
    phases = rng.uniform(0.0, 2.0 * np.pi, 6)
    wave = np.sin(np.multiply.outer(lines, time) + phases[:, None]).sum(0)
    return drive.offset + drive.amplitude * wave / np.sqrt(3.0)
