"""Entering a set: estimated in free run, and compared on held-back blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxsr._clock import now
from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.blocks import held_back
from jaxsr.diagnosis.contest.carried import carried_on, starts_told
from jaxsr.diagnosis.contest.entry import Entry, told_starts
from jaxsr.diagnosis.contest.estimation import Estimation
from jaxsr.diagnosis.contest.integration import accurate, rounded_share, steady
from jaxsr.diagnosis.contest.reduced import cropped, reduce
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
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
    fit_widths: bool | None = None,
    worth: float = np.inf,
) -> Entry:
    """Estimate one set jointly with the free parameters and the starts, and hold blocks back.

    `path` is where the states are sought, as another entry's fit has them; `near` says that they
    are nearly there, and with that, unless `fit_widths`, that its jumps are as wide as the arena's.
    For a cost above `worth`, neither widths nor finer steps are sought.
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
    share = 0.0
    if careful and result.cost <= worth:
        sharp = any(super_model.candidates[i].sharp for i in members)
        asked = not near if fit_widths is None else fit_widths
        if sharp and asked and arena.jumps is not None:
            own, result = estimate.widened(own, result, arena.jumps)
        own, result = estimate.finer(own, result)
        if sharp and result.usable and result.path is not None:
            share = rounded_share(own.problem, result.theta, result.path)
    result = own.restored(result, theta, problem.segments)
    if late:
        result = cropped(result, problem, arena.problem.segments)
    errors = held_back(arena.pieces, arena.problem.segments, result)
    changed = own.problem.stepping != given
    stepping = _everywhere(arena, own.problem) if changed else None
    took, steps = now() - begun, arena.converters
    return Entry(members, result, errors, stepping, share, took, steps, told_starts(result))


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
