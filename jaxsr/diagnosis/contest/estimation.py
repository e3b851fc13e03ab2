"""Estimation of one set in free run: first where it stands, then with widths and finer steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.integration import accurate, steady
from jaxsr.diagnosis.contest.reduced import Reduced
from jaxsr.diagnosis.contest.widths import Jumps, fitted_widths
from jaxsr.models.driven import driven_states
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.shooting import fit

CONTEST_TOLERANCE = 1e-4
"""Gain in cost at which the estimation of a set stops: far below `MIN_GAIN`."""


@dataclass(frozen=True)
class Estimation:
    """Within which bounds one set is estimated, which parameters move, and when it ends."""

    arena: Arena
    bounds: tuple[np.ndarray, np.ndarray]
    active: np.ndarray
    stopped: Callable[[], bool]
    max_iterations: int

    def __call__(
        self, own: Reduced, theta: np.ndarray, path: np.ndarray | None, near: bool = True
    ) -> Fit:
        """Estimate from `theta`, the states sought along `path`."""
        x0, limits = None, (self.max_iterations, self.stopped, CONTEST_TOLERANCE)
        problem = own.problem
        if problem.simulator.model.driven:
            start = None if path is None else path[:, 0]
            problem, x0 = _driven(self.arena, problem, theta, self.active, start)
        return fit(problem, theta, self.active, self.bounds, x0, *limits, path, near)

    def renewed(
        self, own: Reduced, theta: np.ndarray, path: np.ndarray | None, near: bool, times: int
    ) -> Fit:
        """Estimate, and again while the parameters that lead the driven states' starts move."""
        result = self(own, theta, path, near)
        for _ in range(times):
            moved = np.abs(result.theta - theta) > 1e-3 * np.abs(theta)
            if not own.problem.simulator.model.driven or not moved.any() or not result.usable:
                break
            theta = result.theta
            result = self(own, theta, result.path, near)
        return result

    def widened(self, own: Reduced, found: Fit, jumps: Jumps) -> tuple[Reduced, Fit]:
        """Estimate with the widths of jumps that fit best."""

        def anew(wider: Problem, before: Fit) -> Fit:
            if self.stopped():
                return before
            return self(replace(own, problem=wider), before.theta, before.path)

        problem, result = fitted_widths(jumps, own.problem, found, anew)
        return replace(own, problem=problem), result

    def finer(self, own: Reduced, found: Fit) -> tuple[Reduced, Fit]:
        """Estimate with steps as fine as the path asks for, where those are others."""
        if not found.usable or found.path is None:
            return own, found
        problem = accurate(steady(own.problem, found.theta), found.theta, found.path)
        if problem.stepping == own.problem.stepping or self.stopped():
            return own, found
        trial = replace(own, problem=problem)
        again = self(trial, found.theta, found.path)
        return (trial, again) if again.usable and again.path is not None else (own, found)


def _driven(
    arena: Arena, problem: Problem, theta: np.ndarray, active: np.ndarray, x0: np.ndarray | None
) -> tuple[Problem, np.ndarray]:
    """Return the starts with driven states where `theta` leads them, and whither it moves them."""
    segments, model = problem.segments, problem.simulator.model
    x0 = np.array(segments.guess if x0 is None else x0)
    count, order = len(model.driven), list(model.parameters)
    inside = set().union(*(model.equation_terms[s].variables for s in model.driven))
    chosen = tuple(order[j] for j in active if order[j] in inside)
    following = np.zeros((len(x0), len(order), segments.number))
    columns = [order.index(name) for name in chosen]
    for r, item in enumerate(arena.prepared):
        mine = segments.recording == r
        path, slopes = driven_states(problem.simulator, item, theta, chosen)
        x0[-count:, mine] = path[segments.start[mine]].T
        at = slopes[segments.start[mine]].transpose(1, 2, 0)
        for k, column in enumerate(columns):
            following[-count:, column, mine] = at[:, k]
    return replace(problem, following=following), x0
