"""Performing the experiments: exact motion, sensors, and the controller between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.concealed.control import Controller, Gains
from benchmarks.concealed.effects import Effect
from benchmarks.concealed.excitation import Design
from benchmarks.concealed.sensing import AFTER_NOISE, Sensor, at, converted, noise
from benchmarks.concealed.systems import Array
from benchmarks.concealed.truth import Exact, Tape, World


@dataclass(frozen=True, eq=False)
class Recorded:
    """What happened, and what was read; samples and experiments are the last two axes.

    Attributes
    ----------
    x, dx : ndarray
        Exact states and their derivatives.
    u : ndarray
        Applied inputs, as recorded.
    y : ndarray
        Readings in SI, before the sensors' gains.
    """

    x: Array
    dx: Array
    u: Array
    y: Array


def on_sensor(world: World, number: int) -> list[tuple[Effect, dict]]:
    """Return the effects of one sensor and their constants."""
    pairs = zip(world.effects, world.values, strict=True)
    return [(f, dict(e)) for f, e in pairs if f.kind == "output" and f.index == number]


def position_of(effects: list[tuple[Effect, dict]], k: Array, dt: float) -> Array:
    """Return where in samples a sensor looks when it is read at sample k."""
    position = np.asarray(k, dtype=float)
    for effect, e in effects:
        if effect.clock is not None:
            position = position * (1.0 + e[effect.clock])
        elif effect.delay is not None:
            position = position - e[effect.delay] / dt
    return position


def _before_noise(y: Array, effects: list[tuple[Effect, dict]]) -> Array:
    for effect, e in effects:
        if effect.reading is not None and effect.mechanism not in AFTER_NOISE:
            y = effect.reading(y, e)
    return y


def perform(
    rng: np.random.Generator,
    world: World,
    design: Design,
    sensors: Sequence[Sensor],
    gains: tuple[Gains, ...],
    x0: Array,
) -> Recorded:
    """Run all experiments of a case on the exact plant.

    Raises
    ------
    FloatingPointError
        The plant runs away.
    """
    system, n, count = world.system, design.samples, design.experiments
    start = np.zeros((world.states, count))
    start[: world.motions] = x0
    draws = [noise(rng, s, (n, count)) for s in sensors]
    shakes = [s.jitter / design.dt * rng.normal(size=(n, count)) for s in sensors]
    extra = 0 if design.closed else _overrun(world, n)
    u = np.empty((len(system.drives), n + extra, count))
    if not design.closed:
        last = np.repeat(design.signal[:, -1:], extra, axis=1)
        u[:] = np.concatenate([design.signal, last], axis=1)
    for effect in world.effects:
        if effect.mechanism == "actuator_lag" and not design.closed:
            start[world.motions :] = u[effect.index, 0]
        elif effect.mechanism == "actuator_lag":
            start[world.motions :] = design.u0[effect.index]
        elif effect.mechanism == "hidden_mode":
            start[world.motions] = x0[effect.index]
    tape = Tape(u, design.dt, design.hold, np.arange(count), np.zeros(count, int))
    exact = Exact(world, tape, start)
    controller = Controller(gains, design, len(system.drives))
    x = np.empty((world.states, n + extra, count))
    dx = np.empty_like(x)
    y = np.empty((len(sensors), n, count))
    for k in range(n + extra):
        x[:, k] = exact.x
        if design.closed:
            # the slope of the interval that ended here belongs to the input held in it
            u[:, k] = u[:, max(k - 1, 0)] if k else design.u0[:, None]
            dx[:, k] = exact.rates()
            _read(world, sensors, draws, shakes, x, dx, y, design.dt, k, k + 1)
            measured = np.stack([y[_reader(sensors, g.coordinate), k] for g in gains])
            u[:, k] = controller.step(k, measured)
        else:
            dx[:, k] = exact.rates()
        if k < n + extra - 1:
            exact.advance()
    if not design.closed:
        _read(world, sensors, draws, shakes, x, dx, y, design.dt, 0, n)
    limit = 1e3 * max(system.target, float(np.abs(x0).max()))
    if not np.isfinite(x).all() or np.abs(x[: system.size]).max() > limit:
        raise FloatingPointError("the plant runs away")
    return Recorded(x[:, :n], dx[:, :n], u[:, :n], y)


def _reader(sensors: Sequence[Sensor], coordinate: int) -> int:
    return next(i for i, s in enumerate(sensors) if s.coordinate == coordinate and not s.rate)


def _overrun(world: World, samples: int) -> int:
    """Samples to integrate past the end for a sensor whose clock runs fast."""
    skews = [e[f.clock] for f, e in zip(world.effects, world.values, strict=True) if f.clock]
    return max([0, *(int(np.ceil(s * samples)) + 2 for s in skews if s > 0)])


def _read(
    world: World,
    sensors: Sequence[Sensor],
    draws: list[Array],
    shakes: list[Array],
    x: Array,
    dx: Array,
    y: Array,
    dt: float,
    first: int,
    stop: int,
) -> None:
    """Fill in the readings of samples first, ..., stop - 1."""
    k = np.arange(first, stop)[:, None]
    known = max(stop, x.shape[1] if first == 0 and stop > 1 else stop)
    for i, sensor in enumerate(sensors):
        effects = on_sensor(world, i)
        row = sensor.row(world.system)
        place = position_of(effects, k, dt)
        exact = x[row, first:stop]
        if effects and known > 1:
            exact = at(x[row, :known], dx[row, :known], place, dt)
        clean = exact + dx[row, first:stop] * shakes[i][first:stop] * dt
        noisy = _before_noise(clean, effects) + draws[i][first:stop]
        y[i, first:stop] = converted(sensor, noisy, effects)
