"""Estimation over whole paths: the simulation closes while the parameters move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from jaxsr._progress import Budget
from jaxsr.models.least_squares import Fit, Problem, weighed
from jaxsr.models.levenberg import levenberg_step
from jaxsr.models.lifting import Linear, closed, linear
from jaxsr.models.relaxed import relaxed
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Segments
from jaxsr.models.simulator import Simulator

CLOSED = 1e-4
"""Share of the cost up to which the gap of a path to a simulation does not matter."""
ROUNDING = (25.0, 5.0)
"""Widths of rounded steps, in those of the final estimate."""
POLISHING = 5
ROUGH = 1e-2
ROUGH_ITERATIONS = 8
"""Where the estimation with rounded steps ends: it only has to lead near."""
GRACE = 2.0
"""Seconds in which an estimation that was stopped may still close its simulation."""
FAR, LOST = 0.5, 100.0
"""Gaps, in standard deviations of the readings, from which a first path is smoothed, and from which
no simulation is sought near a path any more."""


@dataclass(frozen=True, eq=False)
class Search:
    """Levenberg-Marquardt over paths: the simulation closes while the parameters move."""

    problem: Problem
    active: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    tolerance: float
    closing: bool = False

    def estimate(
        self,
        theta: np.ndarray,
        x0: np.ndarray | None,
        path: np.ndarray | None,
        max_iterations: int,
        stop: Callable[[], bool],
        near: bool = False,
    ) -> Fit:
        """Estimate; where laws jump, by way of rounded ones unless the path is `near`."""
        sharp = self.problem.stepping.widths and self.active.size
        if not sharp or max_iterations <= ROUGH_ITERATIONS:
            return self.run(theta, x0, path, max_iterations, stop)
        if path is None or not near:
            theta, x0, path = self.rounded(theta, x0, path, stop)
        found = self.run(theta, x0, path, ROUGH_ITERATIONS, stop)
        return found if found.converged else self.polished(found, stop)

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
        if self.problem.simulator.model.events and not self.closing:
            return replace(self, closing=True).run(theta, x0, path, max_iterations, stop)
        best = self._begun(theta, x0, path)
        damping = 1e-3
        for _ in range(max_iterations):
            if stop() or not best.fit.usable:
                break
            trial, damping = self._improved(best, damping, stop)
            if trial is None:
                best = replace(best, fit=replace(best.fit, converged=not stop()))
                break
            gain = (best.fit.cost - trial.fit.cost) / max(best.fit.cost, 1e-300)
            settled = best.closed and trial.closed and abs(gain) < self.tolerance
            best, damping = trial, max(damping / 8.0, 1e-12)
            if settled:
                best = replace(best, fit=replace(best.fit, converged=True))
                break
        best = self._closed(best, stop)
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
            trial, damping = closing._improved(best, damping, stop)
            if trial is None:
                return replace(best.fit, converged=not stop())
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
        segments = self.problem.segments

        def attempt(option: np.ndarray) -> Attempt:
            start = np.array(option)
            if x0 is not None:
                start[:, 0] = x0
            # A path through the sensors may begin elsewhere than the model says it must.
            start[:, 0] = np.where(segments.free_start, start[:, 0], segments.guess)
            return self.at(theta, start)

        if self.problem.simulator.model.events:
            return self.at(theta, self._simulated(theta, x0, path))
        best = attempt(segments.course if path is None else path)
        far = best.gap > FAR**2 * self.variation
        driven = bool(self.problem.simulator.model.driven)
        if path is None and ((far and not driven) or not best.fit.usable):
            # The sensors tell too little, or one step differs too much from the next.
            other = attempt(relaxed(*self.setting, theta, self.problem.scale))
            if other.fit.usable and (not best.fit.usable or other.fit.cost < best.fit.cost):
                return other
        return best

    def _simulated(
        self, theta: np.ndarray, x0: np.ndarray | None, path: np.ndarray | None
    ) -> np.ndarray:
        """Return a simulation from known starts, or a path that diverges as it is."""
        start = np.array(self.problem.segments.course if path is None else path)
        if x0 is not None:
            start[:, 0] = x0
        found = closed(*self.setting, theta, start)
        return start if found is None else found

    def at(self, theta: np.ndarray, path: np.ndarray) -> Attempt:
        """Linearise about a path."""
        problem = self.problem
        found = linear(
            problem.simulator, problem.stepping, problem.segments, theta, path, self.active
        )
        by_theta = found.by_theta
        if problem.following is not None:
            by_theta = by_theta + np.einsum(
                "koms,kjs->joms", found.by_start, problem.following[:, self.active]
            )
        fitted = weighed(
            problem, theta, path[:, 0], self.active, (found.outputs, by_theta, found.by_start)
        )
        gap = float(
            np.sum(problem.segments.weights * (found.gap / problem.scale[:, None, None]) ** 2)
        )
        closed = gap <= CLOSED * fitted.cost or gap < 1e-20
        return Attempt(replace(fitted, path=path), found, closed, gap)

    def _improved(
        self, best: Attempt, damping: float, stop: Callable[[], bool]
    ) -> tuple[Attempt | None, float]:
        """Take a step that lowers the cost, or that closes the simulation."""
        (low, high), share = self.bounds, 1.0
        for _ in range(3 if self.closing else 8):
            if stop():
                break
            step, starts = self._step(best, damping)
            theta = best.fit.theta.copy()
            theta[self.active] = np.clip(
                theta[self.active] + step, low[self.active], high[self.active]
            )
            moved = theta[self.active] - best.fit.theta[self.active]
            if self.problem.following is not None:
                starts = starts + np.einsum(
                    "kjs,j->ks", self.problem.following[:, self.active], moved
                )
            path = best.linear.moved(share * starts, share * moved, share)
            if self.closing:  # trials are simulations
                own = closed(*self.setting, theta, path, stop)
                if own is None and stop():
                    break
                path = path if own is None else own
            trial = self.at(theta, path)
            better = trial.fit.cost < best.fit.cost
            if trial.fit.usable and (better or (not best.closed and trial.gap < best.gap)):
                return trial, damping
            damping *= 6.0
            if not best.closed:
                share *= 0.5
        return None, damping

    def _step(self, best: Attempt, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """Return steps of the active parameters and of the starts."""
        fit_, carried = best.fit, self.problem.carried
        if carried is None:
            return levenberg_step(fit_, damping, *self.bounds)
        # What segments have in common is one more parameter each, without bounds.
        alone = np.logical_not(np.any(carried, axis=1))[:, None, None, :]
        weight = self.problem.segments.weights / self.problem.scale[:, None, None]
        common = np.einsum("koms,kcs->coms", best.linear.by_start, carried) * weight
        places = len(fit_.theta) + np.arange(len(common))
        whole = replace(
            fit_,
            theta=np.concatenate([fit_.theta, np.zeros(len(common))]),
            active=np.concatenate([fit_.active, places]),
            jacobian=np.concatenate([fit_.jacobian, np.where(weight > 0.0, common, 0.0)]),
            by_start=np.where(alone, fit_.by_start, 0.0),
        )
        far = np.full(len(common), np.inf)
        (low, high), count = self.bounds, fit_.active.size
        bounds = np.concatenate([low, -far]), np.concatenate([high, far])
        step, starts = levenberg_step(whole, damping, *bounds)
        return step[:count], starts + np.einsum("kcs,c->ks", carried, step[count:])

    def _closed(self, best: Attempt, stop: Callable[[], bool]) -> Attempt:
        """Close what is left of the gap; a path that does not close is no simulation."""
        if best.closed or not best.fit.usable or best.gap > LOST**2 * self.variation:
            return best
        grace = Budget(GRACE)
        theta, path = best.fit.theta, best.fit.path
        path = closed(*self.setting, theta, path, lambda: stop() and grace.exhausted)
        return best if path is None else self.at(best.fit.theta, path)

    @cached_property
    def variation(self) -> float:
        """Sum of squares of readings that are off by a standard deviation."""
        segments = self.problem.segments
        scaled = np.nan_to_num(segments.outputs) / self.problem.scale[:, None, None]
        return float(segments.weights.sum()) * float(np.var(scaled))

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
