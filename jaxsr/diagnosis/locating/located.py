"""Forces that free runs locate better than the weak view: pushes, waves, resonances, springs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.locating.pushes import push_candidates
from jaxsr.diagnosis.locating.resonances import resonance_candidates
from jaxsr.diagnosis.locating.responses import Responses
from jaxsr.diagnosis.locating.springs import spring_candidates
from jaxsr.diagnosis.locating.waves import wave_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import Simulator


def with_located(
    arena: Arena, entries: list[Entry], stop: Callable[[], bool] = lambda: False
) -> tuple[Arena, list[Entry]]:
    """Return the arena and its entries with candidates for forces that stand out.

    `stop` is asked now and then: what stood out until it says so is returned.
    """
    null = next(e for e in entries if not e.members)
    if null.fit.path is None or not null.fit.usable:
        return arena, entries
    responses = Responses.of(arena, null, sites_of(arena.super_model.given, {}))
    candidates = [
        *push_candidates(arena, null, responses, stop),
        *wave_candidates(arena, null, responses, stop),
        *resonance_candidates(arena, null, responses, stop),
        *spring_candidates(arena, null, responses, stop),
    ]
    return _joined(arena, entries, candidates) if candidates else (arena, entries)


def _joined(
    arena: Arena, entries: list[Entry], candidates: list[Candidate]
) -> tuple[Arena, list[Entry]]:
    """Build the arena again with more candidates; the entries keep their estimates."""
    old = arena.super_model
    super_model = SuperModel.build(old.given, [*old.candidates, *candidates])
    new = build_arena(
        super_model,
        arena.prepared,
        arena.problem.stepping,
        arena.seconds,
        arena.problem.scale,
        Simulator(super_model.model),
        arena,
    )
    added = neutral_values(super_model)[len(old.model.parameters) :]
    segments = new.problem.segments
    if not np.array_equal(segments.start, arena.problem.segments.start):
        thetas = [np.concatenate([e.fit.theta, added]) for e in entries]
        return new, [enter(new, e.members, t) for e, t in zip(entries, thetas, strict=True)]
    longer = [replace(e, fit=e.fit.extended(added, segments)) for e in entries]
    if not np.array_equal(segments.outputs, arena.problem.segments.outputs, equal_nan=True):
        # what remembers leaves the first samples out, for all sets alike
        longer = [enter(new, e.members, e.fit.theta, e.fit.path, near=True) for e in longer]
    return new, longer
