"""Sets of mechanisms as hypotheses, each at its mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.beliefs import belief_of
from jaxsr.diagnosis.likelihood.estimate import Estimate
from jaxsr.diagnosis.likelihood.late_starts import best_shift, late_sensors
from jaxsr.diagnosis.likelihood.limits import Censored, Limit, at_limits, blind, limits_of
from jaxsr.diagnosis.likelihood.noise import likeliest
from jaxsr.diagnosis.likelihood.rounding import Following, at_its_mode
from jaxsr.diagnosis.likelihood.scales import Scales, reaching
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import as_late
from jaxsr.diagnosis.shooting.memory_starts import start_of
from jaxsr.diagnosis.shooting.reduced import Reduced, lean
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import build_segments

CLEAR = 1.0
"""Log evidence that another noise must gain to be taken."""


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
    steps : Stepping, optional
        That it was integrated by, where it jumps.
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
    steps: Stepping | None = None


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
    begun = _Begun.of(work, table, tuple(sorted(members)), near, best)
    found = begun.at_the_mode()
    fresh = [i for i in begun.members if near is None or i not in near.members]
    late = late_sensors(begun.model, fresh)
    if late and not work.stop():
        other = begun.led_by_others(late).at_the_mode()
        if other is not None and (found is None or other[0].log_evidence > found[0].log_evidence):
            found = other
    return None if found is None else begun.told(*found)


@dataclass(frozen=True, eq=False)
class _Begun:
    """A set before its estimate.

    Attributes
    ----------
    model : SuperModel
    members : tuple of int
    chosen : list of int
        Parameters of the super-model that are estimated.
    theta : ndarray
        All parameters of the super-model.
    reduced : Reduced
        The given model with the members alone.
    path : ndarray, shape (states, samples, pieces)
    follow : Following
    scales : Scales
    limits : tuple of Limit
        Of sensors, by its members.
    censored : Censored, optional
        Samples beyond them, which are no readings of `reduced`.
    """

    model: SuperModel
    members: tuple[int, ...]
    chosen: list[int]
    theta: np.ndarray
    reduced: Reduced
    path: np.ndarray
    follow: Following
    scales: Scales
    limits: tuple[Limit, ...] = ()
    censored: Censored | None = None

    @staticmethod
    def of(
        work: Workspace,
        table: Table,
        members: tuple[int, ...],
        near: Hypothesis | None,
        best: float,
    ) -> _Begun:
        """Begin with what another set has of it, with the first values of what is new."""
        model, helpers = work.super_model, work.helpers
        fresh = [i for i in members if near is None or i not in near.members]
        chosen = list(model.base_index())
        limits = tuple(limits_of(model, members))
        known = {limit.column for limit in limits}  # where a sensor stands it tells them itself
        for i in members:
            chosen += [j for j in model.index(i) if j not in chosen and j not in known]
        theta = work.theta.copy()
        if near is not None:  # what it has and this set has not does nothing here
            theta[chosen] = near.theta[chosen]
        theta = model.switched(members, model.seeded(fresh, theta))
        if near is not None:
            theta = _inherited(model, members, near, theta)
        theta[[limit.column for limit in limits]] = [limit.value for limit in limits]
        reduced = _alone(work, tuple(sorted({*members, *helpers})), theta)
        pushes = [model.index(i, coefficients_only=True)[0] for i in helpers]
        path = reduced.problem.segments.course.copy()
        start = start_of(path)
        start[: len(table.scales.start)] = table.scales.start
        scales = replace(table.scales, start=start)
        if near is not None:
            path[: len(near.path)] = near.path
            scales = replace(scales, noise=near.noise, decay=near.decay)
        elif model.given.events:
            path[: len(model.given.states)] = work.narrow.segments.course
        places = reduced.active(np.array(chosen, int)), reduced.active(np.array(pushes, int))
        follow = Following(*places, belief_of(work, table, chosen, theta), best, work.stop)
        begun = _Begun(model, members, chosen, theta, reduced, path, follow, scales, limits)
        # Along the path of a set with jumps no rounder ones have to lead to theirs.
        width = None if near is None else near.width
        # A set without a latent force is not one with a force to which something was added.
        forced, inside = table.scales.shares.any(), -np.inf
        if near is not None and {*near.members} < {*members} and (forced or not near.share):
            inside = near.log_evidence
        steps = near.steps if near is not None and begun.sharp else None
        begun = replace(begun, follow=replace(follow, width=width, inside=inside, steps=steps))
        return begun.beyond(work, limits_of(model, fresh)) if limits else begun

    @property
    def sharp(self) -> bool:
        """Whether a member jumps, or the given model."""
        model = self.model
        return model.given_jumps or any(model.candidates[i].jumps for i in self.members)

    def with_values(self, values: np.ndarray) -> np.ndarray:
        """Return all parameters, with some values of those that the set has."""
        theta = self.theta.copy()
        theta[self.reduced.parameters] = values
        return theta

    def beyond(self, work: Workspace, fresh: Sequence[Limit]) -> _Begun:
        """Begin without the samples that stand at a limit which the path goes beyond.

        Along a path that follows a sensor at a limit that is new, half of the samples would pull
        it there, and the noise would be what makes up for that: the other samples lead it on.
        """
        begun = self
        if fresh:
            hidden = at_limits(work, fresh)
            apart = replace(self.follow, best=-np.inf, inside=-np.inf)  # fewer samples: other logs
            reduced = replace(self.reduced, problem=blind(self.reduced.problem, hidden))
            # Readings that stand still have no noise, and sets that take them for others little.
            noise, decay = Noise.white_of(work.scales.told), work.scales.decay
            white = replace(self.scales, noise=noise, decay=decay)
            other = replace(self, reduced=reduced, follow=apart)
            ways = (replace(other, scales=s).at_the_mode() for s in (self.scales, white))
            known = [way for way in ways if way is not None]
            if known:
                found = max(known, key=lambda way: way[0].log_evidence)
                theta = self.with_values(found[0].theta)
                begun = replace(self, theta=theta, path=found[0].path, scales=found[2])
        problem, values = self.reduced.problem, begun.theta[self.reduced.parameters]
        columns = [list(self.reduced.parameters).index(limit.column) for limit in self.limits]
        told = Censored.along(work, self.limits, problem, values, columns, begun.path)
        follow = self.follow
        inside = -np.inf if fresh else follow.inside - told.log_density
        follow = replace(follow, best=follow.best - told.log_density, inside=inside)
        reduced = replace(self.reduced, problem=blind(problem, told.samples))
        return replace(begun, reduced=reduced, follow=follow, censored=told)

    def led_on(self, hidden: np.ndarray) -> _Begun:
        """Begin with constants and the path on which the other samples lead."""
        problem = blind(self.reduced.problem, hidden)
        values = self.theta[self.reduced.parameters]
        # Fewer samples: another evidence.
        follow = replace(self.follow, best=-np.inf, inside=-np.inf)
        found = at_its_mode(problem, self.sharp, values, self.path, follow, self.scales)
        if found is None:
            return self
        return replace(self, theta=self.with_values(found[1].theta), path=found[1].path)

    def led_by_others(self, late: Sequence[tuple[int, str]]) -> _Begun:
        """Begin where the other sensors lead, with late ones shifted to be nearest to that."""
        hidden = np.zeros(self.reduced.problem.segments.outputs.shape, bool)
        hidden[[output for output, _ in late]] = True
        begun = self.led_on(hidden)
        names, theta = list(self.model.model.parameters), begun.theta.copy()
        problem, parameters = begun.reduced.problem, list(begun.reduced.parameters)
        for output, name in late:
            column = names.index(name)
            place = parameters.index(column)
            values = theta[begun.reduced.parameters]
            theta[column] = best_shift(problem, values, begun.path, output, place)
        return replace(begun, theta=theta)

    def at_the_mode(self) -> tuple[Estimate, float, Scales, Stepping] | None:
        """Return the estimate, the width of its jumps, the noise beside which it is, and steps."""
        problem, values = self.reduced.problem, self.theta[self.reduced.parameters]
        follow, scales = self.follow, self.scales
        found = at_its_mode(problem, self.sharp, values, self.path, follow, scales)
        if found is None:
            return None
        stepped, at_mode, width = found
        steps = stepped.stepping
        idle = at_mode.log_evidence < follow.inside + CLEAR
        if follow.lost(at_mode) or idle:  # beside what does nothing the noise is that of before
            return at_mode, width, scales, steps
        # Beside what was missing, the noise is another than beside re-calibration.
        known = follow.chosen, follow.belief, follow.stop
        noise, decay, gain = likeliest(at_mode, scales, *known)
        if gain > CLEAR:
            # How round the corner is shows beside the noise that there is.
            shares = reaching(scales.shares, at_mode.share)
            anew = replace(scales, noise=noise, decay=decay, shares=shares)
            fine = replace(follow, width=width, steps=steps) if self.sharp else follow
            after = at_its_mode(problem, self.sharp, at_mode.theta, at_mode.path, fine, anew)
            if after is not None and after[1].log_evidence > at_mode.log_evidence:
                # About a path that is at rest beside one noise, time that ends is no doubt.
                rests = after[1].settled or (at_mode.settled and follow.stop())
                return replace(after[1], settled=rests), after[2], anew, after[0].stepping
        return at_mode, width, scales, steps

    def told(self, found: Estimate, width: float, scales: Scales, steps: Stepping) -> Hypothesis:
        """Return the hypothesis that an estimate is."""
        model, values = self.model, self.with_values(found.theta)
        names = list(model.model.parameters)
        told = [*zip(self.chosen, found.mode.deviation, strict=False)]
        log = found.log_evidence
        if self.censored is not None:
            log += self.censored.log_density
            columns = (limit.column for limit in self.limits)
            told += [*zip(columns, self.censored.deviation, strict=True)]
        return Hypothesis(
            self.members,
            log,
            found.share,
            {names[j]: (float(values[j]), float(deviation)) for j, deviation in told},
            {i: model.names[i] for i in self.members},
            values,
            found.path[: len(model.given.states)],
            found.settled,
            scales.noise,
            found.decay,
            width if self.sharp else None,
            steps if self.sharp else None,
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
            one, other = model.candidates[gone], model.candidates[i]
            if one.site != other.site and not as_late(model.given, one, other):
                continue
            for spec in model.candidates[i].parameters:
                source = spec.name if spec.name in known else spec.floor
                if spec.coefficient and source in known:
                    theta[order.index(model.names[i][spec.name])] = known[source]
    return theta


def _alone(work: Workspace, members: Sequence[int], theta: np.ndarray) -> Reduced:
    """Return the problem of the given model with `members` alone; their states run beside."""
    own = lean(work.super_model, work.narrow.simulator, work.narrow.stepping, members)
    values, count = theta[own.parameters], own.stepping.substeps
    model = own.simulator.model
    segments = build_segments(model, work.prepared, work.rows, count, theta=values)
    problem = Problem(own.simulator, own.stepping, segments, work.narrow.scale)
    return Reduced(problem, own.parameters, np.arange(0))
