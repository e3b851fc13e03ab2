"""Multiple shooting: parameters and the starts of all segments estimated together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.models.arrow import levenberg_step, products, schur
from jaxsr.models.lifting import Linear, closed, liftable, linear, simulated
from jaxsr.models.relaxed import relaxed
from jaxsr.models.rollout import Stepping, linearise, outputs
from jaxsr.models.segments import Segments
from jaxsr.models.simulator import Simulator

MAX_ITERATIONS = 25
RELATIVE_GAIN = 1e-5
"""Gain in cost below which an estimation has converged."""

CLOSED = 1e-4
"""Share of the cost up to which the gap of a path to a simulation does not matter."""
ROUNDING = (100.0, 10.0)
"""Widths of rounded steps, in those of the final estimate."""
POLISHING = 12
ROUGH = 1e-2
ROUGH_ITERATIONS = 8
"""Where the estimation with rounded steps ends: it only has to lead near."""
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
            if problem.stepping.widths and active.size and max_iterations > ROUGH_ITERATIONS:
                if path is None or not near:
                    theta, x0, path = search.rounded(theta, x0, path, stop)
                found = search.run(theta, x0, path, ROUGH_ITERATIONS, stop)
                return search.polished(found, stop)
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
    closing: bool = False

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
        best = self._closed(best)
        return best.fit if best.closed else replace(best.fit, cost=np.inf)

    def polished(self, found: Fit, stop: Callable[[], bool]) -> Fit:
        """Lower the cost of simulations: every trial is closed before it is judged."""
        if not np.isfinite(found.cost) or found.path is None:
            return found
        best, damping = self.at(found.theta, found.path), 1e-3
        closing = replace(self, closing=True)
        for _ in range(POLISHING):
            if stop():
                break
            trial, damping = closing._improved(best, damping)
            if trial is None:
                return replace(best.fit, converged=True)
            gain = (best.fit.cost - trial.fit.cost) / max(best.fit.cost, 1e-300)
            best, damping = trial, max(damping / 8.0, 1e-12)
            if gain < self.tolerance:
                return replace(best.fit, converged=True)
        return best.fit

    def rounded(
        self,
        theta: np.ndarray,
        x0: np.ndarray | None,
        path: np.ndarray | None,
        stop: Callable[[], bool],
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """Estimate with steps in sign() and the like rounded, less and less.

        Which samples stick and which slide changes by jumps while a sharp law moves; a rounded
        one leads there smoothly (continuation).
        """
        stepping = self.problem.stepping
        for factor in ROUNDING:
            widths = tuple(factor * w for w in stepping.widths)
            problem = replace(self.problem, stepping=replace(stepping, widths=widths))
            search = replace(self, problem=problem, tolerance=ROUGH)
            found = search.run(theta, x0, path, ROUGH_ITERATIONS, stop)
            if found.usable and found.path is not None:
                theta, x0, path = found.theta, None, found.path
        return theta, x0, path

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
            other = attempt(relaxed(*self.setting, theta, problem.scale))
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
            path = best.linear.moved(share * starts, share * moved, share)
            if self.closing:  # trials are simulations
                own = closed(*self.setting, theta, path)
                path = path if own is None else own
            trial = self.at(theta, path)
            better = trial.fit.cost < best.fit.cost
            if trial.fit.usable and (better or (not best.closed and trial.gap < best.gap)):
                return trial, damping
            damping *= 6.0
            if not best.closed:
                share *= 0.5
        return None, damping

    def _closed(self, best: Attempt) -> Attempt:
        """Close what is left of the gap; a path that does not close is no simulation."""
        if best.closed or not best.fit.usable:
            return best
        path = closed(*self.setting, best.fit.theta, best.fit.path)
        return best if path is None else self.at(best.fit.theta, path)

    @property
    def setting(self) -> tuple[Simulator, Stepping, Segments]:
        """What integrates, how, and along which segments."""
        return self.problem.simulator, self.problem.stepping, self.problem.segments


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
