"""Entering a set: estimated in free run, and compared on held-back blocks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.blocks import held_back
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.integration import accurate, rounded_share, steady
from jaxsr.diagnosis.contest.reduced import Reduced, cropped, reduce
from jaxsr.diagnosis.contest.widths import fitted_widths
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models.driven import driven_states
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.lifting import liftable
from jaxsr.models.segments import Segments
from jaxsr.models.shooting import fit

CONTEST_TOLERANCE = 1e-4
"""Gain in cost at which the estimation of a set stops: far below `MIN_GAIN`."""
ITERATIONS = 30
REFRESHES = 1
"""Times that the starts of driven states are renewed at the latest parameters."""


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
    begun = time.monotonic()
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
        return stop() or time.monotonic() > end

    def estimate(own: Reduced, inner: np.ndarray, course: np.ndarray | None, near: bool) -> Fit:
        x0, limits = None, (max_iterations, stopped, CONTEST_TOLERANCE)
        problem = own.problem
        if problem.simulator.model.driven:
            start = None if course is None else course[:, 0]
            problem, x0 = _driven(arena, problem, inner, active, start)
        return fit(problem, inner, active, (low, high), x0, *limits, course, near)

    if careful and near and course is not None:
        own = replace(own, problem=accurate(steady(own.problem, inner), inner, course))
    sharp = any(super_model.candidates[i].sharp for i in members)
    refreshes = REFRESHES if super_model.remembers(members) and full else 0
    for _ in range(1 + refreshes):
        result = estimate(own, inner, course, near)
        moved = np.abs(result.theta - inner) > 1e-3 * np.abs(inner)
        inner, course = result.theta, result.path
        if not own.problem.simulator.model.driven or not moved.any() or not result.usable:
            break
    share = 0.0
    asked = not near if fit_widths is None else fit_widths
    careful = careful and result.cost <= worth
    if careful and sharp and asked and arena.jumps is not None:

        def anew(wider: Problem, found: Fit) -> Fit:
            trial = replace(own, problem=wider)
            return found if stopped() else estimate(trial, found.theta, found.path, near=True)

        fitting, result = fitted_widths(arena.jumps, own.problem, result, anew)
        own, inner, course = replace(own, problem=fitting), result.theta, result.path
    if careful and result.usable and course is not None:
        finer = replace(own, problem=accurate(steady(own.problem, inner), inner, course))
        if finer.problem.stepping != own.problem.stepping and not stopped():
            again = estimate(finer, inner, course, near=True)
            if again.usable and again.path is not None:
                own, result, inner, course = finer, again, again.theta, again.path
        if sharp:
            share = rounded_share(own.problem, inner, course)
    result = own.restored(result, theta, problem.segments)
    if late:
        result = cropped(result, problem, arena.problem.segments)
    errors = held_back(arena.pieces, arena.problem.segments, result)
    finest = own.problem.stepping
    stepping = None
    if finest != given:
        known = dict(zip(own.problem.simulator.smoothed_arguments, finest.widths, strict=True))
        everywhere = arena.problem.simulator.smoothed_arguments
        before = zip(everywhere, arena.problem.stepping.widths, strict=False)
        stepping = replace(finest, widths=tuple(known.get(a, w) for a, w in before))
    return Entry(members, result, errors, stepping, share, time.monotonic() - begun)


def _refinable(arena: Arena, members: tuple[int, ...]) -> bool:
    """Whether steps can be refined: hard edges have a method of their own."""
    stiff = any(arena.super_model.candidates[i].stiff for i in members)
    return not stiff and liftable(arena.problem.simulator)


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


def active_parameters(super_model: SuperModel, members: tuple[int, ...]) -> np.ndarray:
    """Free parameters of the given model and all parameters of the members."""
    index = [*super_model.base_index(), *(j for i in members for j in super_model.index(i))]
    return np.array(sorted(set(index)), dtype=int)
