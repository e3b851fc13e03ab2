"""Entering a set: estimated in free run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxsr._clock import now
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.carried import carried_on, starts_told
from jaxsr.diagnosis.shooting.entry import Entry, told_starts
from jaxsr.diagnosis.shooting.estimation import Estimation
from jaxsr.diagnosis.shooting.integration import accurate, steady
from jaxsr.diagnosis.shooting.reduced import cropped, reduce
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Segments

ITERATIONS = 30
REFRESHES = 3
"""Times that the starts of driven states are renewed at the latest parameters: each brings the cost
about ten times nearer to its least, and where these rest it ends."""


def enter(
    arena: Arena,
    members: tuple[int, ...],
    start: np.ndarray,
    path: np.ndarray | None = None,
    stop: Callable[[], bool] = lambda: False,
    max_iterations: int = ITERATIONS,
    near: bool = False,
) -> Entry:
    """Estimate one set jointly with the free parameters and the starts.

    `path` is where the states are sought, as another entry's fit has them; `near` says that they
    are nearly there, and with that, that its jumps are as wide as the arena's.
    """
    super_model = arena.super_model
    problem = arena.problem
    begun = now()
    end = begun + arena.patience
    late = arena.wide is not None and late_members(super_model, members)
    if late and arena.wide is not None:
        problem = replace(arena.wide, scale=problem.scale)
        path = None if path is None else _extended(path, arena.problem.segments, problem.segments)
    own = reduce(problem, super_model, members)
    low, high = (bound[own.parameters] for bound in arena.bounds)
    active = own.active(active_parameters(super_model, members))
    theta = super_model.switched(members, start)
    inner, course = theta[own.parameters], None if path is None else path[own.states]
    full = max_iterations >= ITERATIONS
    careful = full and _refinable(arena, members)
    given = own.problem.stepping

    def stopped() -> bool:
        return stop() or now() > end

    if careful and near and course is not None:
        own = replace(own, problem=accurate(steady(own.problem, inner), inner, course))
    estimate = Estimation(arena, (low, high), active, stopped, max_iterations)
    refreshes = REFRESHES if super_model.remembers(members) and full else 0
    result = estimate.renewed(own, inner, course, near, refreshes)
    if full and not starts_told(super_model, arena.prepared):
        result = carried_on(arena, estimate, own, result)
    if careful:
        sharp = any(super_model.candidates[i].sharp for i in members)
        if sharp and not near and arena.jumps is not None:
            own, result = estimate.widened(own, result, arena.jumps)
        own, result = estimate.finer(own, result)
    result = own.restored(result, theta, problem.segments)
    if late:
        result = cropped(result, problem, arena.problem.segments)
    changed = own.problem.stepping != given
    stepping = _everywhere(arena, own.problem) if changed else None
    took, steps = now() - begun, arena.converters
    return Entry(members, result, stepping, took, steps, told_starts(result))


def _refinable(arena: Arena, members: tuple[int, ...]) -> bool:
    """Whether steps can be refined: hard edges have a method of their own."""
    return not any(arena.super_model.candidates[i].stiff for i in members)


def _everywhere(arena: Arena, problem: Problem) -> Stepping:
    """The stepping of a set's own problem, with the arena's widths for jumps that are not in it."""
    finest = problem.stepping
    known = dict(zip(problem.simulator.smoothed_arguments, finest.widths, strict=True))
    everywhere = arena.problem.simulator.smoothed_arguments
    before = zip(everywhere, arena.problem.stepping.widths, strict=False)
    return replace(finest, widths=tuple(known.get(a, w) for a, w in before))


def _extended(path: np.ndarray, narrow: Segments, wide: Segments) -> np.ndarray:
    """A path in segments with margins: where the states are known there, and the path inside."""
    result = wide.course.copy()
    for s, (first, count) in enumerate(zip(narrow.start - wide.start, narrow.count, strict=True)):
        result[:, first : first + count, s] = path[:, :count, s]
    return result


def late_members(super_model: SuperModel, members: Sequence[int]) -> bool:
    """Whether a member shifts signals in time or remembers them."""
    return shifting_members(super_model, members) or super_model.remembers(members)


def shifting_members(super_model: SuperModel, members: Sequence[int]) -> bool:
    """Whether a member shifts signals in time."""
    chosen = [super_model.candidates[i] for i in members]
    return any(c.delays or c.clock for c in chosen)


def active_parameters(super_model: SuperModel, members: tuple[int, ...]) -> np.ndarray:
    """Free parameters of the given model and all parameters of the members."""
    index = [*super_model.base_index(), *(j for i in members for j in super_model.index(i))]
    return np.array(sorted(set(index)), dtype=int)
