"""What public tools give: re-calibration alone, pysindy on the residual, a network on it.

All three start from the re-calibrated given model. pysindy works on the tool's weak residual and
library, the network on the acceleration residual of the smoothed and differentiated recordings, row
by row: M dv/dt - f. Where no term stands, the last two say what re-calibration alone says.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from scipy.signal import savgol_filter

from jaxsr.models import Model, Simulator, read_model
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments, cut
from jaxsr.models.shooting import fit
from jaxsr.recordings import read_recording

SEGMENT = 150
"""Samples of a segment of the calibration."""
WORTH = 0.05
"""Least relative gain on the recording held back for a finding to stand."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A case read, and its given model re-calibrated."""

    model: Model
    data: tuple[Prepared, ...]
    held: tuple[Prepared, ...]
    theta: np.ndarray
    given_cost: float
    cost: float

    @property
    def span(self) -> float:
        """Horizon in seconds: a fifth of a recording."""
        return float(self.data[0].time[-1] - self.data[0].time[0]) / 5.0


def calibrate(case: Path) -> Calibrated:
    """Read a case and estimate the free parameters of the given model in free run."""
    arguments = json.loads((case / "case.json").read_text(encoding="utf-8"))
    model = read_model(case / arguments["model"])

    def prepared(names: list[str]) -> tuple[Prepared, ...]:
        column = model.columns.get(model.time)
        return tuple(Prepared.build(model, read_recording(case / n, time=column)) for n in names)

    data, held = prepared(arguments["data"]), prepared(arguments["held_out"])
    theta = np.array([p.value for p in model.parameters.values()])
    active = np.array([i for i, p in enumerate(model.parameters.values()) if p.free], int)
    low = np.array([p.bounds[0] if p.bounds else p.value for p in model.parameters.values()])
    high = np.array([p.bounds[1] if p.bounds else p.value for p in model.parameters.values()])
    problem = _problem(model, data)
    none = np.zeros(0, dtype=int)
    given = fit(problem, theta, none, (low, high), max_iterations=8)
    best = fit(problem, theta, active, (low, high), x0=given.x0)
    return Calibrated(model, data, held, best.theta, given.cost, best.cost)


def _problem(model: Model, data: tuple[Prepared, ...]) -> Problem:
    step = float(np.median(np.diff(data[0].time)))
    rows = cut(data, SEGMENT * step)
    segments = build_segments(model, data, rows, 2)
    scale = np.nanstd(np.concatenate([p.outputs for p in data]), axis=0)
    return Problem(Simulator(model), Stepping("rk4", 2), segments, np.where(scale > 0, scale, 1.0))


def held_out(c: Calibrated, model: Model, theta: np.ndarray) -> float:
    """Free-run NRMSE on the held-out recordings at a fifth of their length."""
    from jaxsr.diagnosis.shooting.scoring import free_run

    with np.errstate(all="ignore"):
        run = free_run(Simulator(model), Stepping("rk4", 4), c.held, theta, c.span)
    return run.nrmse


def _answer(
    c: Calibrated,
    verdict: str,
    findings: list[dict[str, Any]],
    explained: float | None,
    before: float,
) -> dict[str, Any]:
    fit_rows = {
        "horizons_s": [c.span],
        "headline_s": c.span,
        "held_out": {"recalibrated": [before], "explained": [explained]},
    }
    return {"verdict": verdict, "findings": findings, "fit": fit_rows}


def recalibration(case: Path) -> dict[str, Any]:
    """Re-calibrate, and blame the parameter that moved most where the fit gained by it."""
    c = calibrate(case)
    return _without_terms(c, held_out(c, c.model, c.theta))


def _without_terms(c: Calibrated, before: float) -> dict[str, Any]:
    """Return what re-calibration alone says."""
    if 1.0 - c.cost / max(c.given_cost, 1e-300) < WORTH:
        return _answer(c, "nothing", [], before, before)
    names, values = list(c.model.parameters), [p.value for p in c.model.parameters.values()]
    shift = np.abs(c.theta / np.where(np.array(values) != 0, values, 1.0) - 1.0)
    name = names[int(np.argmax(shift))]
    finding = {"site": f"parameter:{name}", "mechanism": "wrong_value", "parameters": {}}
    return _answer(c, "parameter", [finding], before, before)


@dataclass(frozen=True, eq=False)
class Residual:
    """Acceleration residual of one recording: states and rows to samples."""

    x: np.ndarray  # (samples, states)
    u: np.ndarray
    r: np.ndarray  # (samples, rows)
    rows: tuple[str, ...]


def residual(c: Calibrated, item: Prepared) -> Residual:
    """Return M dv/dt - f at the smoothed states; a margin at both ends is left out."""
    model, simulator = c.model, Simulator(c.model)
    x = np.asarray(savgol_filter(item.states.values, 15, 3, axis=0))
    dt = np.median(np.diff(item.time))
    smooth = savgol_filter(item.states.values, 21, 3, deriv=1, delta=dt, axis=0)
    dx = np.asarray(smooth)
    rows = tuple(model.inertia)
    columns, u = tuple(x.T), tuple(item.inputs.T)
    with jax.enable_x64(True), np.errstate(all="ignore"):
        p = tuple(c.theta)
        force = dict(zip(model.states, simulator.forces(item.time, columns, u, p), strict=True))
        mass = simulator.inertia(item.time, columns, u, p)
        out = []
        for row in rows:
            total = -np.asarray(force[row]) + np.zeros(item.time.size)
            for (i, j), entry in mass.items():
                if i == row:
                    total = total + np.asarray(entry) * dx[:, model.states.index(j)]
            out.append(total)
    inner = slice(20, -20)
    return Residual(x[inner], item.inputs[inner], np.stack(out, axis=1)[inner], rows)


def sindy(case: Path) -> dict[str, Any]:
    """Run pysindy's STLSQ on the tool's residual and library, gated by a gain in free run."""
    from benchmarks.concealed.sindy import edited, library, select

    c = calibrate(case)
    values = zip(c.model.parameters.items(), c.theta, strict=True)
    model = replace(c.model, parameters={n: replace(p, value=float(v)) for (n, p), v in values})
    before = held_out(c, c.model, c.theta)
    with np.errstate(all="ignore"):
        found = library(model, c.data)
        terms, shifts = ([], {}) if found is None else select(found)
    explained = edited(model, terms, shifts) if terms else None
    if explained is None:
        return _without_terms(c, before)
    theta = np.array([p.value for p in explained.parameters.values()])

    def error(items: tuple[Prepared, ...]) -> float:
        again = tuple(Prepared.build(explained, p.recording) for p in items)
        return held_out(replace(c, held=again), explained, theta)

    # of all recordings: a push acts in one
    if not error(c.data) <= (1 - WORTH) * held_out(replace(c, held=c.data), c.model, c.theta):
        return _without_terms(c, before)
    rows = [{"site": t.candidate.site, "mechanism": t.candidate.mechanism} for t in terms]
    finding = {**rows[0], "alternatives": rows[1:4], "parameters": {}}
    verdict = terms[0].candidate.verdict.value
    return _answer(c, verdict, [finding], error(c.held), before)


def network(case: Path) -> dict[str, Any]:
    """Fit a small network to the residual; it finds that, and where, physics is missing.

    It names no mechanism and is not run freely: no gap is given.
    """
    from sklearn.neural_network import MLPRegressor
    from sklearn.preprocessing import StandardScaler

    c = calibrate(case)
    parts = [residual(c, item) for item in c.data]
    before = held_out(c, c.model, c.theta)
    features = [np.column_stack([p.x, p.u]) for p in parts]
    scaler = StandardScaler().fit(np.vstack(features[:-1]))
    gains = []
    for k, row in enumerate(parts[0].rows):
        target = np.concatenate([p.r[:, k] for p in parts[:-1]])
        middle, size = float(target.mean()), float(target.std()) or 1.0
        model = MLPRegressor(
            hidden_layer_sizes=(24,), alpha=1e-3, max_iter=150, early_stopping=True, random_state=0
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(scaler.transform(np.vstack(features[:-1])), (target - middle) / size)
        wanted = parts[-1].r[:, k]
        guess = middle + size * np.asarray(model.predict(scaler.transform(features[-1])))
        gains.append((1.0 - float(np.mean((wanted - guess) ** 2) / np.mean(wanted**2)), row))
    gain, row = max(gains)
    if gain < 2 * WORTH:
        return _without_terms(c, before)
    finding = {"site": f"equation:{row}", "mechanism": "unnamed", "parameters": {}}
    return _answer(c, "structure", [finding], None, before)


BASELINES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "recalibration": recalibration,
    "pysindy": sindy,
    "network": network,
}
