"""Whether the data can show an effect at all, and what the oracle that is told it reaches."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.special import log_ndtr
from scipy.stats import chi2

from benchmarks.concealed.effects import Effect
from benchmarks.concealed.excitation import Design
from benchmarks.concealed.fitting import (
    Fitted,
    Pieces,
    Task,
    Whitener,
    error,
    fit,
    pieces,
    simulate,
)
from benchmarks.concealed.recording import Recorded
from benchmarks.concealed.sensing import Sensor
from benchmarks.concealed.sensing_effects import scaled_reading
from benchmarks.concealed.systems import Array, System

LEVEL = 1e-3
SCALES = ("sensor_gain", "wrong_value")
SEGMENT = 200
"""Samples of a segment of the fits, at least."""
STEPS = {1: 0.1, 2: 0.1, 4: 0.1, 6: 1e3, 12: 1e3, 24: 1e3}
"""Runge-Kutta steps a sample, and the error in standard deviations of the sensor that admits them:
above four, all but an unstable one."""
LARGEST = 1e30
"""Reading that stands for one that has escaped."""
FRACTIONS = (100, 25, 5, 1)
"""Horizons at which errors are stored: the recording's length over these, at least 20 samples."""


@dataclass(frozen=True)
class Evidence:
    """The likelihood-ratio test of a case, and errors on its held-out experiments.

    Attributes
    ----------
    statistic, freedom, p : float, int, float
        Of the re-calibrated model against the one told the effect, on the data to learn from.
    detectable : bool
        p < 1e-3.
    absorbed : bool
        The effect is not detectable, and calibration moves the given values significantly: then
        ``parameter`` is a right answer as well.
    horizons : tuple of float
        Seconds.
    recalibrated, oracle : tuple of float
        Free-run NRMSE of held-out experiments at the horizons.
    innovation : float
        Rms innovation of the oracle, 1 where the noise is all that is left.
    indistinct : tuple of str
        Of a wrong scale (a sensor's gain, a constant's value): other wrong scales that a
        likelihood-ratio test at the same level does not reject. Then ``undecided`` is right.
    """

    statistic: float
    freedom: int
    p: float
    detectable: bool
    absorbed: bool
    horizons: tuple[float, ...]
    recalibrated: tuple[float, ...]
    oracle: tuple[float, ...]
    innovation: float
    substeps: int
    indistinct: tuple[str, ...] = ()

    def document(self) -> dict:
        """Return the fields as plain values."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Setting:
    """Everything the fits of a case need."""

    system: System
    p: Mapping[str, float]
    effects: tuple[Effect, ...]
    sensors: tuple[Sensor, ...]
    design: Design
    recorded: Recorded
    limits: Mapping[str, tuple[float, float]]
    given: Mapping[str, float]

    @property
    def whiteners(self) -> list[Whitener]:
        """One per sensor."""
        coarse = {f.index: f.values["step"] for f in self.effects if f.mechanism == "quantisation"}
        found = []
        for i, sensor in enumerate(self.sensors):
            slope = float(np.sqrt(np.mean(self.recorded.dx[sensor.row(self.system)] ** 2)))
            found.append(Whitener.of(replace(sensor, step=coarse.get(i, sensor.step)), slope))
        return found

    def told(self) -> Task:
        """Return the task of the oracle: free constants and those of the effects."""
        wrong = {f.replaces for f in self.effects if f.replaces}
        names: list = [n for n in self.limits if n not in wrong]
        for i, effect in enumerate(self.effects):
            if effect.replaces:
                names.append(effect.replaces)
            elif effect.mechanism != "quantisation":
                fixed = ("run", "a") if effect.mechanism != "hysteresis" else ("a",)
                names += [(i, c) for c in effect.values if c not in fixed]
        return self._task(self.effects, tuple(names), dict(self.p))

    def untold(self) -> Task:
        """Return the task of re-calibration: the given structure."""
        p = dict(self.p)
        wrong = {f.replaces for f in self.effects if f.replaces}
        p |= {n: self.given[n] for n in wrong if n}
        return self._task((), tuple(n for n in self.limits if n not in wrong), p)

    def as_given(self) -> Task:
        """Return the task in which only the starts are estimated."""
        return self._task((), (), dict(self.given))

    def _task(self, effects: tuple[Effect, ...], names: tuple, p: dict[str, float]) -> Task:
        d = self.design
        limits = {n: b for n, b in self.limits.items()}
        return Task(self.system, p, effects, names, self.sensors, d.dt, d.hold, 1, limits)


def substeps_for(setting: Setting, task: Task, parts: Pieces) -> int:
    """Return the fewest Runge-Kutta steps a sample that agree with the exact motion.

    Six where none agree, and more only where a lag far shorter than a sample makes that unstable.
    """
    theta = np.tile(task.nominal[:, None], parts.run.size)
    k = parts.start[None, :] + np.arange(parts.samples)[:, None]
    for count, limit in STEPS.items():
        with np.errstate(over="ignore", invalid="ignore"):
            y = simulate(replace(task, substeps=count), parts, theta, parts.x0)
            y = np.clip(np.nan_to_num(y, nan=LARGEST), -LARGEST, LARGEST)
        worst = 0.0
        for i, sensor in enumerate(setting.sensors):
            if any(f.kind == "output" and f.index == i for f in setting.effects):
                continue
            exact = setting.recorded.x[sensor.row(setting.system), k, parts.run[None, :]]
            worst = max(worst, float(np.sqrt(np.mean((y[i] - exact) ** 2))) / sensor.sigma)
        if worst < limit:
            return count
    return 2 * max(STEPS)


def _own_substeps(task: Task, parts: Pieces) -> int:
    """Return the fewest Runge-Kutta steps a sample that agree with twice as many."""
    theta = np.tile(task.nominal[:, None], parts.run.size)
    finer = simulate(replace(task, substeps=1), parts, theta, parts.x0)
    for count in (1, 2, 4):
        coarse, finer = finer, simulate(replace(task, substeps=2 * count), parts, theta, parts.x0)
        gap = np.sqrt(np.nanmean((finer - coarse) ** 2, axis=(1, 2)))
        if all(g < 0.1 * s.sigma for g, s in zip(gap, task.sensors, strict=True)):
            return count
    return 8


def weigh(setting: Setting) -> tuple[Evidence, dict[str, float]]:
    """Test a case; return the evidence and the re-calibrated values of the given structure."""
    design = setting.design
    learning = range(design.learning)
    held = range(design.learning, design.experiments)
    told, untold = setting.told(), setting.untold()
    count = max(design.samples // SEGMENT, 1)
    samples = design.samples // count
    extra = sum(f.extra for f in setting.effects)
    base = setting.system.size * setting.system.order
    parts = pieces(setting.recorded, learning, samples, base + extra)
    substeps = substeps_for(setting, told, parts)
    whiteners = setting.whiteners
    _dead_time(setting, parts)
    plain = replace(parts, x0=parts.x0[:base])
    told = replace(told, substeps=substeps)
    untold = replace(untold, substeps=min(_own_substeps(untold, plain), substeps))
    null = fit(untold, plain, whiteners)
    oracle = null
    if setting.effects:
        oracle = fit(told, parts, whiteners)
    freedom = len(told.names) - len(untold.names) + (len(parts.run) * extra if extra else 0)
    statistic = max(null.cost - oracle.cost, 0.0)
    coarse = [f for f in setting.effects if f.mechanism == "quantisation"]
    if coarse:
        statistic, freedom = _grid_evidence(setting, untold, plain, null, coarse[0]), 1
    p = float(chi2.sf(statistic, freedom)) if freedom else 1.0
    given = fit(replace(setting.as_given(), substeps=untold.substeps), plain, whiteners)
    free = max(len(untold.names), 1)
    moved = float(chi2.sf(max(given.cost - null.cost, 0.0), free)) < LEVEL
    lengths = sorted({max(design.samples // n, 20) for n in FRACTIONS})
    recalibrated = [error(untold, setting.recorded, held, null.theta, n) for n in lengths]
    best = list(recalibrated)
    if setting.effects:
        best = [error(told, setting.recorded, held, oracle.theta, n) for n in lengths]
    if any(f.clock for f in setting.effects):
        # inside a short segment the skewed instants lie outside it: the whole recording tells
        best = [best[-1]] * len(best)
    evidence = Evidence(
        statistic=statistic,
        freedom=freedom,
        p=p,
        detectable=p < LEVEL,
        absorbed=bool(p >= LEVEL and moved),
        horizons=tuple(n * design.dt for n in lengths),
        recalibrated=tuple(recalibrated),
        oracle=tuple(min(a, b) for a, b in zip(best, recalibrated, strict=True)),
        innovation=float(np.sqrt(oracle.cost / max(oracle.count, 1))),
        substeps=substeps,
        indistinct=_indistinct(setting, untold, plain, null, oracle) if p < LEVEL else (),
    )
    named = zip(untold.names, null.theta, strict=True)
    return evidence, {n: float(x) for n, x in named if isinstance(n, str)}


def _indistinct(
    setting: Setting, untold: Task, parts: Pieces, null: Fitted, oracle: Fitted
) -> tuple[str, ...]:
    """Return other wrong scales that explain the data as well as the planted one."""
    planted = setting.effects[0]
    if len(setting.effects) > 1 or planted.mechanism not in SCALES:
        return ()
    rivals: dict[str, Task] = {}
    for name in setting.system.constants:
        if name not in untold.names and name != planted.replaces:
            rivals[f"wrong_value of {name}"] = replace(untold, names=(*untold.names, name))
    for i in range(len(setting.sensors)):
        if planted.mechanism != "sensor_gain" or planted.index != i:
            effect = scaled_reading(i)
            names = (*untold.names, (0, "g"))
            rivals[f"sensor_gain of {i}"] = replace(untold, effects=(effect,), names=names)
    found, whiteners = [], setting.whiteners
    for label, task in rivals.items():
        start = np.append(null.theta, task.nominal[-1])
        rival = fit(task, parts, whiteners, theta=start, iterations=30)
        if rival.cost - oracle.cost < chi2.isf(LEVEL, 1):
            found.append(label)
    return tuple(found)


def _dead_time(setting: Setting, parts: Pieces) -> None:
    """Give no weight to readings whose instant lies outside their segment."""
    for effect in setting.effects:
        if effect.kind != "output" or not (effect.delay or effect.clock):
            continue
        k = np.arange(parts.samples)[:, None] + 0 * parts.start[None, :]
        if effect.delay:
            shift = -1.5 * effect.values[effect.delay] / setting.design.dt - 0 * k
        else:
            assert effect.clock is not None
            shift = 1.5 * effect.values[effect.clock] * (k + parts.start[None, :])
        outside = (k + shift < 0) | (k + shift > parts.samples - 1)
        parts.weight[effect.index][outside] = 0.0


def _grid_evidence(
    setting: Setting, task: Task, parts: Pieces, null: Fitted, effect: Effect
) -> float:
    """Twice the log-likelihood ratio of a coarse grid against a finer one and wider noise."""
    i, step = effect.index, effect.values["step"]
    theta = np.tile(null.theta[:, None], parts.run.size)
    motion = simulate(task, parts, theta, null.x0)[i]
    residual = parts.y[i] - motion
    sigma = setting.sensors[i].sigma
    upper, lower = (residual + 0.5 * step) / sigma, (residual - 0.5 * step) / sigma
    inside = _log_mass(lower, upper)
    fine = setting.sensors[i].step or 0.1 * sigma
    wide = float(residual.std())
    density = -0.5 * (residual / wide) ** 2 - np.log(wide * np.sqrt(2 * np.pi)) + np.log(fine)
    return max(2.0 * float(np.sum(inside - density)), 0.0)


def _log_mass(lower: Array, upper: Array) -> Array:
    """Log of the normal probability between two bounds."""
    flip = lower > 0
    a, b = np.where(flip, -upper, lower), np.where(flip, -lower, upper)
    return log_ndtr(b) + np.log1p(-np.exp(np.minimum(log_ndtr(a) - log_ndtr(b), -1e-12)))
