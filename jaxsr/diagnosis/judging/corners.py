"""Laws that jump: estimates led out of the corners of their cost."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.uncertainty import half_widths

CORNER_ROUNDS, CORNER_GAIN = 4, 1e-3
"""Times that a set with jumps is estimated from all sides, and the gain that asks for another."""
AS_PROBABLE = 4.0
"""Twice the log likelihood ratio up to which two minima are as probable."""


def out_of_corners(
    arena: Arena, entry: Entry, stop: Callable[[], bool] = lambda: False
) -> tuple[Entry, np.ndarray]:
    """Estimate a set with jumps again from beside its estimate.

    Which samples stick changes by jumps while parameters move, and the cost has a corner at
    each: from half a confidence interval to either side of every constant it may fall further.
    Returned are the best, and twice the spread of those that are as probable.
    """
    candidates = arena.super_model.candidates
    none = np.zeros_like(entry.fit.theta)
    if not any(candidates[i].sharp for i in entry.members) or not entry.fit.usable:
        return entry, none
    low, high = arena.bounds
    best, trials = entry, [entry]
    for _ in range(CORNER_ROUNDS):
        half = none.copy()
        half[best.fit.active] = half_widths(arena, best.fit)
        start = best
        for j in (j for i in entry.members for j in arena.super_model.index(i)):
            for share in (-1.0, 1.0):
                if stop():
                    break
                theta = start.fit.theta.copy()
                theta[j] = np.clip(theta[j] + share * half[j], low[j], high[j])
                trial = enter(arena, entry.members, theta, start.fit.path, stop, near=True)
                if trial.fit.usable:
                    trials.append(trial)
                    best = min(best, trial, key=lambda e: e.fit.cost)
        if best.fit.cost > (1.0 - CORNER_GAIN) * start.fit.cost:
            break
    n = independent_residuals(best)
    near = [t for t in trials if n * np.log(t.fit.cost / best.fit.cost) < AS_PROBABLE]
    spread = np.std(np.stack([t.fit.theta for t in near]), axis=0)
    return best, 2.0 * spread
