"""Estimation of one set in free run: first where it stands, then with widths and finer steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.integration import accurate, steady
from jaxsr.diagnosis.shooting.reduced import Reduced
from jaxsr.diagnosis.shooting.widths import Jumps, fitted_widths
from jaxsr.models.driven import driven_states
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.shooting import fit

TOLERANCE = 1e-4
"""Gain in cost at which the estimation of a set stops."""
MOVED = 1e-3
"""Change of a parameter, or of a start, relative to itself, that leads later starts elsewhere."""


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
        x0, limits = None, (self.max_iterations, self.stopped, TOLERANCE)
        problem = own.problem
        if problem.simulator.model.driven:
            start = None if path is None else path[:, 0]
            problem, x0 = _driven(self.arena, problem, theta, self.active, start)
        return fit(problem, theta, self.active, self.bounds, x0, *limits, path, near)

    def renewed(
        self, own: Reduced, theta: np.ndarray, path: np.ndarray | None, near: bool, times: int
    ) -> Fit:
        """Estimate, and again while what leads the driven states' later starts moves.

        That is the parameters, and the starts of the recordings.
        """
        count = len(own.problem.simulator.model.driven)
        result = self(own, theta, path, near)
        begun = own.problem.segments.guess if path is None else path[:, 0]
        for _ in range(times if count else 0):
            moved = np.abs(result.theta - theta) > MOVED * np.abs(theta)
            away = np.abs(result.x0 - begun)[-count:] > MOVED * np.abs(result.x0[-count:])
            if not (moved.any() or away.any()) or not result.usable:
                break
            theta, begun = result.theta, result.x0
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
    """Return the starts with driven states where `theta` leads them, and whither it moves them.

    Where a recording begins nothing led them: that start is estimated, from `x0` on or, by default,
    from rest, and moves those of the recording's later segments.
    """
    segments, model = problem.segments, problem.simulator.model
    known, count, order = x0, len(model.driven), list(model.parameters)
    x0, free = np.array(segments.guess if x0 is None else x0), segments.free_start.copy()
    inside = set().union(*(model.equation_terms[s].variables for s in model.driven))
    chosen = tuple(order[j] for j in active if order[j] in inside)
    following = np.zeros((len(x0), len(order), segments.number))
    columns = [order.index(name) for name in chosen]
    carried = np.zeros((len(x0), count * len(arena.prepared), segments.number))
    for r, item in enumerate(arena.prepared):
        mine = segments.recording == r
        begun = mine & (segments.start == 0)
        start = None if known is None or not begun.any() else known[-count:, begun][:, 0]
        path, slopes, by_start = driven_states(problem.simulator, item, theta, chosen, start)
        x0[-count:, mine] = path[segments.start[mine]].T
        free[-count:, begun] = True
        at = slopes[segments.start[mine]].transpose(1, 2, 0)
        for k, column in enumerate(columns):
            following[-count:, column, mine] = at[:, k]
        if begun.any():
            own = slice(r * count, (r + 1) * count)
            carried[-count:, own, mine] = by_start[segments.start[mine]].transpose(1, 2, 0)
    segments = replace(segments, guess=x0, free_start=free)
    return replace(problem, segments=segments, following=following, carried=carried), x0
