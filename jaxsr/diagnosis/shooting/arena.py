"""The arena: what all sets in free run share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.converters import Converters, converters_of
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.integration import with_steps
from jaxsr.diagnosis.shooting.widths import BEGIN, Jumps
from jaxsr.models import Model
from jaxsr.models.least_squares import Problem
from jaxsr.models.model import FREE
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments, cut, told
from jaxsr.models.simulator import Simulator

BLOCKS = 12
MARGIN = 25
"""Samples simulated before and after a segment where signals are delayed or remembered: the
longest delay that a segment can tell."""


@dataclass(frozen=True, eq=False)
class Arena:
    """What all entries share: the super-model, its segments, and blocks of them.

    How gradients spread over the blocks tells intervals.
    """

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

    @property
    def converters(self) -> Converters:
        """Converters of the residuals as they are scaled here."""
        own = converters_of(self.super_model.given, self.prepared)
        return own.scaled(self.problem.scale)


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
        # All sets are judged on the samples that those with margins can tell.
        wide = Problem(simulator, stepping, margins, scale)
        begun = [_begun(model, prepared[row[0]], row) for row in rows]
        segments = _as_far_as(build_segments(model, prepared, begun, steps), margins)
    else:
        segments = build_segments(model, prepared, rows, steps)
    problem = Problem(simulator, stepping, segments, scale)
    pieces = _pieces(segments.count)
    bounds = parameter_bounds(super_model)
    patience = np.inf if like is None else like.patience
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


def in_sharpest_widths(arena: Arena, factor: float = 1.0) -> Arena:
    """Return the arena with jumps as sharp as it knows them, or `factor` times as wide."""
    widths = arena.problem.stepping.widths
    if arena.jumps is not None:
        arguments, least = arena.problem.simulator.smoothed_arguments, arena.jumps.sharpest
        known = zip(arguments, widths, strict=False)
        widths = tuple(factor * least[a] if a in least else w for a, w in known)
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
