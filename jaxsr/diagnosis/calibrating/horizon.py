"""How far ahead a diagnosis looks: the horizon of the verdict and the length of its segments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.carried import starts_told
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.reduced import lean, reduce
from jaxsr.diagnosis.shooting.scoring import horizons
from jaxsr.models import Simulator
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.lifting import linear
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, cut

Start = tuple[tuple[int, ...], np.ndarray]
"""Members of a set and the parameter values its estimation starts from."""
MAX_SAMPLES = 1024
"""Longest segment, in samples."""
MANY_SEGMENTS, MANY_WITH_JUMPS = 4, 20
"""Segments from which the work is shared; where friction sticks and slides, short segments keep
an estimate from being caught among the many orders in which it can."""
SMALL, SATURATED, FORGOTTEN = 0.1, 1.3, 0.7
"""Error of re-calibration that is small, its growth that counts as none, and the error below which
a growth that ended tells a system that forgets its start."""
UNRELATED = 1.4
"""Error by which unrelated motions differ: grown beyond it, it comes back at no longer horizon."""


@dataclass(frozen=True, eq=False)
class Headline:
    """How far the verdict looks ahead.

    Attributes
    ----------
    seconds : float
    lengths : list of float
        Of the segments that there can be, the longest first.
    calibrated : mapping of float to Entry
        Re-calibration over segments of a length, from the estimate over the next shorter ones.
    """

    seconds: float
    lengths: list[float]
    calibrated: Mapping[float, Entry] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Outlook:
    """What all arenas of a diagnosis share but the length of their segments.

    `stop` is asked before every estimation: what is known by then is taken.
    """

    super_model: SuperModel
    prepared: tuple[Prepared, ...]
    stepping: Stepping
    scale: np.ndarray
    simulator: Simulator
    stop: Callable[[], bool] = lambda: False

    def arena(self, seconds: float) -> Arena:
        """Cut the recordings into segments of `seconds`."""
        setting = self.stepping, seconds, self.scale, self.simulator
        return build_arena(self.super_model, self.prepared, *setting)

    def usable_starts(self, starts: list[Start]) -> list[Start]:
        """Start from the given free parameters where those of the weak view simulate worse.

        Without the missing physics the weak view can ask for impossible values, such as a mass
        matrix that is not positive.
        """
        super_model, arena = self.super_model, self.arena(horizons(self.prepared)[0])
        base, neutral = super_model.base_index(), neutral_values(super_model)
        better: list[Start] = []
        for members, start in starts:
            if self.stop():
                better.append((members, start))
                continue
            given = start.copy()
            given[base] = neutral[base]
            own = reduce(arena.problem, super_model, members)
            costs = [_cost(own.problem, theta[own.parameters]) for theta in (start, given)]
            better.append((members, start if costs[0] <= costs[1] else given))
        # Re-calibrated over the shortest horizon, the given structure tells how its errors grow.
        calibrated = enter(arena, (), better[0][1], stop=self.stop).fit
        if calibrated.usable:
            better[0] = ((), calibrated.theta)
        return better

    def first_usable(self, headline: Headline, start: np.ndarray) -> Arena:
        """Take the longest segments over which the re-calibrated model can be simulated."""
        for seconds in headline.lengths:
            arena, known = self.arena(seconds), headline.calibrated.get(seconds)
            if self.stop() or (known is not None and known.fit.usable):
                break
            if enter(arena, (), start, stop=self.stop, max_iterations=4).fit.usable:
                break
        return arena

    def headline(self, starts: list[Start]) -> Headline:
        """Choose the horizon of the verdict, and lengths of segments, in seconds.

        The first two of `starts` are those of re-calibration and of the leading set. Sets are led
        along their paths and need no short segments to find them: where no sensor tells a state,
        every further start that is estimated anew absorbs what is left out.

        The longest horizon up to which the re-calibrated model's error stays small, or no longer
        grows: errors of a drifting, unstable or chaotic system grow with the horizon, and judging
        it by its full length compares how errors happen to add up. Where the error ends its growth
        far below what two unrelated motions differ by, the system forgets its start, and the
        whole recording counts. Starts are estimated on the whole segment, so that noise of the
        first readings does not count as an error that grows.
        """
        options = horizons(self.prepared)
        step = float(np.median([p.recording.sample_time for p in self.prepared]))
        fitting = [h for h in options if h / step <= MAX_SAMPLES] or options[:1]
        headline, growing, scores, theta = options[0], False, list[float](), starts[0][1]
        calibrated = {}
        for horizon in options:
            if scores and self.stop():
                break
            if horizon in fitting:
                arena = self.arena(horizon)
                entry = enter(arena, (), theta, stop=self.stop, max_iterations=8)
                calibrated[horizon] = entry
                fitted = entry.fit
                theta = fitted.theta if fitted.usable else theta
                score = _relative_error(arena, fitted) if fitted.usable else np.inf
            else:
                plain = lean(self.super_model, self.simulator, self.stepping, ())
                score = plain.free_run(self.prepared, theta, horizon).nrmse
            growing |= bool(scores) and not (score <= SMALL or score <= SATURATED * scores[-1])
            scores.append(score)
            if not growing:
                headline = horizon
            elif UNRELATED < score < np.inf:
                break
        whole = len(scores) == len(options)
        # Where no sensor tells a start, growth says only that a start absorbs less and less.
        told = starts_told(self.super_model, self.prepared)
        if whole and growing:
            least = min(SATURATED * scores[-2], FORGOTTEN) if told else FORGOTTEN
            headline = options[-1] if scores[-1] <= least else headline
        fitting = [h for h in fitting if h <= headline]
        least = MANY_SEGMENTS
        if any(p.states.hidden for p in self.prepared):
            least = 1
        elif self._jumps(starts[:2]):
            least = MANY_WITH_JUMPS
        many = [h for h in fitting if len(cut(self.prepared, h)) >= least]
        return Headline(headline, sorted(many or fitting, reverse=True), calibrated)

    def _jumps(self, starts: list[Start]) -> bool:
        """Whether the given model or a leading set has laws that jump."""
        candidates = self.super_model.candidates
        if any(candidates[i].sharp for members, _ in starts for i in members):
            return True
        return bool(Simulator(self.super_model.given).smoothed_arguments)


def _cost(problem: Problem, theta: np.ndarray) -> float:
    """Sum of squared residuals of a simulation, to first order about what the sensors tell."""
    segments = problem.segments
    with np.errstate(all="ignore"):
        setting = problem.simulator, problem.stepping, segments
        y = linear(*setting, theta, segments.course, ()).outputs
        cost = float(np.sum(problem.residual(y) ** 2))
    return cost if np.isfinite(cost) else np.inf


def _relative_error(arena: Arena, fitted: Fit) -> float:
    """Root mean square residual over the outputs' standard deviations."""
    used = max(float(arena.problem.segments.weights.sum()), 1.0)
    return 0.01 * float(np.sqrt(fitted.cost / used))
