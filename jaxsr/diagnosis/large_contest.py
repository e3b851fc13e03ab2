"""The contest of a model with many equations: one large set, and what could replace its members."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr._result import StoppedBy
from jaxsr.diagnosis.candidates import SuperModel
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.choice import Decision, choose
from jaxsr.diagnosis.contenders import Start, carried
from jaxsr.diagnosis.contest import Arena, enter
from jaxsr.diagnosis.horizon import Outlook
from jaxsr.diagnosis.integration import choose_stepping, rounded_explicit
from jaxsr.diagnosis.many_equations import many_equations
from jaxsr.diagnosis.output_weights import rescaled
from jaxsr.models import Simulator

WHOLE, RIVAL, PART = 12, 6, 2
"""Iterations of the whole set, of what could stand in a member's place, and of what is left
without one: begun near the whole, a bad one is told soon."""
PATIENCE = 0.2
"""Share of the time budget after which the estimation of the whole set stops where it is."""


def with_many_equations(case: Case) -> bool:
    """Whether mechanisms were screened at each of many equations."""
    return case.screened is not None and many_equations(case.screened.system)


def decided_among_many(case: Case) -> tuple[Decision, float, StoppedBy]:
    """Return the decision, its headline's horizon in s, and why no more sets were tried.

    The weak view has chosen a mechanism or more at every equation. Free runs estimate them
    together, compare them with re-calibration, and then with the sets in which one of them is
    missing, or another stands in its place, for as long as there is time. A free run of many
    sharp friction laws is stiff: theirs are rounded until explicit steps do.
    """
    assert case.screened is not None
    screened, stop = case.screened, lambda: case.search.exhausted
    used = sorted({i for s in screened.screening.sets for i in s.members})
    given, candidates = case.simulator.model, screened.super_model.candidates
    super_model = SuperModel.build(given, [candidates[i] for i in used])
    starts = [
        (tuple(used.index(i) for i in s.members), carried(screened, super_model, used, s))
        for s in screened.screening.sets
    ]
    leading, empty = starts[0], next(start for start in starts if not start[0])
    others = [start for start in starts if start[0] not in (leading[0], ())]
    arena, headline = _arena(case, super_model, [empty, leading])
    case.progress.stage(f"estimating {len(leading[0])} mechanisms together in free run")
    null = enter(arena, *empty, max_iterations=WHOLE)
    patient = replace(arena, patience=PATIENCE * case.budget.seconds)
    entries = [null]
    if leading[0]:  # else nothing gains at any equation
        entries.append(enter(patient, *leading, stop=stop, max_iterations=WHOLE))
    arena, entries = rescaled(patient, entries, stop)
    whole = entries[-1]
    case.progress.stage(f"comparing it with {len(others)} sets that lack or replace one of them")
    others.sort(key=lambda other: len(other[0]))
    for number, (members, start) in enumerate(others):
        if case.search.exhausted or not whole.fit.usable:
            break
        case.progress.update(number / len(others), f"set {number + 1}")
        shared = [super_model.index(i) for i in set(members) & set(whole.members)]
        kept = [*super_model.base_index(), *(j for index in shared for j in index)]
        start[kept] = whole.fit.theta[kept]
        most = RIVAL if len(members) == len(whole.members) else PART
        entries.append(enter(arena, members, start, whole.fit.path, stop, most))
    case.progress.stage("deciding")
    good, chosen, detection = choose(case, arena, entries)
    good += [e for e in entries if set(e.members) < set(chosen.members) and e not in good]
    return (arena, good, chosen, detection), headline, case.search.stopped_by


def _arena(case: Case, super_model: SuperModel, starts: list[Start]) -> tuple[Arena, float]:
    """Cut the recordings into segments; return the arena and the horizon of the verdict in s."""
    case.progress.stage("choosing integration steps and the horizon")
    simulator = Simulator(super_model.model, case.simulator.function)
    stepping = choose_stepping(simulator, case.prepared, starts[1][1])
    stepping = rounded_explicit(stepping, simulator, case.prepared, starts[1][1])
    deviation = np.nanstd(np.concatenate([p.outputs for p in case.prepared]), axis=0)
    scale = np.where(deviation > 0, 0.01 * deviation, 1.0)
    outlook = Outlook(super_model, case.prepared, stepping, scale, simulator)
    starts = outlook.usable_starts(starts)
    headline = outlook.headline(starts)
    return outlook.first_usable(headline, starts[0][1]), headline.seconds
