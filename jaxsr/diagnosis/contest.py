"""The contest: sets of candidates estimated in free run and compared on held-back blocks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from jaxsr.diagnosis.blocks import held_back
from jaxsr.diagnosis.candidates import SuperModel
from jaxsr.diagnosis.integration import accurate, rounded_share, steady, with_steps
from jaxsr.diagnosis.reduced import Reduced, cropped, reduce
from jaxsr.diagnosis.widths import BEGIN, Jumps, fitted_widths
from jaxsr.models import Model
from jaxsr.models.driven import driven_states
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.lifting import liftable
from jaxsr.models.model import FREE
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments, cut, told
from jaxsr.models.shooting import fit
from jaxsr.models.simulator import Simulator

BLOCKS = 12
CONTEST_TOLERANCE = 1e-4
"""Gain in cost at which the estimation of a set stops: far below `MIN_GAIN`."""
ITERATIONS = 30
MARGIN = 25
"""Samples simulated before and after a segment where signals are delayed or remembered: the
longest delay that a segment can tell."""
REFRESHES = 1
"""Times that the starts of driven states are renewed at the latest parameters."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One set of candidates after estimation in free run.

    Attributes
    ----------
    members : tuple of int
    fit : Fit
    errors : ndarray, shape (blocks,)
        Mean squared scaled residual of each block, estimated without it.
    stepping : Stepping, optional
        How it was integrated, where it asked for other steps or widths than the arena's.
    rounded : float
        Share of its cost that is the doing of how its jumps are rounded.
    seconds : float
        Time that its estimation took.
    """

    members: tuple[int, ...]
    fit: Fit
    errors: np.ndarray
    stepping: Stepping | None = None
    rounded: float = 0.0
    seconds: float = 0.0

    @property
    def error(self) -> float:
        """Geometric mean over the blocks."""
        return float(np.exp(np.mean(np.log(self.errors + 1e-300))))

    def lost(self) -> Entry:
        """Return the entry as one that could not be simulated."""
        return replace(
            self, fit=replace(self.fit, cost=np.inf), errors=np.full_like(self.errors, np.inf)
        )

    def scaled(self, factor: float) -> Entry:
        """Return the entry with residuals divided by a factor."""
        fitted = self.fit
        fitted = replace(
            fitted,
            cost=fitted.cost / factor**2,
            residual=fitted.residual / factor,
            jacobian=fitted.jacobian / factor,
            by_start=fitted.by_start / factor,
        )
        return replace(self, fit=fitted, errors=self.errors / factor**2)


@dataclass(frozen=True, eq=False)
class Arena:
    """What all entries share: the super-model, its segments, and the blocks held back in turn."""

    super_model: SuperModel
    problem: Problem
    prepared: tuple[Prepared, ...]
    bounds: tuple[np.ndarray, np.ndarray]
    pieces: tuple[tuple[int, int, int, int], ...]  # (block, segment, from sample, to sample)
    seconds: float  # length of the segments
    wide: Problem | None = None  # the same with margins, for signals that come late
    patience: float = np.inf  # seconds after which the estimation of a set stops
    jumps: Jumps | None = None  # whose widths are estimated

    def has_jumps(self, entry: Entry) -> bool:
        """Whether an entry has a law that jumps."""
        return any(self.super_model.candidates[i].sharp for i in entry.members)


def parameter_bounds(super_model: SuperModel) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of every parameter of the super-model."""
    order = list(super_model.model.parameters.items())
    low = np.array([p.bounds[0] if p.bounds else -np.inf for _, p in order])
    high = np.array([p.bounds[1] if p.bounds else np.inf for _, p in order])
    names = [n for n, _ in order]
    for candidate in super_model.candidates:
        if candidate.fixed_parameter is not None:
            at, spec = names.index(candidate.fixed_parameter), candidate.parameters[0]
            low[at], high[at] = spec.low, spec.high
    return low, high


def neutral_values(super_model: SuperModel) -> np.ndarray:
    """Parameter values at which the super-model is the given model."""
    return np.array([p.value for p in super_model.model.parameters.values()], dtype=float)


def build_arena(
    super_model: SuperModel,
    prepared: Sequence[Prepared],
    stepping: Stepping,
    horizon: float | None,
    scale: np.ndarray,
    simulator: Simulator,
    like: Arena | None = None,
) -> Arena:
    """Cut the recordings into segments of `horizon` seconds and lay out the blocks.

    Patience, and the least widths of jumps, are those of the arena `like` that came before.
    """
    rows = cut(prepared, horizon)
    model, steps = super_model.model, stepping.substeps
    wide = None
    if model.driven or _shifts(model):
        margins = build_segments(model, prepared, rows, steps, margin=MARGIN)
        if liftable(simulator):
            # All sets are judged on the samples that those with margins can tell.
            wide = Problem(simulator, stepping, margins, scale)
            begun = [_begun(model, prepared[row[0]], row) for row in rows]
            segments = _as_far_as(build_segments(model, prepared, begun, steps), margins)
        else:
            segments = margins
    else:
        segments = build_segments(model, prepared, rows, steps)
    problem = Problem(simulator, stepping, segments, scale)
    pieces = _pieces(segments.count)
    bounds = parameter_bounds(super_model)
    jumps, patience = None, np.inf if like is None else like.patience
    if liftable(simulator):
        known = None if like is None else like.jumps
        jumps = Jumps.of(problem, Simulator(super_model.given), known)
    seconds = horizon or np.inf
    shared = super_model, problem, tuple(prepared), bounds, pieces, seconds, wide
    return Arena(*shared, patience, jumps)


def _begun(model: Model, item: Prepared, row: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return a row from its first judged sample on, unless its start is given.

    A start that is sought long before the first reading can be lost on the way: a body that
    sticks tells nothing of how it came.
    """
    recording, first, last = row
    if any(model.initial.get(s, FREE) != FREE for s in model.states if s not in model.driven):
        return row
    return recording, max(first, told(model, item, row, MARGIN)[0]), last


def _as_far_as(narrow: Segments, wide: Segments) -> Segments:
    """Leave out the samples that are left out of the segments with margins."""
    rows = np.arange(narrow.time.shape[0])[:, None] + narrow.start - wide.start
    rows = np.minimum(rows, wide.time.shape[0] - 1)
    known = np.isfinite(wide.outputs[:, rows, np.arange(narrow.number)[None, :]])
    return replace(narrow, outputs=np.where(known, narrow.outputs, np.nan))


def _shifts(model: Model) -> bool:
    """Whether a delay or a clock can be estimated."""
    return bool(model.clock) or any(isinstance(d, str) for d in model.delays.values())


def _pieces(counts: np.ndarray) -> tuple[tuple[int, int, int, int], ...]:
    """Assign segments, or stretches of them where they are few, to blocks."""
    if counts.size >= 8:
        block = np.minimum(np.arange(counts.size) * BLOCKS // counts.size, BLOCKS - 1)
        return tuple((int(block[s]), s, 0, int(n)) for s, n in enumerate(counts))
    each = int(np.ceil(BLOCKS / counts.size))
    pieces, number = [], 0
    for s, count in enumerate(counts):
        edges = np.linspace(0, count, each + 1).astype(int)
        for a, b in pairwise(edges):
            if b - a >= 2:
                pieces.append((number, s, int(a), int(b)))
                number += 1
    return tuple(pieces)


def enter(
    arena: Arena,
    members: tuple[int, ...],
    start: np.ndarray,
    path: np.ndarray | None = None,
    stop: Callable[[], bool] = lambda: False,
    max_iterations: int = ITERATIONS,
    near: bool = False,
    fit_widths: bool | None = None,
) -> Entry:
    """Estimate one set jointly with the free parameters and the starts, and hold blocks back.

    `path` is where the states are sought, as another entry's fit has them; `near` says that they
    are nearly there, and with that, unless `fit_widths`, that its jumps are as wide as the arena's.
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
    careful = max_iterations >= ITERATIONS and _refinable(arena, members)
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
    for _ in range(1 + REFRESHES * super_model.remembers(members)):
        result = estimate(own, inner, course, near)
        moved = np.abs(result.theta - inner) > 1e-3 * np.abs(inner)
        inner, course = result.theta, result.path
        if not own.problem.simulator.model.driven or not moved.any() or not result.usable:
            break
    share = 0.0
    asked = not near if fit_widths is None else fit_widths
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


def in_steps_of(arena: Arena, entry: Entry) -> Arena:
    """Return the arena with the steps and widths that the laws of one entry asked for."""
    if entry.stepping is None:
        return arena
    steps, widths = (entry.stepping.method, entry.stepping.substeps), entry.stepping.widths

    def stepped(problem: Problem) -> Problem:
        problem = with_steps(problem, *steps)
        stepping = replace(problem.stepping, smooth=None, widths=widths)
        return replace(problem, stepping=stepping)

    wide = None if arena.wide is None else stepped(arena.wide)
    return replace(arena, problem=stepped(arena.problem), wide=wide)


def in_widths(arena: Arena, widths: tuple[float, ...]) -> Arena:
    """Return the arena with other widths of jumps."""

    def rounded(problem: Problem) -> Problem:
        return replace(problem, stepping=replace(problem.stepping, widths=widths))

    wide = None if arena.wide is None else rounded(arena.wide)
    return replace(arena, problem=rounded(arena.problem), wide=wide)


def in_sharpest_widths(arena: Arena) -> Arena:
    """Return the arena with jumps as sharp as it knows them."""
    widths = arena.problem.stepping.widths
    if arena.jumps is not None:
        arguments, least = arena.problem.simulator.smoothed_arguments, arena.jumps.sharpest
        widths = tuple(least.get(a, w) for a, w in zip(arguments, widths, strict=False))
    return in_widths(arena, widths)


def with_rounded_jumps(arena: Arena) -> Arena:
    """Return the arena with jumps as wide as the search for their widths begins."""
    begun = None if arena.jumps is None else arena.jumps.widened(arena.problem, BEGIN)
    return arena if begun is None else in_widths(arena, begun.stepping.widths)


def in_widths_of_best(arena: Arena, entries: Sequence[Entry]) -> tuple[Arena, list[Entry]]:
    """Let the sets to come begin at the widths of the best one so far."""
    best, before = min(entries, key=lambda e: e.fit.cost), arena.problem.stepping
    if best.stepping is None or best.stepping.widths == before.widths:
        return arena, list(entries)
    kept = [
        replace(e, stepping=before) if arena.has_jumps(e) and e.stepping is None else e
        for e in entries
    ]
    return in_widths(arena, best.stepping.widths), kept


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
