"""How far ahead a diagnosis looks: the horizon of the verdict and the length of its segments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxsr.diagnosis.candidates import SuperModel
from jaxsr.diagnosis.contenders import Start
from jaxsr.diagnosis.contest import Arena, build_arena, enter, neutral_values
from jaxsr.diagnosis.reduced import lean, reduce
from jaxsr.diagnosis.scoring import horizons
from jaxsr.models import Simulator
from jaxsr.models.least_squares import Fit
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import cut
from jaxsr.models.shooting import simulate

if TYPE_CHECKING:
    from jaxsr.diagnosis.diagnose import Case

MAX_SAMPLES = 1000
"""Longest segment of the contest, in samples."""
MANY_SEGMENTS, MANY_WITH_JUMPS = 4, 20
"""Segments from which the work is shared; where friction sticks and slides, short segments keep
an estimate from being caught among the many orders in which it can."""
SMALL, SATURATED = 0.1, 1.3
"""Error of re-calibration that is small, and its growth that counts as none."""


def usable_starts(
    case: Case,
    super_model: SuperModel,
    stepping: Stepping,
    scale: np.ndarray,
    simulator: Simulator,
    starts: list[Start],
) -> list[Start]:
    """Start from the given free parameters where those of the weak view simulate worse.

    Without the missing physics the weak view can ask for impossible values, such as a mass
    matrix that is not positive.
    """
    shortest = horizons(case.prepared)[0]
    arena = build_arena(super_model, case.prepared, stepping, shortest, scale, simulator)
    base, neutral = super_model.base_index(), neutral_values(super_model)
    better: list[Start] = []
    for members, start in starts:
        given = start.copy()
        given[base] = neutral[base]
        costs = []
        for theta in (start, given):
            own = reduce(arena.problem, super_model, members)
            y = simulate(own.problem, theta[own.parameters], own.problem.segments.guess)
            with np.errstate(all="ignore"):
                cost = float(np.sum(arena.problem.residual(y) ** 2))
            costs.append(cost if np.isfinite(cost) else np.inf)
        better.append((members, start if costs[0] <= costs[1] else given))
    # Re-calibrated over the shortest horizon, the given structure tells how its errors grow.
    calibrated = enter(arena, (), better[0][1]).fit
    if calibrated.usable:
        better[0] = ((), calibrated.theta)
    return better


def first_usable(
    case: Case,
    super_model: SuperModel,
    stepping: Stepping,
    lengths: list[float],
    scale: np.ndarray,
    simulator: Simulator,
    start: np.ndarray,
) -> Arena:
    """Take the longest segments over which the re-calibrated model can be simulated."""
    for seconds in lengths:
        arena = build_arena(super_model, case.prepared, stepping, seconds, scale, simulator)
        if enter(arena, (), start, max_iterations=4).fit.usable:
            break
    return arena


def headline_horizon(
    case: Case,
    super_model: SuperModel,
    stepping: Stepping,
    scale: np.ndarray,
    simulator: Simulator,
    starts: list[Start],
) -> tuple[float, list[float]]:
    """Choose the horizon the verdict rests on, and segment lengths for the contest, in seconds.

    The longest horizon up to which the re-calibrated model's error stays small, or no longer
    grows: errors of a drifting, unstable or chaotic system grow with the horizon, and judging
    it by its full length compares how errors happen to add up. Starts are estimated on the whole
    segment, so that noise of the first readings does not count as an error that grows.
    """
    options = horizons(case.prepared)
    step = float(np.median([p.recording.sample_time for p in case.prepared]))
    fitting = [h for h in options if h / step <= MAX_SAMPLES] or options[:1]
    headline, previous, theta = options[0], None, starts[0][1]
    for horizon in options:
        if horizon in fitting:
            arena = build_arena(super_model, case.prepared, stepping, horizon, scale, simulator)
            fitted = enter(arena, (), theta, max_iterations=8).fit
            theta = fitted.theta if fitted.usable else theta
            score = _relative_error(arena, fitted) if fitted.usable else np.inf
        else:
            whole = lean(super_model, simulator, stepping, ())
            score = whole.free_run(case.prepared, theta, horizon).nrmse
        if previous is not None and not (score <= SMALL or score <= SATURATED * previous):
            break
        headline, previous = horizon, score
    fitting = [h for h in fitting if h <= headline]
    jumps = any(super_model.candidates[i].sharp for members, _ in starts[:2] for i in members)
    jumps |= bool(Simulator(super_model.given).smoothed_arguments)
    least = MANY_WITH_JUMPS if jumps else MANY_SEGMENTS
    many = [h for h in fitting if len(cut(case.prepared, h)) >= least]
    return headline, sorted(many or fitting, reverse=True)


def _relative_error(arena: Arena, fitted: Fit) -> float:
    """Root mean square residual over the outputs' standard deviations."""
    used = max(float(arena.problem.segments.weights.sum()), 1.0)
    return 0.01 * float(np.sqrt(fitted.cost / used))
