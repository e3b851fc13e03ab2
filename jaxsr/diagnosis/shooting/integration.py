"""How finely segments are integrated: the fewest steps whose error stays below the mismatch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxsr._deadline import ask
from jaxsr.diagnosis.shooting.reduced import restepped
from jaxsr.models.driven import known_states
from jaxsr.models.field import Field, Point
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import carried_errors, readings_along
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments
from jaxsr.models.simulator import Simulator, width_scales
from jaxsr.models.states import spread

STEP_ERROR = 1e-3
"""Integration error allowed over 400 samples, in standard deviations of an output."""
STABLE = 2.5
"""Product of step and fastest rate up to which RK4 is stable (its limit is 2.78)."""
MOST_SUBSTEPS = 4
"""From here on an implicit step is the cheaper one."""
TOLERABLE = 0.1
"""Integration error of a set, relative to what it leaves unexplained."""
FINEST = {"rk4": 8, "rodas3": 2}
"""Substeps up to which that is held to."""
POINTS = 200
TRIAL = 400


def choose_stepping(
    simulator: Simulator, prepared: Sequence[Prepared], theta: np.ndarray
) -> Stepping:
    """Choose method and substeps so that the integration error stays far below the mismatch.

    Steep friction is resolved by substeps up to `MOST_SUBSTEPS`; stiffer models go to the
    L-stable method. Two runs, one with four times the substeps, tell the error, and the
    method's order how it falls.
    """
    x, u, widths = _samples(simulator, prepared, theta)
    fastest = _fastest(simulator, theta, widths, x, u)
    step = min(p.recording.sample_time for p in prepared)
    needed = _substeps(fastest * step)
    if needed > MOST_SUBSTEPS:
        return Stepping("rodas3", 2, widths)
    method, order = "rk4", 4
    change = _change(
        simulator, prepared, theta, *(Stepping(method, n, widths) for n in (needed, 4 * needed))
    )
    if not np.isfinite(change):
        return Stepping("rodas3", 4, widths)
    # The error falls with the method's order: the fewest substeps that leave STEP_ERROR.
    for factor in (1, 2, 4):
        if change / factor**order < STEP_ERROR:
            return Stepping(method, factor * needed, widths)
    return Stepping(method, 4 * needed, widths)


def with_smooth(
    stepping: Stepping, given: Simulator, prepared: Sequence[Prepared], theta: np.ndarray
) -> Stepping:
    """Add how sets without jumps are stepped, where the given model has none."""
    if not stepping.widths or given.smoothed_arguments:
        return stepping
    smooth = choose_stepping(given, prepared, theta)
    dearer = smooth.method == "rodas3" or stepping.substeps % smooth.substeps > 0
    same = (smooth.method, smooth.substeps) == (stepping.method, stepping.substeps)
    return stepping if dearer or same else replace(stepping, smooth=smooth)


def steady(problem: Problem, theta: np.ndarray) -> Problem:
    """Return the problem of a set, stepped stably with these constants, explicitly if it can be."""
    stepping, needed = problem.stepping, stable_substeps(problem, theta)
    if needed <= FINEST["rk4"]:
        least = stepping.substeps if stepping.method == "rk4" else 1
        return with_steps(problem, "rk4", max(needed, least))
    return problem if stepping.method == "rodas3" else with_steps(problem, "rodas3", 2)


def stable_substeps(problem: Problem, theta: np.ndarray) -> int:
    """Return the fewest explicit steps between two samples, a power of two, that are stable."""
    stepping, segments = problem.stepping, problem.segments
    inside = np.arange(segments.time.shape[0])[:, None] < segments.count
    pick = np.linspace(0, inside.sum() - 1, min(POINTS, inside.sum())).astype(int)
    x, u = (np.moveaxis(a, 0, -1)[inside][pick] for a in (segments.course, segments.inputs))
    x, u = np.concatenate([x, np.zeros((1, x.shape[1]))]), np.concatenate([u, u[:1]])
    fastest = _fastest(problem.simulator, theta, stepping.widths, x, u)
    return _substeps(fastest * float(np.max(segments.length)) * stepping.substeps)


def accurate(problem: Problem, theta: np.ndarray, path: np.ndarray) -> Problem:
    """Return the problem stepped so finely that errors along a path leave its fit alone.

    A step across a jump has an error of first order, whatever the method. Those of four times as
    many steps are left out of account.
    """
    stepping, most = problem.stepping, FINEST[problem.stepping.method]
    if stepping.substeps >= most:
        return problem
    fine = with_steps(problem, stepping.method, 4 * stepping.substeps)
    with np.errstate(all="ignore"):
        apart, left = led_apart(problem, fine, theta, path)
        ratio = np.sqrt(np.sum(apart**2) / (np.sum(left**2) + 1e-300)) / TOLERABLE
    if not np.isfinite(ratio) or ratio <= 1.0:
        return problem
    factor = int(2 ** np.ceil(np.log2(min(ratio, most))))
    return with_steps(problem, stepping.method, min(factor * stepping.substeps, most))


def led_apart(
    problem: Problem, other: Problem, theta: np.ndarray, path: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far another way to integrate leads away in the readings, and the residuals.

    Both are divided by the outputs' scales, shape (outputs, samples, segments).
    """
    setting = (problem.stepping, problem.segments), (other.stepping, other.segments)
    apart = carried_errors(problem.simulator, *setting, theta, path)
    apart = problem.segments.weights * apart / problem.scale[:, None, None]
    y, _ = readings_along(problem.simulator, *setting[0], theta, path)
    return apart, problem.residual(y)


def with_steps(problem: Problem, method: str, substeps: int) -> Problem:
    """Return a problem with another method and number of steps between samples."""
    stepping = replace(problem.stepping, method=method, substeps=substeps)
    segments = restepped(problem.segments, stepping, problem.stepping)
    return replace(problem, stepping=stepping, segments=segments)


def _samples(
    simulator: Simulator, prepared: Sequence[Prepared], theta: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple]:
    """Return states and inputs at some samples, and the widths of jumps by all of them."""
    x = np.concatenate([known_states(simulator.model, p, theta, simulator) for p in prepared])
    u = np.concatenate([p.inputs for p in prepared])
    widths = width_scales(
        simulator, simulator.environment(0.0, tuple(x.T), tuple(u.T), tuple(theta))
    )
    pick = np.linspace(0, len(x) - 1, min(POINTS, len(x))).astype(int)
    # The steepest place of friction is standstill: look there as well.
    at = np.concatenate([x[pick], np.zeros((1, x.shape[1]))])
    return at, np.concatenate([u[pick], u[:1]]), widths


def _substeps(product: float) -> int:
    """Powers of two that bring a product of step and fastest rate into RK4's stable range."""
    return int(2 ** np.ceil(np.log2(max(product / STABLE, 1.0))))


def _fastest(
    simulator: Simulator, theta: np.ndarray, widths: tuple, x: np.ndarray, u: np.ndarray
) -> float:
    """Largest eigenvalue of the Jacobian over samples."""
    ask()
    count = x.shape[1]
    jacobian = np.zeros((len(x), count, count))
    field = Field(simulator, [float(v) for v in theta], widths)
    with np.errstate(all="ignore"):
        _, rows = field.slopes(Point(0.0, list(x.T), list(u.T)))
    for i, row in enumerate(rows):
        for j, state in enumerate(simulator.model.states):
            jacobian[:, i, j] = row.get(state, 0.0)
    jacobian = jacobian[np.isfinite(jacobian).all((1, 2))]
    return float(np.abs(np.linalg.eigvals(jacobian)).max()) if jacobian.size else 0.0


def _change(
    simulator: Simulator,
    prepared: Sequence[Prepared],
    theta: np.ndarray,
    coarse: Stepping,
    fine: Stepping,
) -> float:
    """Largest difference of two ways to integrate, in standard deviations of an output."""
    item = prepared[0]
    rows = [(0, 0, min(len(item.time), TRIAL))]
    deviation = spread(item.outputs)

    def segments(stepping: Stepping) -> Segments:
        return build_segments(simulator.model, prepared, rows, stepping.substeps)

    with np.errstate(all="ignore"):
        first, second = (coarse, segments(coarse)), (fine, segments(fine))
        difference = carried_errors(simulator, first, second, theta, first[1].course)
        return float(np.max(np.abs(difference).max(axis=(1, 2)) / deviation))
