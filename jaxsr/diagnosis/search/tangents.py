"""Tangents: how the readings of an entry move with the coefficients of every candidate."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena, in_steps_of
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.reduced import reduce
from jaxsr.diagnosis.contest.tangent import Tangent
from jaxsr.diagnosis.mechanisms.site import grows_in_proportion
from jaxsr.models.lifting import one_step, readings_along
from jaxsr.models.sensitivity import condensed


@lru_cache(maxsize=6)
def tangent_about(arena: Arena, centre: Entry) -> Tangent:
    """Linearise about the path of an entry, in its own steps; what was asked before is kept.

    Where a state hides, no course of a memory is known, and candidates with states are left out.
    """
    super_model = arena.super_model
    hidden = any(p.states.hidden for p in arena.prepared)
    others = [
        i
        for i, c in enumerate(super_model.candidates)
        if i not in centre.members and grows_in_proportion(c) and not (hidden and c.states)
    ]
    problem = in_steps_of(arena, centre).problem
    return Tangent.of(problem, super_model, centre.members, centre.fit, others)


def change(arena: Arena, centre: Entry, members: tuple[int, ...], theta: np.ndarray) -> np.ndarray:
    """What other values change in the scaled readings, to first order about an entry's path.

    Parameters
    ----------
    members : tuple of int
        All candidates that act at `theta`, or in the entry.
    theta : ndarray, shape (parameters,)
        Of the super-model.

    Returns
    -------
    ndarray, shape (outputs, samples, segments)
    """
    super_model = arena.super_model
    own = reduce(in_steps_of(arena, centre).problem, super_model, tuple(sorted(members)))
    problem, path = own.problem, centre.fit.path
    assert path is not None
    path, setting = path[own.states], (problem.simulator, problem.stepping, problem.segments)
    known = super_model.switched(centre.members, centre.fit.theta)[own.parameters]
    ends, slopes = one_step(*setting, known, path)
    others, _ = one_step(*setting, theta[own.parameters], path, tangents=False)
    _, apart = condensed(slopes, others - ends)
    before, by = readings_along(*setting, known, path)
    after, _ = readings_along(*setting, theta[own.parameters], path)
    moved = np.einsum("oits,its->ots", by, apart) + after - before
    weight = problem.segments.weights / problem.scale[:, None, None]
    return np.where(weight > 0.0, moved * weight, 0.0)
