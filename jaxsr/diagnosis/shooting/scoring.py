"""Free-run scores as docs/method.md defines them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.shooting.memory_starts import memory_starts
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping, outputs
from jaxsr.models.segments import SHORTEST, Prepared, Segments, build_segments, cut
from jaxsr.models.shooting import fit, simulate
from jaxsr.models.simulator import Simulator
from jaxsr.models.states import spread

DIVERGED = 10.0
START_SHARE = 0.05
ONE_BY_ONE = 50_000
"""Samples of a segment from which it is simulated by one compiled program from sample to sample."""


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Segmented free runs of all recordings at one horizon.

    Attributes
    ----------
    simulated : list of ndarray, shape (samples, outputs)
        One per recording; NaN where no segment lies.
    nrmse : float
        Mean over recordings; NaN where none holds a segment with readings.
    rmse : ndarray, shape (recordings, outputs)
        NaN where a recording has no reading of an output.
    """

    simulated: list[np.ndarray]
    nrmse: float
    rmse: np.ndarray


def horizons(prepared: Sequence[Prepared]) -> list[float]:
    """Choose at least three horizons; the last one is the whole recording.

    1/100, 1/25 and 1/5 of the recordings' length, each at least `SHORTEST` samples.
    """
    length = float(np.median([p.time[-1] - p.time[0] for p in prepared]))
    shortest = SHORTEST * float(np.median([p.recording.sample_time for p in prepared]))
    chosen = sorted({max(length / n, shortest) for n in (100, 25, 5)} | {length})
    chosen = [h for h in chosen if h <= 0.7 * length] + [length]
    return chosen if len(chosen) >= 3 else [length / 4, length / 2, length]


def free_run(
    simulator: Simulator,
    stepping: Stepping,
    prepared: Sequence[Prepared],
    theta: np.ndarray,
    horizon: float | None,
    like: Sequence[Prepared] = (),
    stop: Callable[[], bool] = lambda: False,
) -> FreeRun:
    """Simulate consecutive segments, each from a start estimated on its first 5 % only.

    At least 3 samples serve for the start, on a whole recording at least 50. A memory's start is
    told by the first 5 % of the recording, and from there its course is led on. The segments are
    padded to the shape of those of `like`, whose compiled simulation then serves here as well.
    What `stop` ends was not run (`not_run`).
    """
    model = simulator.model
    longest = max(float(p.time[-1] - p.time[0]) for p in prepared)
    whole = horizon is None or horizon >= longest * (1 - 1e-9)
    rows = cut(prepared, None if whole else horizon)
    if not rows or stop():
        return not_run(prepared)
    others = cut(like, None if whole else horizon) if like else []
    shape = (max((b - a for _, a, b in others), default=0), len(others))
    starts = None
    if model.driven:
        begun = [_first(item.time.size, 50) for item in prepared]
        scale = _scales(prepared).mean(0)
        starts = memory_starts(simulator, stepping, prepared, theta, begun, scale, stop)
    segments = build_segments(model, prepared, rows, stepping.substeps, shape, theta, starts=starts)
    least = 50 if whole else 3
    first = [_first(b - a, least) for _, a, b in rows]
    begin = _beginnings(simulator, prepared, rows, first, segments, stepping, theta, starts)
    problem = Problem(simulator, stepping, begin, _scales(prepared).mean(0))
    none = np.zeros(0, dtype=int)
    limits = {"max_iterations": 8, "tolerance": 1e-3, "stop": stop}
    start = fit(problem, theta, none, (theta, theta), **limits)
    if segments.time.shape[0] > ONE_BY_ONE:
        y = outputs(simulator, stepping, segments, theta, start.x0)
    else:
        y = simulate(Problem(simulator, stepping, segments, problem.scale), theta, start.x0, stop)
    if stop():
        return not_run(prepared)
    simulated = [np.full_like(p.outputs, np.nan) for p in prepared]
    for s, (r, a, b) in enumerate(rows):
        simulated[r][a:b] = y[:, : b - a, s].T
    covered = [np.zeros(p.time.size, bool) for p in prepared]
    for r, a, b in rows:
        covered[r][a:b] = True
    return _scored(prepared, simulated, covered)


def _first(samples: int, least: int) -> int:
    """How many of some samples tell a start."""
    return min(samples, max(least, int(np.ceil(START_SHARE * samples))))


def not_run(prepared: Sequence[Prepared]) -> FreeRun:
    """Return what is known of recordings along which nothing was run."""
    nothing = [np.full_like(p.outputs, np.nan) for p in prepared]
    return _scored(prepared, nothing, [np.zeros(p.time.size, bool) for p in prepared])


def _beginnings(
    simulator: Simulator,
    prepared: Sequence[Prepared],
    rows: list[tuple[int, int, int]],
    first: list[int],
    segments: Segments,
    stepping: Stepping,
    theta: np.ndarray,
    starts: Sequence[np.ndarray] | None,
) -> Segments:
    """Return the segments, cut short behind their first samples."""
    short = [(r, a, a + n) for (r, a, _), n in zip(rows, first, strict=True)]
    shape = (max(first), segments.number)
    steps = stepping.substeps
    return build_segments(simulator.model, prepared, short, steps, shape, theta, starts=starts)


def _scales(prepared: Sequence[Prepared]) -> np.ndarray:
    return np.stack([spread(p.outputs) for p in prepared])


def _scored(
    prepared: Sequence[Prepared], simulated: list[np.ndarray], covered: list[np.ndarray]
) -> FreeRun:
    """Score every recording by the outputs that it has."""
    scale, rmse, scores = _scales(prepared), [], []
    for r, item in enumerate(prepared):
        measured = np.isfinite(item.outputs) & covered[r][:, None]
        arrived = measured & np.isfinite(simulated[r])
        diverged = (measured & ~arrived).any(0)
        with np.errstate(over="ignore", invalid="ignore"):
            square = np.where(arrived, item.outputs - simulated[r], 0.0) ** 2
            mse = square.sum(0) / np.maximum(arrived.sum(0), 1)
        relative = np.where(diverged, DIVERGED**2, np.minimum(mse / scale[r] ** 2, DIVERGED**2))
        seen = measured.any(0)
        rmse.append(np.where(seen, np.where(diverged, np.inf, np.sqrt(mse)), np.nan))
        if seen.any():
            scores.append(float(np.sqrt(np.mean(relative[seen]))))
    nrmse = float(np.mean(scores)) if scores else float("nan")
    return FreeRun(simulated, nrmse, np.array(rmse))
