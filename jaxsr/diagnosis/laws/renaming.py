"""Renaming: a law that was chosen without a name gets the names it has once it is estimated."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.criteria import criterion, independent_residuals
from jaxsr.diagnosis.laws.naming import named
from jaxsr.diagnosis.laws.newcomers import with_candidates
from jaxsr.diagnosis.laws.unnamed import Law
from jaxsr.diagnosis.mechanisms.candidate import UNNAMED
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.search.choice import Decision, decide
from jaxsr.diagnosis.setup import state_scale
from jaxsr.expressions import Term, parse


def with_names(case: Case, decision: Decision) -> Decision:
    """Put named mechanisms in the place of chosen laws that are a sum of them.

    They are estimated anew, and stand where Schwarz's criterion prefers them: a name is shorter
    than a law, so that nothing is left to tell but a difference that the recordings show.
    """
    _, _, chosen, _ = decision
    for number in chosen.members:
        arena, good, chosen, _ = decision
        if arena.super_model.candidates[number].mechanism != UNNAMED or case.search.exhausted:
            continue
        law = names_of(case, arena, chosen, number)
        if number not in chosen.members or not law:
            continue
        case.progress.stage("estimating the mechanisms that a law is a sum of")
        rest = tuple(i for i in chosen.members if i != number)
        known = {frozenset(e.members) for e in good}
        wider, entries = with_candidates(case, (arena, good), chosen, [law], (rest,))
        n = independent_residuals(chosen)
        new = [e for e in entries if frozenset(e.members) not in known and e.fit.usable]
        same = next(e for e in entries if e.members == chosen.members)
        if not new or criterion(wider.super_model, new[0], n) > criterion(
            wider.super_model, same, n
        ):
            continue
        decision = decide(case, wider, [e for e in entries if number not in e.members])
    return decision


def names_of(case: Case, arena: Arena, entry: Entry, number: int) -> Law:
    """Return the mechanisms whose sum a member of an entry is over the entry's free run."""
    super_model, path, model = arena.super_model, entry.fit.path, case.simulator.model
    candidate = super_model.candidates[number]
    state = candidate.site.partition(":")[2]
    site = next(
        (s for s in sites_of(model, state_scale(model, case.prepared)) if s.state == state), None
    )
    if site is None or path is None:
        return ()
    order = list(super_model.model.parameters)
    values = {n: float(entry.fit.theta[order.index(n)]) for n in order}
    own = {n: Term.constant(values[full]) for n, full in super_model.names[number].items()}
    ((_, template),) = candidate.terms
    law = parse(template.format(**{n: n for n in own}).removeprefix("+ ")).substitute(own)
    segments = arena.problem.segments
    inside = np.arange(segments.time.shape[0])[:, None] < segments.count
    signals = {
        model.time: segments.time,
        **dict(zip(model.inputs, segments.inputs, strict=False)),
        **dict(zip(model.states, path, strict=False)),
    }
    seen = {name: np.where(inside, x, np.nan)[inside] for name, x in signals.items()}
    return named(site, law, {**{n: values[n] for n in model.parameters}, **seen})


__all__ = ["names_of", "with_names"]
