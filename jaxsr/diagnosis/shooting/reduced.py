"""The problem of free runs reduced to one set of candidates, without states of others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.scoring import FreeRun, free_run
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments
from jaxsr.models.simulator import Simulator

STIFF_STEPS = 2
"""Fewest steps of the L-stable method between two samples."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """The estimation of one set.

    Attributes
    ----------
    problem : Problem
        Of the given model with the set's candidates alone.
    parameters, states : ndarray of int
        Where its parameters and states stand in the super-model.
    """

    problem: Problem
    parameters: np.ndarray
    states: np.ndarray

    def active(self, wanted: np.ndarray) -> np.ndarray:
        """Positions here of parameters of the super-model."""
        return _places(self.parameters, wanted)

    def restored(self, result: Fit, theta: np.ndarray, full: Segments) -> Fit:
        """Return the fit in the order of the super-model's parameters and states.

        States of other candidates stay where the recordings have driven them.
        """
        values, starts = theta.copy(), full.guess.copy()
        values[self.parameters] = result.theta
        starts[self.states] = result.x0
        by_start = np.zeros((len(starts), *result.by_start.shape[1:]))
        by_start[self.states] = result.by_start
        path = None
        if result.path is not None:
            path = full.course.copy()
            path[self.states] = result.path
        return replace(
            result,
            theta=values,
            x0=starts,
            active=self.parameters[result.active],
            by_start=by_start,
            path=path,
        )


def reduce(problem: Problem, super_model: SuperModel, members: Sequence[int]) -> Reduced:
    """Leave out of a super-model's problem what the given model and `members` do not need."""
    full = super_model.model
    everything = np.arange(len(full.parameters)), np.arange(len(full.states))
    if len(members) == len(super_model.candidates):
        return Reduced(problem, *everything)
    own = lean(super_model, problem.simulator, problem.stepping, members)
    states = _state_positions(super_model, members)
    segments = replace(
        problem.segments,
        guess=problem.segments.guess[states],
        course=problem.segments.course[states],
        free_start=problem.segments.free_start[states],
        override=problem.segments.override[own.parameters],
    )
    segments = restepped(segments, own.stepping, problem.stepping)
    problem = Problem(own.simulator, own.stepping, segments, problem.scale)
    return Reduced(problem, own.parameters, states)


@dataclass(frozen=True, eq=False)
class Lean:
    """A set's own simulator, how it is stepped, and where its parameters stand in the full one."""

    simulator: Simulator
    stepping: Stepping
    parameters: np.ndarray
    _known: dict[tuple, FreeRun] = field(default_factory=dict, repr=False)

    def active(self, wanted: np.ndarray) -> np.ndarray:
        """Positions here of parameters of the full one."""
        return _places(self.parameters, wanted)

    def free_run(
        self,
        prepared: Sequence[Prepared],
        theta: np.ndarray,
        horizon: float | None,
        like: Sequence[Prepared] = (),
        stop: Callable[[], bool] = lambda: False,
    ) -> FreeRun:
        """Score parameters of the super-model in free run; what was asked before is kept.

        `like` changes how segments are padded, not what they give.
        """
        own = theta[self.parameters]
        key = (tuple(prepared), own.tobytes(), horizon)
        if key in self._known:
            return self._known[key]
        run = free_run(self.simulator, self.stepping, prepared, own, horizon, like, stop)
        if not stop():
            self._known[key] = run
        return run


def lean(
    super_model: SuperModel, simulator: Simulator, stepping: Stepping, members: Sequence[int]
) -> Lean:
    """Leave out of a super-model's simulator what the given model and `members` do not need."""
    everything = np.arange(len(super_model.model.parameters))
    if len(members) == len(super_model.candidates):
        return Lean(simulator, stepping, everything)
    alone = SuperModel.build(super_model.given, [super_model.candidates[i] for i in members])
    order = list(super_model.model.parameters)
    names = _parameter_names(super_model, alone, members)
    parameters = np.array([order.index(names.get(n, n)) for n in alone.model.parameters], dtype=int)
    own = Simulator(alone.model)
    if stepping.smooth is not None and not own.smoothed_arguments:
        stepping = stepping.smooth
    known = dict(zip(simulator.smoothed_arguments, stepping.widths, strict=False))
    least = min(stepping.widths, default=1e-4)
    widths = tuple(known.get(a, least) for a in own.smoothed_arguments)
    stepping = _resolving(stepping, alone.candidates)
    return Lean(own, replace(stepping, widths=widths), parameters)


def _places(parameters: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    place = {int(full): own for own, full in enumerate(parameters)}
    return np.array([place[int(j)] for j in wanted], dtype=int)


def resolved(problem: Problem, super_model: SuperModel, members: Sequence[int]) -> Problem:
    """Return a super-model's problem with as many steps between samples as `members` need."""
    stepping = _resolving(problem.stepping, [super_model.candidates[i] for i in members])
    segments = restepped(problem.segments, stepping, problem.stepping)
    return replace(problem, stepping=stepping, segments=segments)


def _resolving(stepping: Stepping, candidates: Sequence[Candidate]) -> Stepping:
    """Multiply the steps of RK4 until all candidates are followed, or leave RK4."""
    if stepping.method != "rk4":
        return stepping
    if any(c.stiff for c in candidates):  # explicit steps would make a hard edge a kick
        return replace(stepping, method="rodas3", substeps=max(STIFF_STEPS, stepping.substeps))
    factor = max([-(-c.substeps // stepping.substeps) for c in candidates], default=1)
    return replace(stepping, substeps=factor * stepping.substeps)


def restepped(segments: Segments, new: Stepping, old: Stepping) -> Segments:
    """Return segments with the steps between samples of another stepping.

    Between samples inputs are lines or constants, which one step draws as well.
    """
    if new.substeps == old.substeps:
        return segments
    if old.substeps % new.substeps == 0:
        return segments.coarsened(new.substeps)
    if new.substeps % old.substeps:
        segments, old = segments.coarsened(1), replace(old, substeps=1)
    return segments.refined(new.substeps // old.substeps)


def _parameter_names(
    super_model: SuperModel, alone: SuperModel, members: Sequence[int]
) -> dict[str, str]:
    """Name here to name in the super-model, of the candidates' parameters."""
    names = {}
    for here, there in enumerate(members):
        candidate = super_model.candidates[there]
        mine, theirs = alone.names[here], super_model.names[there]
        names |= {mine[own]: theirs[own] for own in mine}
        if candidate.replaced:
            names[candidate.switch(mine)] = candidate.switch(theirs)
    return names


def _state_positions(super_model: SuperModel, members: Sequence[int]) -> np.ndarray:
    """Positions of the given model's states, then of those that members bring along."""
    known = len(super_model.given.states)
    ends = known + np.cumsum([len(c.states) for c in super_model.candidates])
    chosen = list(range(known))
    for number in members:
        count = len(super_model.candidates[number].states)
        chosen += range(int(ends[number]) - count, int(ends[number]))
    return np.array(chosen, dtype=int)


def cropped(result: Fit, problem: Problem, narrow: Segments) -> Fit:
    """Return a fit of segments with margins as one of the segments alone."""
    wide = problem.segments
    offset = narrow.start - wide.start
    size = narrow.time.shape[0]
    rows = np.minimum(np.arange(size)[:, None] + offset, wide.time.shape[0] - 1)
    inside = np.arange(size)[:, None] < narrow.count
    at = np.arange(narrow.number)[None, :]

    def crop(a: np.ndarray) -> np.ndarray:
        return np.where(inside, a[..., rows, at], 0.0)

    path = None if result.path is None else result.path[:, rows, at]
    return replace(
        result,
        residual=crop(result.residual),
        jacobian=crop(result.jacobian),
        by_start=crop(result.by_start),
        path=path,
        x0=result.x0 if path is None else path[:, 0],
    )
