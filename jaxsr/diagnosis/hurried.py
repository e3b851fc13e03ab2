"""What a diagnosis says where time ended before it could decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr._result import StoppedBy
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.scoring import horizons
from jaxsr.diagnosis.judging.detection import SIGNIFICANCE, Detection
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.search.choice import Decision, choose
from jaxsr.models import Simulator
from jaxsr.models.least_squares import Fit
from jaxsr.models.rollout import Stepping
from jaxsr.models.states import spread


def decided_in_time(case: Case) -> tuple[Decision, float, StoppedBy]:
    """Return the best decision so far, its headline's horizon in s, and why the search ended."""
    if not case.so_far:
        return _unestimated(case), horizons(case.prepared)[0], case.search.stopped_by
    arena, entries, headline = case.so_far[-1]
    try:
        good, chosen, detection = choose(case, arena, entries)
    except OutOfTime:
        null = next(e for e in entries if not e.members)
        good, chosen, detection = [null], null, _nothing_tested()
    return (arena, good, chosen, detection), headline, case.search.stopped_by


def _unestimated(case: Case) -> Decision:
    """Return the given values alone: there was no time to run the model with any others."""
    given = case.simulator.model
    super_model = SuperModel.build(given, [])
    simulator = Simulator(super_model.model)
    stepping = Stepping("rk4", 1, tuple(simulator.default_widths))
    scale = 0.01 * spread(np.concatenate([p.outputs for p in case.prepared]))
    setting = super_model, case.prepared, stepping, horizons(case.prepared)[0], scale, simulator
    arena = build_arena(*setting)
    null = _given(arena)
    return arena, [null], null, _nothing_tested()


def _given(arena: Arena) -> Entry:
    """Return the given values as an entry that tells nothing: its derivatives are zero."""
    segments = arena.problem.segments
    theta, active = neutral_values(arena.super_model), arena.super_model.base_index()
    shape = segments.outputs.shape
    by = np.zeros((len(active), *shape)), np.zeros((len(segments.guess), *shape))
    fit = Fit(theta, segments.guess, 1.0, np.zeros(shape), np.array(active, int), *by, False)
    blocks = 1 + max(block for block, *_ in arena.pieces)
    return Entry((), replace(fit, path=segments.course), np.ones(blocks))


def _nothing_tested() -> Detection:
    return Detection(False, 0.0, 1.0, SIGNIFICANCE, SIGNIFICANCE)
