"""Multiple shooting: parameters and the starts of all segments estimated together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.models.arrow import levenberg_step, products, schur
from jaxsr.models.lifting import Linear, liftable, linear, simulated
from jaxsr.models.relaxed import relaxed
from jaxsr.models.rollout import Stepping, linearise, outputs
from jaxsr.models.segments import Segments
from jaxsr.models.simulator import Simulator

MAX_ITERATIONS = 25
RELATIVE_GAIN = 1e-5
"""Gain in cost below which an estimation has converged."""

CLOSED = 1e-4
"""Share of the cost up to which the gap of a path to a simulation does not matter."""
CLOSING = 6
FAR = 0.5
"""Gap, in standard deviations of the readings, from which a first path is smoothed."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Segments to be reproduced by a simulator.

    Attributes
    ----------
    scale : ndarray, shape (outputs,)
        Residuals are divided by it, so that outputs of different units add up.
    """

    simulator: Simulator
    stepping: Stepping
    segments: Segments
    scale: np.ndarray

    def residual(self, y: np.ndarray) -> np.ndarray:
        """Return (measured - y) / scale, zero where nothing was measured."""
        difference = (self.segments.outputs - y) / self.scale[:, None, None]
        return np.where(np.isfinite(self.segments.outputs), difference, 0.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares estimate and its linearisation.

    Attributes
    ----------
    theta : ndarray, shape (parameters,)
        All parameters of the model; those not in `active` as given.
    x0 : ndarray, shape (states, segments)
    cost : float
        Sum of squared scaled residuals.
    residual : ndarray, shape (outputs, samples, segments)
    active : ndarray of int
        Parameters that were estimated.
    jacobian : ndarray, shape (active, outputs, samples, segments)
        Derivative of the simulated outputs, divided by scale.
    by_start : ndarray, shape (states, outputs, samples, segments)
    converged : bool
    path : ndarray, shape (states, samples, segments), optional
        States along the segments, where the estimation knows them.
    """

    theta: np.ndarray
    x0: np.ndarray
    cost: float
    residual: np.ndarray
    active: np.ndarray
    jacobian: np.ndarray
    by_start: np.ndarray
    converged: bool
    path: np.ndarray | None = None

    @property
    def usable(self) -> bool:
        """Whether the derivatives are numbers; at an unstable point they overflow."""
        largest = max(
            np.abs(self.jacobian).max(initial=0.0), np.abs(self.by_start).max(initial=0.0)
        )
        return bool(np.isfinite(largest) and largest < 1e60 and np.isfinite(self.cost))

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Per segment: the starts projected out of J^T J and J^T r.

        Returns
        -------
        hessian : ndarray, shape (segments, active, active)
        gradient : ndarray, shape (segments, active)
        """
        blocks = products(self.residual, self.jacobian, self.by_start)
        return schur(*blocks, damping=0.0)[:2]


def simulate(problem: Problem, theta: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """Return the readings of all segments from their starts, shape (outputs, samples, segments)."""
    arguments = problem.simulator, problem.stepping, problem.segments, theta, x0
    found = simulated(*arguments) if liftable(problem.simulator) else None
    return outputs(*arguments) if found is None else found


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
    stop : callable
        Asked between iterations.

    Returns
    -------
    Fit
    """
    with np.errstate(all="ignore"):
        if liftable(problem.simulator):
            search = Search(problem, np.asarray(active, dtype=int), bounds, tolerance)
            return search.run(theta, x0, path, max_iterations, stop)
        # A trial far off may overflow; its cost is then infinite and it is turned down.
        return _levenberg_marquardt(
            problem, theta, active, bounds, x0, max_iterations, stop, tolerance
        )


@dataclass(frozen=True, eq=False)
class Search:
    """Levenberg-Marquardt over paths: the simulation closes while the parameters move."""

    problem: Problem
    active: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    tolerance: float

    def run(
        self,
        theta: np.ndarray,
        x0: np.ndarray | None,
        path: np.ndarray | None,
        max_iterations: int,
        stop: Callable[[], bool],
    ) -> Fit:
        """Estimate from parameters and, if known, starts or a whole path."""
        low, high = self.bounds
        theta = np.array(theta, dtype=float)
        theta[self.active] = np.clip(theta[self.active], low[self.active], high[self.active])
        best = self._begun(theta, x0, path)
        damping = 1e-3
        for _ in range(max_iterations):
            if stop() or not best.fit.usable:
                break
            trial, damping = self._improved(best, damping)
            if trial is None:
                best = replace(best, fit=replace(best.fit, converged=True))
                break
            gain = (best.fit.cost - trial.fit.cost) / max(best.fit.cost, 1e-300)
            settled = best.closed and trial.closed and abs(gain) < self.tolerance
            best, damping = trial, max(damping / 8.0, 1e-12)
            if settled:
                best = replace(best, fit=replace(best.fit, converged=True))
                break
        return self._closed(best)

    def _begun(self, theta: np.ndarray, x0: np.ndarray | None, path: np.ndarray | None) -> Attempt:
        """Linearise about the first of several paths along which the model is finite."""
        problem, segments = self.problem, self.problem.segments

        def attempt(option: np.ndarray) -> Attempt:
            start = np.array(option)
            if x0 is not None:
                start[:, 0] = x0
            return self.at(theta, start)

        best = attempt(segments.course if path is None else path)
        far = best.gap > float(segments.weights.sum()) * FAR**2 * np.var(
            np.nan_to_num(segments.outputs) / problem.scale[:, None, None]
        )
        driven = bool(problem.simulator.model.driven)
        if path is None and ((far and not driven) or not best.fit.usable):
            # The sensors tell too little, or one step differs too much from the next.
            setting = (problem.simulator, problem.stepping, segments)
            other = attempt(relaxed(*setting, theta, problem.scale))
            if other.fit.usable and (not best.fit.usable or other.fit.cost < best.fit.cost):
                return other
        return best

    def at(self, theta: np.ndarray, path: np.ndarray) -> Attempt:
        """Linearise about a path."""
        problem = self.problem
        found = linear(
            problem.simulator, problem.stepping, problem.segments, theta, path, self.active
        )
        fitted = _weighed(
            problem, theta, path[:, 0], self.active, (found.outputs, found.by_theta, found.by_start)
        )
        gap = float(
            np.sum(problem.segments.weights * (found.gap / problem.scale[:, None, None]) ** 2)
        )
        closed = gap <= CLOSED * fitted.cost or gap < 1e-20
        return Attempt(replace(fitted, path=path), found, closed, gap)

    def _improved(self, best: Attempt, damping: float) -> tuple[Attempt | None, float]:
        """Take a step that lowers the cost, or that closes the simulation."""
        low, high = self.bounds
        share = 1.0
        for _ in range(8):
            step, starts = levenberg_step(best.fit, damping, low, high)
            theta = best.fit.theta.copy()
            theta[self.active] = np.clip(
                theta[self.active] + step, low[self.active], high[self.active]
            )
            moved = theta[self.active] - best.fit.theta[self.active]
            trial = self.at(theta, best.linear.moved(share * starts, share * moved, share))
            better = trial.fit.cost < best.fit.cost
            if trial.fit.usable and (better or (not best.closed and trial.gap < best.gap)):
                return trial, damping
            damping *= 6.0
            if not best.closed:
                share *= 0.5
        return None, damping

    def _closed(self, best: Attempt) -> Fit:
        """Close what is left of the gap; a path that does not close is no simulation."""
        for _ in range(CLOSING):
            if best.closed or not best.fit.usable:
                break
            none = np.zeros(self.active.size)
            zero = np.zeros_like(best.fit.x0)
            best = self.at(best.fit.theta, best.linear.moved(zero, none))
        return best.fit if best.closed else replace(best.fit, cost=np.inf)


@dataclass(frozen=True, eq=False)
class Attempt:
    """A linearisation about a path, and whether the path is a simulation."""

    fit: Fit
    linear: Linear
    closed: bool
    gap: float


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
            cost = _cost(problem.residual(_simulate(problem, trial_theta, trial_x0, active)))
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


def _cost(residual: np.ndarray) -> float:
    cost = float(np.sum(residual**2))
    return cost if np.isfinite(cost) else np.inf


def _linearised(problem: Problem, theta: np.ndarray, x0: np.ndarray, active: np.ndarray) -> Fit:
    y, by_theta, by_start = linearise(
        problem.simulator, problem.stepping, problem.segments, theta, x0, active
    )
    return _weighed(problem, theta, x0, active, (y, by_theta, by_start))


def _weighed(
    problem: Problem,
    theta: np.ndarray,
    x0: np.ndarray,
    active: np.ndarray,
    outputs: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> Fit:
    """Divide readings and their derivatives by the outputs' scales."""
    y, by_theta, by_start = outputs
    weight = problem.segments.weights / problem.scale[:, None, None]
    residual = problem.residual(y)
    free = problem.segments.free_start[:, None, None, :]
    return Fit(
        theta=theta,
        x0=x0,
        cost=_cost(residual),
        residual=residual,
        active=np.asarray(active, dtype=int),
        jacobian=np.where(weight > 0.0, by_theta * weight, 0.0),
        by_start=np.where(free & (weight > 0.0), by_start * weight, 0.0),
        converged=False,
    )
