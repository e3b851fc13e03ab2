"""Weights of the outputs in free runs: by what the best set so far leaves on each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry


def rescaled(
    arena: Arena, entries: list[Entry], stop: Callable[[], bool]
) -> tuple[Arena, list[Entry]]:
    """Weigh the outputs by the residual that the best set so far leaves on each."""
    leader = min(entries, key=lambda e: e.fit.cost)
    count = arena.problem.segments.weights.sum((1, 2))
    power = (leader.fit.residual**2).sum((1, 2)) / np.maximum(count, 1.0)
    if not np.isfinite(power).all():
        return arena, entries
    factor = np.sqrt(power + 1e-12)
    arena = replace(arena, problem=replace(arena.problem, scale=arena.problem.scale * factor))
    if factor.size == 1:
        return arena, [e.scaled(float(factor[0])) for e in entries]
    again = []
    for e in entries:
        if e.fit.usable and e.follows_as_well_as(entries[0]):
            again.append(enter(arena, e.members, e.fit.theta, e.fit.path, stop, near=True))
        else:  # what does worse than re-calibration is not worth another estimate
            again.append(e.lost())
    return arena, again
