"""What is named of a set that free runs chose."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.alternatives import (
    likelier_with,
    likelier_without,
    without_doubtful,
)
from jaxsr.diagnosis.judging.parsimony import simpler
from jaxsr.diagnosis.search.choice import PRUNING, Decision, ablate
from jaxsr.diagnosis.search.nesting import simplified


def believed(case: Case, decision: Decision, allow: Callable[[float], bool], seed: int) -> Decision:
    """Return a decision with what is named of its set as the chosen one.

    Parameters
    ----------
    case : Case
    decision : Decision
    allow : callable
        Whether a claim of a probability is made.
    seed : int
        Of the bootstrap behind the probabilities.
    """
    arena, entries, chosen, detection = decision
    pruning = case.budget.share(PRUNING)

    def stop() -> bool:
        return pruning.exhausted

    every, before = arena.super_model, chosen
    null = next(e for e in entries if not e.members)
    chosen = likelier_with(every, chosen, entries, np.random.default_rng(seed))
    entries, chosen = plainest(arena, chosen, entries, stop)
    if chosen is not before:
        smaller = ablate(arena, chosen, entries, stop)
        known = {e.members for e in smaller}
        entries = [e for e in entries if e is chosen or e.members not in known] + smaller
    chosen = without_doubtful(every, chosen, entries, allow, np.random.default_rng(seed))
    if likelier_without(every, chosen, entries, np.random.default_rng(seed)):
        chosen = null
    entries, chosen = estimated(arena, chosen, entries, before, stop)
    return arena, entries, chosen, detection


def estimated(
    arena: Arena,
    chosen: Entry,
    entries: Sequence[Entry],
    before: Entry,
    stop: Callable[[], bool] = lambda: False,
) -> tuple[list[Entry], Entry]:
    """Return a chosen set as free runs estimate it, where it was only expected by one step.

    The set `before` stands where free runs cannot follow it.
    """
    if chosen.fit.linearised:
        return list(entries), chosen
    fit = chosen.fit
    entry = enter(arena, chosen.members, fit.theta, fit.path, stop, near=True)
    if not entry.fit.usable:
        return [e for e in entries if e is not chosen], before
    return [entry if e is chosen else e for e in entries], entry


def plainest(
    arena: Arena, chosen: Entry, entries: Sequence[Entry], stop: Callable[[], bool]
) -> tuple[list[Entry], Entry]:
    """Put the laws inside richer ones in their places as long as what is left allows no richer.

    They are estimated from where those ended, if they were not yet.
    """
    entries = list(entries)
    while True:
        forms = dict(simplified(arena.super_model, chosen.members, chosen.fit.theta))
        for members in sorted(forms.keys() - {e.members for e in entries}):
            if not stop():
                path = chosen.fit.path
                entries.append(enter(arena, members, forms[members], path, stop, near=True))
        fewer = simpler(chosen, arena, [e for e in entries if e.members in forms])
        if fewer is None:
            return entries, chosen
        chosen = fewer
