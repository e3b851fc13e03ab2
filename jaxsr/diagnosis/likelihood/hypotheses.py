"""Sets of mechanisms as hypotheses, each at its mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.contest.integration import steady
from jaxsr.diagnosis.contest.memory_starts import start_of
from jaxsr.diagnosis.contest.reduced import Reduced, lean
from jaxsr.diagnosis.likelihood.beliefs import belief_of
from jaxsr.diagnosis.likelihood.estimate import Belief, Estimate, Scales, estimated, left
from jaxsr.diagnosis.likelihood.kalman import Noise
from jaxsr.diagnosis.likelihood.noise import likeliest
from jaxsr.diagnosis.likelihood.steps import resolved
from jaxsr.diagnosis.likelihood.switched import switched
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.likelihood.widths import likeliest_width
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models.least_squares import Problem
from jaxsr.models.segments import build_segments

EXACT, WIDEST, SHARPEST, COARSE, FINER = 0.0, 4.0, 0.02, 4.0, 2.0
"""Widths of jumps that are tried, in the sharpest that the data can tell: the smoothest first, from
where the law itself is found; where a rounded one is more probable, by a coarse factor, and finer
ones about the best, the last two as long as they show."""
HARDLY = WIDEST / COARSE**4
"""Width of a corner that is all but exact, which tells whether a rounder one may be likelier."""
STANDING = 4.0
"""Deviations of the noise below its largest reading in which a sensor stands at its limit."""
SHARPENED, CLEAR = 0.5, 1.0
"""Log evidence that a jump must gain to be sharpened further, and another noise to be taken."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of mechanisms at its mode.

    Attributes
    ----------
    members : tuple of int
        Candidates of the super-model.
    log_evidence : float
    share : float
        Size of the latent force left, as a share of the net force.
    constants : dict of str to (float, float)
        Value and posterior deviation, by names of the super-model.
    names : dict of int to dict of str to str
        Member to its constants' own names and those of the super-model.
    theta : ndarray
        All parameters of the super-model.
    path : ndarray, shape (states of the given model, samples, pieces)
    noise : Noise
        That makes its innovations likeliest.
    decay : float
        Correlation of its latent force from sample to sample.
    width : float, optional
        Of its jumps, in the sharpest that the data can tell; none where nothing jumps.
    """

    members: tuple[int, ...]
    log_evidence: float
    share: float
    constants: dict[str, tuple[float, float]]
    names: dict[int, dict[str, str]]
    theta: np.ndarray
    path: np.ndarray
    settled: bool
    noise: Noise
    decay: float
    width: float | None = None


def hypothesis(
    work: Workspace,
    table: Table,
    members: Sequence[int],
    near: Hypothesis | None = None,
    best: float = -np.inf,
) -> Hypothesis | None:
    """Estimate a set from where the table leads it; None where nothing finite comes of it.

    Parameters
    ----------
    members : sequence of int
        Candidates of the super-model.
    near : Hypothesis, optional
        Whose constants, path and noise it starts from; what the recordings have by default.
    best : float
        Log evidence that makes a set the best known: one without hope is not followed to its end.
    """
    model, helpers = work.super_model, work.helpers
    members = tuple(sorted(members))
    fresh = [i for i in members if near is None or i not in near.members]
    chosen = list(model.base_index())
    for i in members:
        chosen += [j for j in model.index(i) if j not in chosen]
    theta = work.theta.copy()
    if near is not None:  # what it has and this set has not does nothing here
        theta[chosen] = near.theta[chosen]
    theta = model.switched(members, model.seeded(fresh, theta))
    if near is not None:
        theta = _inherited(model, members, near, theta)
    reduced = _alone(work, tuple(sorted({*members, *helpers})), theta)
    pushes = [model.index(i, coefficients_only=True)[0] for i in helpers]
    belief = belief_of(work, table, chosen, theta)
    own = reduced.problem.segments.course.copy()
    start = start_of(own)
    start[: len(table.scales.start)] = table.scales.start
    scales = replace(table.scales, start=start)
    if near is not None:
        own[: len(near.path)] = near.path
        scales = replace(scales, noise=near.noise, decay=near.decay)
    places = reduced.active(np.array(chosen, int)), reduced.active(np.array(pushes, int))
    sharp = any(model.candidates[i].jumps for i in members)
    values = theta[reduced.parameters]
    follow = _Following(*places, belief, best, work.stop)
    hidden = beyond_limits(work, fresh)
    if hidden.any():
        values, own = _led_on(reduced.problem, hidden, sharp, values, own, follow, scales)
    # Along the path of a set with jumps no rounder ones have to lead to theirs.
    follow = replace(follow, width=None if near is None else near.width)
    found = _at_its_mode(reduced.problem, sharp, values, own, follow, scales)
    if found is None:
        return None
    # Beside what was missing, the noise is another than beside re-calibration.
    problem, at_mode, width = found
    hopeless = follow.lost(at_mode)
    likely, gain = (scales.noise, 0.0) if hopeless else likeliest(at_mode, scales)
    if gain > CLEAR:
        anew = replace(scales, noise=likely, decay=at_mode.decay)
        here = at_mode.theta, at_mode.path
        if sharp and width > EXACT:  # less noise tells more of how round the corner is
            follow = replace(follow, width=width)
            after = _at_its_mode(reduced.problem, sharp, *here, follow, anew)
        else:
            again = follow(problem, *here, anew)
            after = None if again is None else (problem, again, width)
        if after is not None and after[1].log_evidence > at_mode.log_evidence:
            (_, at_mode, width), scales = after, anew
    values = theta.copy()
    values[reduced.parameters] = at_mode.theta
    names = list(model.model.parameters)
    constants = {
        names[j]: (float(values[j]), float(at_mode.mode.deviation[k])) for k, j in enumerate(chosen)
    }
    known = len(model.given.states)
    return Hypothesis(
        members,
        at_mode.log_evidence,
        at_mode.share,
        constants,
        {i: model.names[i] for i in members},
        values,
        at_mode.path[:known],
        at_mode.settled,
        scales.noise,
        at_mode.decay,
        width if sharp else None,
    )


def _inherited(
    model: SuperModel, members: Sequence[int], near: Hypothesis, theta: np.ndarray
) -> np.ndarray:
    """Return values in which laws begin with coefficients of those that they stand for.

    A coefficient is taken over by its name, from a law at the same place; one that is never below
    another begins there.
    """
    theta, order = theta.copy(), list(model.model.parameters)
    for gone in set(near.members) - set(members):
        known = {
            own: near.constants[full][0]
            for own, full in near.names[gone].items()
            if full in near.constants
        }
        for i in set(members) - set(near.members):
            if model.candidates[i].site != model.candidates[gone].site:
                continue
            for spec in model.candidates[i].parameters:
                source = spec.name if spec.name in known else spec.floor
                if spec.coefficient and source in known:
                    theta[order.index(model.names[i][spec.name])] = known[source]
    return theta


@dataclass(frozen=True, eq=False)
class _Following:
    """Which parameters are followed to their mode, with what belief, and from which jumps."""

    chosen: np.ndarray
    helpers: np.ndarray
    belief: Belief
    best: float
    stop: Callable[[], bool]
    width: float | None = None

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
                return estimated(problem, theta, path, *args)
            except (np.linalg.LinAlgError, FloatingPointError):
                return None


def _at_its_mode(
    problem: Problem,
    sharp: bool,
    values: np.ndarray,
    path: np.ndarray,
    follow: _Following,
    scales: Scales,
) -> tuple[Problem, Estimate, float] | None:
    """Iterate; jumps rounded first, then exact, then as round as is most probable.

    Returned are the problem, its estimate, and the width of its jumps.
    """
    tried: dict[float, tuple[Problem, Estimate]] = {}

    def better(factor: float, than: float | None) -> bool:
        """Estimate with jumps of some width, from where another one led, if there is time."""
        if tried and follow.stop():
            return False
        begun = (values, path) if than is None else (tried[than][1].theta, tried[than][1].path)
        with np.errstate(all="ignore"):
            stepped = _stepped(problem, factor, begun, scales, follow.active)
        # Round jumps leave more than sharp ones: what is behind with them may yet be ahead.
        hopeful = follow if factor <= 1.0 else replace(follow, best=-np.inf)
        found = None if stepped is None else hopeful(stepped, *begun, scales)
        while stepped is not None and found is not None and not hopeful.lost(found):
            # Steps that do for a law that is off may be too long once it acts.
            here = found.theta, found.path, scales.noise, scales.start
            finer = resolved(stepped, *here, follow.active)
            if finer.stepping == stepped.stepping:
                break
            stepped, found = finer, hopeful(finer, found.theta, found.path, scales)
        if stepped is None or found is None:
            return False
        tried[factor] = stepped, found
        before = -np.inf if than is None else tried[than][1].log_evidence
        return found.log_evidence > before + SHARPENED

    def sharpened(at: float) -> bool:
        """Whether jumps less wide than some are better, and may be sharpened further."""
        if at <= SHARPEST or not better(at / COARSE, at):
            return False
        before, after = (tried[f][1].log_evidence for f in (at, at / COARSE))
        return at > 1.0 or not left(after, after - before, follow.best)

    if not sharp:
        return (*tried[1.0], 1.0) if better(1.0, None) else None

    def refined(best: float) -> tuple[Problem, Estimate, float]:
        """Take the likeliest width about one, unless the set is far behind, and the best of all."""
        if best > EXACT and not left(tried[best][1].log_evidence, 0.0, follow.best):
            for factor in (FINER, 1.0 / FINER):
                before = best
                while better(best * factor, best):
                    best *= factor
                if best != before:
                    break
            while True:
                logs = {w: found.log_evidence for w, (_, found) in tried.items() if w > EXACT}
                between = likeliest_width(logs, SHARPENED)
                if between is None or not better(between, best):
                    break
                best = between
        best = max(tried, key=lambda w: tried[w][1].log_evidence)
        return *tried[best], best

    best = WIDEST
    if follow.width is not None and better(follow.width, None):
        found = tried[follow.width][1]
        # Beside a set whose jumps are rounded, or leave nothing, others are as round.
        if follow.width > EXACT or found.share == 0.0:
            return refined(follow.width)
    if not better(best, None):
        return (*tried[EXACT], EXACT) if EXACT in tried else None
    if EXACT not in tried and better(EXACT, best):
        # How round the corner is shows where the law itself leads, if anywhere.
        rounder = [w for w in (best, best / COARSE) if better(w, EXACT)]
        if not rounder and not follow.lost(tried[EXACT][1]):
            rounder = [HARDLY] if better(HARDLY, EXACT) else []
        if not rounder:
            return *tried[EXACT], EXACT
        best = max(rounder, key=lambda w: tried[w][1].log_evidence)
    while sharpened(best):
        best /= COARSE
    return refined(best)


def _stepped(
    problem: Problem,
    factor: float,
    begun: tuple[np.ndarray, np.ndarray],
    scales: Scales,
    active: Sequence[int],
) -> Problem | None:
    """Widen or sharpen the jumps of a problem, and step it finely enough for that.

    None where they cannot be switched exactly. It begins with some constants and a path.
    """
    stepping, (theta, path) = problem.stepping, begun
    if factor == EXACT:
        exact = switched(problem, theta)
        if exact is None:
            return None
        problem = exact
    elif stepping.widths:
        widths = tuple(factor * w for w in stepping.widths)
        problem = replace(problem, stepping=replace(stepping, widths=widths))
        problem = steady(problem, theta)
    return resolved(problem, theta, path, scales.noise, scales.start, active)


def beyond_limits(work: Workspace, members: Sequence[int]) -> np.ndarray:
    """Return which samples stand at the limit of a sensor that members say it has.

    Returns
    -------
    ndarray of bool, shape (outputs, samples, pieces)
    """
    outputs = work.narrow.segments.outputs
    found = np.zeros(outputs.shape, bool)
    noise = np.sqrt(work.scales.told)
    for i in members:
        candidate = work.super_model.candidates[i]
        for (output, _), spec in zip(candidate.readings, candidate.parameters, strict=False):
            if isinstance(spec, Threshold):
                k = work.super_model.given.outputs.index(output)
                with np.errstate(invalid="ignore"):
                    found[k] |= np.abs(outputs[k]) > spec.seed - STANDING * noise[k]
    return found


def _led_on(
    problem: Problem,
    hidden: np.ndarray,
    sharp: bool,
    values: np.ndarray,
    path: np.ndarray,
    follow: _Following,
    scales: Scales,
) -> tuple[np.ndarray, np.ndarray]:
    """Return constants and the path on which the other samples lead beyond a sensor's limit.

    Along a path that follows a sensor at its limit, one half of the samples would pull it there.
    """
    segments = problem.segments
    outputs = np.where(hidden, np.nan, segments.outputs)
    blind = replace(problem, segments=replace(segments, outputs=outputs))
    follow = replace(follow, best=-np.inf)  # fewer samples: another evidence
    found = _at_its_mode(blind, sharp, values, path, follow, scales)
    return (values, path) if found is None else (found[1].theta, found[1].path)


def _alone(work: Workspace, members: Sequence[int], theta: np.ndarray) -> Reduced:
    """Return the problem of the given model with `members` alone; their states run beside."""
    own = lean(work.super_model, work.narrow.simulator, work.narrow.stepping, members)
    values, count = theta[own.parameters], own.stepping.substeps
    model = own.simulator.model
    segments = build_segments(model, work.prepared, work.rows, count, theta=values)
    problem = Problem(own.simulator, own.stepping, segments, work.narrow.scale)
    return Reduced(problem, own.parameters, np.arange(0))
