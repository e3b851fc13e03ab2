"""Widths of rounded jumps: how sharply a law turns over, told by the recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.shooting.blocks import column_sizes
from jaxsr.diagnosis.shooting.integration import accurate, led_apart, steady
from jaxsr.expressions import evaluate, parse
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.simulator import SMOOTHED, Simulator

BEGIN = 4.0
"""Width at which laws that jump begin, in those of the sharpest."""
WIDEST = 32.0
"""Largest width, in those of the sharpest: beyond it a law does not jump."""
CLEAR, FOR_SOME_TIME = 0.1, 0.01
"""Size of an argument relative to its rms, and the share of samples, at which it counts."""
STEPS = (1.0, 0.5, 0.25)
"""Of the search for a width, in powers of two."""
PROMISING = 3e-4
"""Share of the cost that a width must promise to be sought any further."""
HAIR = 1e-10
"""Added to the diagonal of scaled normal equations."""


@dataclass(frozen=True, eq=False)
class Jumps:
    """The jumps that mechanisms bring along, and between which widths theirs is sought.

    Attributes
    ----------
    arguments : frozenset
        Of sign() and Heaviside, without those of the given model and those that nowhere in the
        recordings change their sign: rounded, these would stand for another law.
    sharpest : dict
        Least width, by argument.
    """

    arguments: frozenset[Any]
    sharpest: dict[Any, float]

    @classmethod
    def of(cls, problem: Problem, given: Simulator, known: Jumps | None = None) -> Jumps:
        """Tell the jumps of a problem apart from those of the given model.

        A problem's widths are the sharpest, but for those already known.
        """
        everywhere = problem.simulator.smoothed_arguments
        own = frozenset(everywhere) - frozenset(given.smoothed_arguments)
        own = frozenset(a for a in own if _turns(problem, a))
        sharpest = dict(zip(everywhere, problem.stepping.widths, strict=False))
        return cls(own, sharpest | (known.sharpest if known else {}))

    def places(self, problem: Problem) -> list[int]:
        """Positions of their widths in a problem's."""
        found = problem.simulator.smoothed_arguments
        return [k for k, a in enumerate(found) if a in self.arguments]

    def widened(self, problem: Problem, factor: float) -> Problem | None:
        """Return a problem with other widths; None where one would leave its bounds."""
        widths = list(problem.stepping.widths)
        for k in self.places(problem):
            least = self.sharpest[problem.simulator.smoothed_arguments[k]]
            widths[k] *= factor
            if not 0.99 * least <= widths[k] <= 1.01 * WIDEST * least:
                return None
        return replace(problem, stepping=replace(problem.stepping, widths=tuple(widths)))

    def estimated(self, problem: Problem) -> bool:
        """Whether a width is wider than the sharpest."""
        arguments = problem.simulator.smoothed_arguments
        return any(
            problem.stepping.widths[k] > 1.01 * self.sharpest[arguments[k]]
            for k in self.places(problem)
        )


def width_of(problem: Problem, candidate: Candidate) -> float:
    """Width within which a candidate's own law turns over; 0 for one that does not jump."""
    known = dict(zip(problem.simulator.smoothed_arguments, problem.stepping.widths, strict=False))
    named = {p.name: p.name for p in candidate.parameters}
    terms = [parse(template.format(**named)) for _, template in candidate.terms]
    nodes = (node for term in terms for node in term.distinct() if node.op in SMOOTHED)
    return max((known.get(node.args[0], 0.0) for node in nodes), default=0.0)


def _turns(problem: Problem, argument: Any) -> bool:
    """Whether an argument takes both signs in the recordings, clearly and for some time."""
    segments, simulator = problem.segments, problem.simulator
    values = [p.value for p in simulator.model.parameters.values()]
    signals = tuple(segments.course), tuple(segments.inputs)
    env = simulator.environment(0.0, *signals, tuple(values))
    with np.errstate(all="ignore"):
        found = np.asarray(evaluate(argument, env, "numpy"), dtype=float)
    inside = np.arange(segments.time.shape[0])[:, None] < segments.count
    known = np.broadcast_to(found, inside.shape)[inside]
    size = np.sqrt(np.nanmean(known**2))
    return all(np.nanmean(side * known > CLEAR * size) > FOR_SOME_TIME for side in (-1.0, 1.0))


def fitted_widths(
    jumps: Jumps, problem: Problem, fitted: Fit, again: Callable[[Problem, Fit], Fit]
) -> tuple[Problem, Fit]:
    """Return a problem with the widths that fit best, and its fit.

    A friction law turns over within some velocity, which is as much a property of the machine as
    its size; taken too small, the constants make up for it. Doubled or halved as long as the cost
    falls, then in smaller steps; a parabola over the logarithm of the width ends the search, or
    says that nothing is left to find.
    """
    if not jumps.places(problem) or not fitted.usable:
        return problem, fitted
    if not promised(jumps, problem, fitted) > PROMISING:
        return problem, fitted
    known = {0.0: (problem, fitted)}

    def tried(power: float, near: float) -> bool:
        """Estimate at 2**power times the widths; tell whether that is the best so far."""
        best = min(f.cost for _, f in known.values())
        wider = jumps.widened(problem, 2.0**power)
        if wider is None:
            return False
        begun = known[near][1]
        stepped = steady(wider, begun.theta)
        if begun.path is not None:  # errors of integration look like another width
            stepped = accurate(stepped, begun.theta, begun.path)
        known[power] = stepped, again(stepped, begun)
        return known[power][1].usable and known[power][1].cost < best

    best, at, gain = 0.0, 0.0, np.inf
    for step in STEPS:
        for side in (step, -step):
            begun = best
            while tried(best + side, best):
                best += side
            if best != begun:
                break
        sides = (best - step, best, best + step)
        costs = [known[k][1].cost if k in known else np.inf for k in sides]
        at, gain = _lowest(best, step, costs)
        if gain < PROMISING * known[best][1].cost:
            break
    if np.isfinite(gain) and at not in known and tried(at, best):
        best = at
    return known[best]


def _lowest(middle: float, step: float, costs: Sequence[float]) -> tuple[float, float]:
    """Return where a parabola through three costs is lowest, and how far below the middle one.

    Where a cost is not known, nothing says how much is to be gained: infinity.
    """
    if not np.isfinite(costs).all():
        return middle, np.inf
    slope, bend = 0.5 * (costs[2] - costs[0]), max(costs[0] - 2.0 * costs[1] + costs[2], 1e-300)
    return middle - step * slope / bend, 0.5 * slope**2 / bend


def promised(jumps: Jumps, problem: Problem, fitted: Fit) -> float:
    r"""Return the share of the cost that other widths promise, to first order.

    With d the change of the readings when widths are multiplied, the parameters and the starts
    projected out, r the residuals and C the cost, it is :math:`(r'd)^2 / (C\,d'd)`; the larger
    one of wider and narrower jumps. Infinity without a path; 0 along one from which neighbours
    lead away without bounds.
    """
    if fitted.path is None:
        return np.inf
    shares = [0.0]
    for factor in (2.0**0.5, 2.0**-0.5):
        other = jumps.widened(problem, factor)
        if other is None:
            continue
        with np.errstate(all="ignore"):
            change, _ = led_apart(problem, other, fitted.theta, fitted.path)
        if not np.isfinite(change).all() or not change.any():
            continue
        wide = replace(fitted, jacobian=np.concatenate([fitted.jacobian, change[None]]))
        hessian, gradient = (a.sum(0) for a in wide.normal_equations())
        size = column_sizes(hessian)
        hessian = hessian / size / size[:, None] + HAIR * np.eye(size.size)
        pulls = gradient / size
        rest = np.linalg.solve(hessian[:-1, :-1], np.stack([hessian[:-1, -1], pulls[:-1]], 1))
        left = hessian[-1, -1] - hessian[-1, :-1] @ rest[:, 0]
        pull = pulls[-1] - hessian[-1, :-1] @ rest[:, 1]
        shares.append(float(pull**2 / left / fitted.cost))
    return max(shares)
