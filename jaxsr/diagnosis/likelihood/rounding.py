"""Sets followed to their modes; where laws jump, at the most probable width of the jumps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.estimate import Belief, Estimate, estimated, left
from jaxsr.diagnosis.likelihood.scales import Scales
from jaxsr.diagnosis.likelihood.steps import as_fine, resolved
from jaxsr.diagnosis.likelihood.switched import rounded, switched
from jaxsr.diagnosis.likelihood.widths import WidthStep, width_step
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping

EXACT, WIDEST, SHARPEST, COARSE = 0.0, 4.0, 0.02, 4.0
"""Widths of jumps that are tried, in the sharpest that the data can tell: the smoothest first, from
where the law itself is found; where a rounded one is more probable, by a coarse factor, and by
Newton's steps about the best."""
HARDLY = WIDEST / COARSE**4
"""Width of a corner that is all but exact, which tells whether a rounder one may be likelier."""
SHARPENED = 0.5
"""Log evidence that another width must gain to be sought."""


@dataclass(frozen=True, eq=False)
class Following:
    """Which parameters are followed to their mode, with what belief, and from which jumps.

    `inside` is the log evidence of the set that members are added to, where they do nothing;
    `steps` are those of a set with jumps as round.
    """

    chosen: np.ndarray
    helpers: np.ndarray
    belief: Belief
    best: float
    stop: Callable[[], bool]
    width: float | None = None
    inside: float = -np.inf
    steps: Stepping | None = None

    @property
    def active(self) -> list[int]:
        """Parameters that steps are differentiated by."""
        return list(dict.fromkeys([*map(int, self.chosen), *map(int, self.helpers)]))

    def lost(self, found: Estimate) -> bool:
        """Whether an estimate is too far behind the best to be followed, or time is over."""
        return self.stop() or left(found.log_evidence, 0.0, self.best)

    def __call__(
        self, problem: Problem, theta: np.ndarray, path: np.ndarray, scales: Scales
    ) -> Estimate | None:
        """Estimate; None where nothing finite comes of it."""
        with np.errstate(all="ignore"):
            try:
                args = self.chosen, self.helpers, self.belief, scales, self.best, self.stop
                return estimated(problem, theta, path, *args, self.inside)
            except (np.linalg.LinAlgError, FloatingPointError):
                return None


def at_its_mode(
    problem: Problem,
    sharp: bool,
    values: np.ndarray,
    path: np.ndarray,
    follow: Following,
    scales: Scales,
) -> tuple[Problem, Estimate, float] | None:
    """Iterate; jumps rounded first, then exact, then as round as is most probable.

    Returned are the problem, its estimate, and the width of its jumps; None where nothing finite
    comes of it.
    """
    widths = _Widths(problem, (values, path), follow, scales)
    if not sharp:
        return widths.at(1.0) if widths.better(1.0, None) else None
    if follow.width is not None and widths.better(follow.width, None):
        # Beside a set whose jumps are rounded, or leave nothing, others are as round.
        if follow.width > EXACT or widths.tried[follow.width][1].share == 0.0:
            return widths.refined(follow.width)
    best = WIDEST
    if not widths.better(best, None):
        return widths.at(EXACT) if EXACT in widths.tried else None
    if EXACT not in widths.tried and widths.better(EXACT, best):
        # How round the corner is shows where the law itself leads, if anywhere.
        both = best, best / COARSE
        rounder = [w for w in both if widths.better(w, EXACT)]
        lost = follow.lost(widths.tried[EXACT][1])
        if not rounder and not lost and widths.between(*both) > SHARPENED:
            rounder = [HARDLY] if widths.better(HARDLY, EXACT) else []
        if not rounder:
            return widths.at(EXACT)
        best = max(rounder, key=widths.log_evidence)
    while not widths.none_beats(best) and widths.sharpened(best):
        best /= COARSE
    return widths.at(EXACT) if widths.none_beats(best) else widths.refined(best)


class _Widths:
    """Widths at which a set was estimated; `tried` has the problem and the estimate of each."""

    def __init__(
        self,
        problem: Problem,
        begun: tuple[np.ndarray, np.ndarray],
        follow: Following,
        scales: Scales,
    ) -> None:
        self.problem, self.begun, self.follow, self.scales = problem, begun, follow, scales
        self.tried: dict[float, tuple[Problem, Estimate]] = {}
        self.steps: dict[float, WidthStep | None] = {}

    def at(self, width: float) -> tuple[Problem, Estimate, float]:
        """Return what was found with jumps of some width, and that."""
        return *self.tried[width], width

    def log_evidence(self, width: float) -> float:
        """Return the log evidence at a width that was tried."""
        return self.tried[width][1].log_evidence

    def better(self, width: float, than: float | None) -> bool:
        """Estimate with jumps of some width, from where another one led, if there is time."""
        follow, scales = self.follow, self.scales
        if self.tried and follow.stop():
            return False
        begun, before, steps = self.begun, -np.inf, follow.steps
        if than is not None:
            problem, found = self.tried[than]
            begun, before = (found.theta, found.path), found.log_evidence
            steps = problem.stepping if than > EXACT else None
        with np.errstate(all="ignore"):
            stepped = _stepped(self.problem, width, begun, scales, follow.active, steps)
        # Round jumps leave more than sharp ones: what is behind with them may yet be ahead, but not
        # of the same law with other ones.
        rival = max(before, follow.best) if width <= 1.0 else before
        hopeful = replace(follow, best=rival)
        found = None if stepped is None else hopeful(stepped, *begun, scales)
        borrowed = steps is not None
        while stepped is not None and found is not None:
            if hopeful.lost(found) and not (borrowed and not follow.stop()):
                break
            # Steps that do for a law that is off, or for other jumps, may be too long for this one.
            here = found.theta, found.path, scales.noise, scales.start
            finer, borrowed = resolved(stepped, *here, follow.active), False
            if finer.stepping == stepped.stepping:
                break
            stepped, found = finer, hopeful(finer, found.theta, found.path, scales)
        if stepped is None or found is None:
            return False
        self.tried[width] = stepped, found
        self.steps.pop(width, None)
        return found.log_evidence > before + SHARPENED

    def between(self, wide: float, narrow: float) -> float:
        """Return the log evidence that some width is told to gain on none, which two did not.

        By the top of the parabola over width through the three; without limit where one of the two
        was not followed.
        """
        if not {wide, narrow} <= self.tried.keys():
            return np.inf
        far, near = (self.log_evidence(w) - self.log_evidence(EXACT) for w in (wide, narrow))
        slope = (far * narrow**2 - near * wide**2) / (wide * narrow * (narrow - wide))
        bend = (near * wide - far * narrow) / (wide * narrow * (narrow - wide))
        return 0.25 * slope**2 / -bend if slope > 0.0 > bend else 0.0

    def none_beats(self, at: float) -> bool:
        """Whether exact jumps are known, and told to be better than all that are less wide."""
        if EXACT not in self.tried or self.log_evidence(at) > self.log_evidence(EXACT):
            return False
        return self.between(COARSE * at, at) <= SHARPENED

    def sharpened(self, at: float) -> bool:
        """Whether jumps less wide than some are better, and may be sharpened further."""
        if at <= SHARPEST:
            return False
        step = self._step(at)
        rounder = step is not None and step.change > 0.0 and step.gain > SHARPENED
        if rounder or not self.better(at / COARSE, at):
            return False
        before, after = (self.log_evidence(w) for w in (at, at / COARSE))
        return at > 1.0 or not left(after, after - before, self.follow.best)

    def refined(self, best: float) -> tuple[Problem, Estimate, float]:
        """Follow the width to its mode while there is hope, and take the best of all.

        About what is behind and no mode, Newton's step promises anything.
        """
        while best > EXACT and (self.tried[best][1].settled or not self._behind(best)):
            step = self._step(best)
            if step is None or step.gain < SHARPENED:
                break
            if left(self.log_evidence(best), step.gain, self.follow.best):
                break
            nearer = self._along(best, step)
            if nearer is None:
                break
            best = nearer
        return self.at(max(self.tried, key=self.log_evidence))

    def _along(self, best: float, step: WidthStep) -> float | None:
        """Return a better width along a step; None where there is none.

        If the whole step, or as much of it as is taken at once, is not better, a parabola through
        the slope that it has where it begins and what it led to tells how much of it may be.
        """
        change = float(np.clip(step.change, -np.log(COARSE), np.log(COARSE)))
        whole = best * float(np.exp(change))
        if self.better(whole, best):
            return whole
        if whole not in self.tried or not change:
            return None
        slope = 2.0 * step.gain * change / step.change
        bend = slope - (self.log_evidence(whole) - self.log_evidence(best))
        share = 0.5 * slope / bend if bend > 0.0 else 1.0
        if share >= 1.0 or 0.5 * slope * share < SHARPENED:
            return None
        part = best * float(np.exp(share * change))
        return part if self.better(part, best) else None

    def _behind(self, width: float) -> bool:
        """Whether an estimate is so far behind the best known that nothing but a gain is hope."""
        return left(self.log_evidence(width), 0.0, self.follow.best)

    def _step(self, width: float) -> WidthStep | None:
        """Return Newton's step from a width that was tried."""
        if width not in self.steps:
            follow, (problem, found) = self.follow, self.tried[width]
            with np.errstate(all="ignore"):
                args = follow.chosen, follow.helpers, follow.belief, self.scales
                self.steps[width] = width_step(problem, found, *args)
        return self.steps[width]


def _stepped(
    problem: Problem,
    width: float,
    begun: tuple[np.ndarray, np.ndarray],
    scales: Scales,
    active: Sequence[int],
    steps: Stepping | None,
) -> Problem | None:
    """Widen or sharpen the jumps of a problem, and step it finely enough for that.

    None where they cannot be switched exactly. It begins with some constants and a path, and with
    the steps of a neighbour.
    """
    theta, path = begun
    if width == EXACT:
        exact = switched(problem, theta)
        if exact is None:
            return None
        problem = exact
    else:
        problem = rounded(problem, width, theta)
        if steps is not None:  # whether they do is asked about the mode
            return as_fine(problem, theta, steps)
    return resolved(problem, theta, path, scales.noise, scales.start, active)
