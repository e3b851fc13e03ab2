"""Output-error fits on the truth's own equations, told which effect is there.

Experiments are cut into segments, each with its own start. The noise is known: AR(1) of each
sensor plus white parts of the converter and of jitter, whitened by the innovations of a
steady-state Kalman filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from benchmarks.concealed.effects import Effect
from benchmarks.concealed.recording import Recorded, on_sensor, position_of
from benchmarks.concealed.sensing import Sensor, at
from benchmarks.concealed.systems import Array, System
from benchmarks.concealed.truth import Tape, World, replay

EDGE = 1e-3
"""Relative step of the finite differences."""


@dataclass(frozen=True, eq=False)
class Whitener:
    """y -> innovations of unit variance."""

    rho: float
    moving: float
    deviation: float

    @staticmethod
    def of(sensor: Sensor, slope: float) -> Whitener:
        """Return the whitener of a sensor whose reading changes by `slope` (rms) a second."""
        white = sensor.step**2 / 12.0 + (sensor.jitter * slope) ** 2
        rho, drive = sensor.rho, sensor.sigma**2 * (1.0 - sensor.rho**2)
        if white <= 0.0 or rho == 0.0:
            total = drive + (white if rho == 0.0 else 0.0)
            return Whitener(rho, 0.0, float(np.sqrt(max(total, 1e-300))))
        # Riccati: P = rho^2 P - (rho P)^2/(P + white) + drive
        b = white * (1.0 - rho**2) - drive
        ahead = 0.5 * (-b + np.sqrt(b * b + 4.0 * drive * white))
        gain = ahead / (ahead + white)
        return Whitener(rho, rho * (1.0 - gain), float(np.sqrt(ahead + white)))

    def __call__(self, residual: Array) -> Array:
        """Whiten along the first axis."""
        filtered = lfilter([1.0, -self.rho], [1.0, -self.moving], residual, axis=0)
        return np.asarray(filtered) / self.deviation


@dataclass(frozen=True, eq=False)
class Task:
    """A model to fit: a system, effects, and which of their constants are estimated.

    `names` are of constants of the plant, or (number of the effect, constant).
    """

    system: System
    p: dict[str, float]
    effects: tuple[Effect, ...]
    names: tuple[str | tuple[int, str], ...]
    sensors: tuple[Sensor, ...]
    dt: float
    hold: str
    substeps: int
    limits: dict[str, tuple[float, float]]

    @property
    def nominal(self) -> Array:
        """Values from which a fit starts."""
        return np.array(
            [
                self.p[n] if isinstance(n, str) else self.effects[n[0]].values[n[1]]
                for n in self.names
            ]
        )

    def world(self, theta: Array) -> World:
        """Return the world of constants theta, shape (constants, runs)."""
        p: dict = dict(self.p)
        values: list[dict] = [dict(e.values) for e in self.effects]
        for name, row in zip(self.names, theta, strict=True):
            if isinstance(name, str):
                p[name] = row
            else:
                values[name[0]][name[1]] = row
        return World(self.system, p, self.effects, tuple(values))

    def clipped(self, theta: Array) -> Array:
        """Return theta inside the limits of the plant's constants."""
        out = theta.copy()
        for i, name in enumerate(self.names):
            if isinstance(name, str) and name in self.limits:
                out[i] = np.clip(out[i], *self.limits[name])
        return out


@dataclass(frozen=True, eq=False)
class Pieces:
    """Segments of recordings, side by side: shapes (..., samples, segments)."""

    u: Array
    run: Array
    start: Array
    y: Array
    x0: Array
    weight: Array

    @property
    def samples(self) -> int:
        """Of every segment."""
        return self.y.shape[1]


def pieces(recorded: Recorded, experiments: Sequence[int], samples: int, states: int) -> Pieces:
    """Cut experiments into segments of equal length; a rest is left out."""
    total = recorded.y.shape[1]
    starts = np.arange(0, total - samples + 1, samples)
    run = np.repeat(np.asarray(experiments), starts.size)
    start = np.tile(starts, len(experiments))
    take = start[None, :] + np.arange(samples)[:, None]
    x0 = np.zeros((states, run.size))
    known = min(states, recorded.x.shape[0])
    x0[:known] = recorded.x[:known, start, run]
    y = recorded.y[:, take, run[None, :]]
    return Pieces(recorded.u, run, start, y, x0, np.ones_like(y))


def simulate(task: Task, parts: Pieces, theta: Array, x0: Array) -> Array:
    """Return readings (sensors, samples, runs) for runs that repeat the segments.

    theta has the shape (constants, runs), x0 (states, runs).
    """
    repeat = x0.shape[1] // parts.run.size
    world = task.world(theta)
    start = np.tile(parts.start, repeat)
    tape = Tape(parts.u, task.dt, task.hold, np.tile(parts.run, repeat), start)
    x, dx = replay(world, tape, x0, parts.samples, task.substeps)
    k = np.arange(parts.samples)[:, None]
    out = np.empty((len(task.sensors), parts.samples, x0.shape[1]))
    with np.errstate(all="ignore"):
        for i, sensor in enumerate(task.sensors):
            row, effects = sensor.row(task.system), on_sensor(world, i)
            out[i] = x[row]
            if any(f.delay or f.clock for f, _ in effects):
                place = position_of(effects, k + start[None, :], task.dt) - start[None, :]
                out[i] = at(x[row], dx[row], place, task.dt)
            for effect, e in effects:
                # a converter's coarse steps have no derivative; their variance is the noise's
                if effect.reading is not None and effect.mechanism != "quantisation":
                    out[i] = effect.reading(out[i], e)
    return out


@dataclass(frozen=True, eq=False)
class Fitted:
    """Estimates, and the sum of squared innovations (chi-squared if the model is right)."""

    theta: Array
    x0: Array
    cost: float
    count: int


def _steps(task: Task, parts: Pieces, theta: Array, x0: Array) -> tuple[Array, Array]:
    spread = np.maximum(np.abs(x0).max(1), 1e-9)
    size = np.abs(theta)
    size = np.where(size > 0, size, 1.0)
    return EDGE * size, EDGE * spread


def fit(
    task: Task,
    parts: Pieces,
    whiteners: Sequence[Whitener],
    theta: Array | None = None,
    iterations: int = 14,
    free_start: Array | None = None,
) -> Fitted:
    """Estimate the constants and all starts by Levenberg-Marquardt steps.

    `free_start` (bool per state) says which states' starts are estimated; all by default.
    """
    theta = task.nominal if theta is None else theta.copy()
    x0, runs = parts.x0.copy(), parts.run.size
    free = np.ones(x0.shape[0], bool) if free_start is None else free_start
    moved = np.flatnonzero(free)

    def residual(simulated: Array) -> Array:
        r = (parts.y[:, :, None, :] - simulated) * parts.weight[:, :, None, :]
        return np.stack([w(r[i]) for i, w in enumerate(whiteners)])

    def tiled(theta: Array, x0: Array, repeat: int) -> tuple[Array, Array]:
        return np.tile(theta[:, None], repeat * runs), np.tile(x0, (1, repeat))

    def cost_of(theta: Array, x0: Array) -> float:
        y = simulate(task, parts, *tiled(theta, x0, 1))
        with np.errstate(all="ignore"):
            value = float(np.sum(residual(y[:, :, None, :]) ** 2))
        return value if np.isfinite(value) else np.inf

    damping, cost = 1e-4, np.inf
    for _ in range(iterations):
        d_theta, d_x = _steps(task, parts, theta, x0)
        columns = 1 + theta.size + moved.size
        many, starts = tiled(theta, x0, columns)
        for i, d in enumerate(d_theta):
            many[i, (1 + i) * runs : (2 + i) * runs] += d
        for j, row in enumerate(moved):
            first = (1 + theta.size + j) * runs
            starts[row, first : first + runs] += d_x[row]
        y = simulate(task, parts, many, starts)
        y = y.reshape(*y.shape[:2], columns, runs)
        r = residual(y)
        base = r[:, :, 0]
        cost = float(np.sum(base**2))
        if not np.isfinite(cost):
            break
        scale = np.concatenate([d_theta, d_x[moved]])
        jacobian = (r[:, :, 1:] - base[:, :, None]) / scale[None, None, :, None]
        jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
        better = False
        for _ in range(4):
            step, shift = _solve(jacobian, base, theta.size, damping)
            trial = task.clipped(theta + step)
            begin = x0.copy()
            begin[moved] += shift
            new = cost_of(trial, begin)
            if new < cost:
                better = True
                break
            damping *= 10.0
        if not better:
            break
        theta, x0, gain, cost = trial, begin, cost - new, new
        damping = max(damping / 10.0, 1e-9)
        if gain < 0.1 + 1e-7 * cost:
            break
    return Fitted(theta, x0, cost, int(parts.weight.sum()))


def _solve(jacobian: Array, base: Array, count: int, damping: float) -> tuple[Array, Array]:
    """Solve the damped normal equations; starts are eliminated segment by segment."""
    a = np.moveaxis(jacobian, 3, 0).reshape(jacobian.shape[3], -1, jacobian.shape[2])
    b = np.moveaxis(base, 2, 0).reshape(base.shape[2], -1)
    size = np.sqrt((a**2).sum((0, 1)))
    size = np.where(size > 0, size, 1.0)
    a = a / size
    gram = np.einsum("sri,srj->sij", a, a)
    right = -np.einsum("sri,sr->si", a, b)
    inner = gram[:, count:, count:]
    # columns are scaled over all segments: a segment's own share of the damping is one part
    inner = inner + damping / len(a) * np.eye(inner.shape[1]) + 1e-12 * np.eye(inner.shape[1])
    cross = gram[:, :count, count:]
    if count:
        kept = np.linalg.solve(inner, np.moveaxis(cross, 1, 2))
        shrink = np.linalg.solve(inner, right[:, count:, None])
        left = gram[:, :count, :count].sum(0) - np.einsum("sij,sjk->ik", cross, kept)
        left = left + damping * np.eye(count) + 1e-13 * np.eye(count)
        side = right[:, :count].sum(0) - np.einsum("sij,sjk->i", cross, shrink)
        step = np.linalg.lstsq(left, side, rcond=1e-14)[0]
    else:
        step = np.zeros(0)
    rest = right[:, count:] - np.einsum("sij,i->sj", cross, step)
    shift = np.linalg.solve(inner, rest[:, :, None])[:, :, 0]
    return step / size[:count], (shift / size[count:]).T


def error(
    task: Task, recorded: Recorded, experiments: Sequence[int], theta: Array, samples: int
) -> float:
    """Free-run NRMSE (docs/method.md) over segments of so many samples.

    Starts are estimated on the first 5 % of a segment, at least 3 samples, 50 on a whole
    recording; a state of an effect's own, or one that no sensor reads, starts at its true value.
    """
    total = recorded.y.shape[1]
    world = task.world(theta[:, None])
    parts = pieces(recorded, experiments, samples, world.states)
    first = min(samples, max(50 if samples == total else 3, int(np.ceil(0.05 * samples))))
    begin = replace(parts, y=parts.y[:, :first], weight=parts.weight[:, :first])
    spread = [float(recorded.y[i].std()) for i in range(len(task.sensors))]
    plain = [Whitener(0.0, 0.0, s) for s in spread]
    read = {s.coordinate for s in task.sensors}
    n = task.system.size
    free = np.zeros(world.states, bool)
    for c in read:
        free[c] = True
        if task.system.order == 2:
            free[n + c] = True
    fixed = replace(task, names=(), p=_filled(task, theta), effects=_with(task, theta))
    x0 = fit(fixed, begin, plain, iterations=5, free_start=free).x0
    y = simulate(fixed, parts, np.zeros((0, parts.run.size)), x0)
    scores = []
    for e in experiments:
        own = parts.run == e
        with np.errstate(all="ignore"):
            mse = np.mean((parts.y[:, :, own] - y[:, :, own]) ** 2, axis=(1, 2))
        relative = mse / np.var(recorded.y[:, :, e], axis=1)
        relative = np.where(np.isfinite(relative), np.minimum(relative, 100.0), 100.0)
        scores.append(float(np.sqrt(relative.mean())))
    return float(np.mean(scores))


def _filled(task: Task, theta: Array) -> dict[str, float]:
    named = zip(task.names, theta, strict=True)
    return {**task.p, **{n: float(x) for n, x in named if isinstance(n, str)}}


def _with(task: Task, theta: Array) -> tuple[Effect, ...]:
    out = list(task.effects)
    for name, x in zip(task.names, theta, strict=True):
        if not isinstance(name, str):
            effect = out[name[0]]
            out[name[0]] = effect.with_values({**effect.values, name[1]: float(x)})
    return tuple(out)
