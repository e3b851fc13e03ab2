"""What a diagnosis says where nothing was weighed, or time ended before it could decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.calibrating.opening import opening
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.decision import Decision
from jaxsr.diagnosis.mechanisms.super_model import SuperModel, one_of_each
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.scoring import horizons
from jaxsr.models import Simulator
from jaxsr.models.least_squares import Fit
from jaxsr.models.rollout import Stepping
from jaxsr.models.states import spread


def unweighed(case: Case) -> Decision:
    """Return re-calibration alone, where no mechanism could be weighed."""
    seen = () if case.seen is None else case.seen.candidates
    super_model = SuperModel.build(case.simulator.model, one_of_each(seen))
    arena, null, headline, _ = opening(case, super_model, [((), neutral_values(super_model))])
    return Decision(arena, [null], null, headline.seconds, case.search.stopped_by)


def decided_in_time(case: Case) -> Decision:
    """Return what is known where time is over: re-calibration, or the given values."""
    arena, null, seconds = case.so_far[-1] if case.so_far else _unestimated(case)
    return Decision(arena, [null], null, seconds, case.search.stopped_by)


def _unestimated(case: Case) -> tuple[Arena, Entry, float]:
    """Return the given values alone: there was no time to run the model with any others."""
    given = case.simulator.model
    super_model = SuperModel.build(given, [])
    simulator = Simulator(super_model.model)
    stepping = Stepping("rk4", 1, tuple(simulator.default_widths))
    scale = 0.01 * spread(np.concatenate([p.outputs for p in case.prepared]))
    setting = super_model, case.prepared, stepping, horizons(case.prepared)[0], scale, simulator
    arena = build_arena(*setting)
    return arena, _given(arena), horizons(case.prepared)[0]


def _given(arena: Arena) -> Entry:
    """Return the given values as an entry that tells nothing: its derivatives are zero."""
    segments = arena.problem.segments
    theta, active = neutral_values(arena.super_model), arena.super_model.base_index()
    shape = segments.outputs.shape
    by = np.zeros((len(active), *shape)), np.zeros((len(segments.guess), *shape))
    fit = Fit(theta, segments.guess, 1.0, np.zeros(shape), np.array(active, int), *by, False)
    return Entry((), replace(fit, path=segments.course))
