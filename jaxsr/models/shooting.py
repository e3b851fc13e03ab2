"""Multiple shooting: parameters and the starts of all segments estimated together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxsr.models.least_squares import Fit, Problem, squares, weighed
from jaxsr.models.levenberg import levenberg_step
from jaxsr.models.lifting import liftable, simulated
from jaxsr.models.paths import Search
from jaxsr.models.rollout import linearise, outputs

MAX_ITERATIONS = 25
RELATIVE_GAIN = 1e-5
"""Gain in cost below which an estimation has converged."""


def simulate(
    problem: Problem,
    theta: np.ndarray,
    x0: np.ndarray,
    stop: Callable[[], bool] = lambda: False,
) -> np.ndarray:
    """Return the readings of all segments from their starts, shape (outputs, samples, segments).

    NaN where `stop` said so before they ended.
    """
    arguments = problem.simulator, problem.stepping, problem.segments, theta, x0
    found = simulated(*arguments, stop) if liftable(problem.simulator) else None
    if found is not None:
        return found
    if stop():
        return np.full_like(problem.segments.outputs, np.nan)
    return outputs(*arguments)


def linearise_fit(problem: Problem, result: Fit, active: np.ndarray) -> Fit:
    """Return a fit with its derivatives by other parameters."""
    with np.errstate(all="ignore"):
        if result.path is not None:
            search = Search(problem, active, (result.theta, result.theta), RELATIVE_GAIN)
            return search.at(result.theta, result.path).fit
        return _linearised(problem, result.theta, result.x0, active)


def fit(
    problem: Problem,
    theta: np.ndarray,
    active: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    x0: np.ndarray | None = None,
    max_iterations: int = MAX_ITERATIONS,
    stop: Callable[[], bool] = lambda: False,
    tolerance: float = RELATIVE_GAIN,
    path: np.ndarray | None = None,
    near: bool = False,
) -> Fit:
    """Minimise the squared residuals over parameters and segment starts.

    Levenberg-Marquardt; each segment's start is eliminated by its own small Schur complement,
    so that the cost grows linearly with the number of segments. Parameters stay inside
    `bounds` (two arrays over all parameters): a parameter that would leave is held there.

    Parameters
    ----------
    problem : Problem
    theta : ndarray, shape (parameters,)
    active : ndarray of int
        Indices of the parameters to estimate; may be empty.
    x0 : ndarray, shape (states, segments), optional
        Where the starts begin; from the sensors by default.
    path : ndarray, shape (states, samples, segments), optional
        States along the segments to begin from, of an earlier fit; used where the model consists
        of formulas, whose segments are estimated lifted (`lifting`).
    near : bool
        Whether the path is near the best one already, so that sharp laws need no rounding.
    stop : callable
        Asked between iterations.

    Returns
    -------
    Fit
    """
    with np.errstate(all="ignore"):
        if liftable(problem.simulator):
            search = Search(problem, np.asarray(active, dtype=int), bounds, tolerance)
            return search.estimate(theta, x0, path, max_iterations, stop, near)
        # A trial far off may overflow; its cost is then infinite and it is turned down.
        return _levenberg_marquardt(
            problem, theta, active, bounds, x0, max_iterations, stop, tolerance
        )


def _levenberg_marquardt(
    problem: Problem,
    theta: np.ndarray,
    active: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    x0: np.ndarray | None,
    max_iterations: int,
    stop: Callable[[], bool],
    tolerance: float,
) -> Fit:
    low, high = bounds
    theta = np.array(theta, dtype=float)
    theta[active] = np.clip(theta[active], low[active], high[active])
    x0 = np.array(problem.segments.guess if x0 is None else x0, dtype=float)
    damping, best = 1e-3, _linearised(problem, theta, x0, active)
    for _ in range(max_iterations):
        if stop() or not np.isfinite(best.cost) or not best.usable:
            break
        improved = False
        for _ in range(8):
            step_theta, step_x0 = levenberg_step(best, damping, low, high)
            trial_theta = best.theta.copy()
            trial_theta[active] = np.clip(
                best.theta[active] + step_theta, low[active], high[active]
            )
            trial_x0 = best.x0 + step_x0
            cost = squares(problem.residual(_simulate(problem, trial_theta, trial_x0, active)))
            if cost < best.cost:
                improved = True
                break
            damping *= 6.0
        if not improved:
            best = replace(best, converged=True)
            break
        gain = (best.cost - cost) / max(best.cost, 1e-300)
        linearised = _linearised(problem, trial_theta, trial_x0, active)
        if not linearised.usable:
            best = replace(best, converged=False)
            break
        best = linearised
        damping = max(damping / 8.0, 1e-12)
        if gain < tolerance:
            best = replace(best, converged=True)
            break
    return best


def _simulate(
    problem: Problem, theta: np.ndarray, x0: np.ndarray, active: np.ndarray
) -> np.ndarray:
    """Simulate; with starts alone to estimate, through the program that also differentiates."""
    arguments = problem.simulator, problem.stepping, problem.segments, theta, x0
    return outputs(*arguments) if active.size else linearise(*arguments, active)[0]


def _linearised(problem: Problem, theta: np.ndarray, x0: np.ndarray, active: np.ndarray) -> Fit:
    y, by_theta, by_start = linearise(
        problem.simulator, problem.stepping, problem.segments, theta, x0, active
    )
    return weighed(problem, theta, x0, active, (y, by_theta, by_start))
