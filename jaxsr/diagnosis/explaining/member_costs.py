"""Squared errors of a set of mechanisms and of the sets inside it, from what a search estimated."""

from __future__ import annotations

import contextlib

import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr._progress import Budget
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.explaining.value_findings import REFINING
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry


def costs_of_sets(
    parts: Ingredients, entry: Entry, hurried: bool = False
) -> dict[frozenset[int], float]:
    """Return the squared errors of the sets that were estimated, and of a set less each member.

    The latter are estimated where none was and time is left, unless that is `hurried`.
    """
    costs: dict[frozenset[int], float] = {}
    for known in (*parts.entries, parts.null):
        members = frozenset(known.members)
        costs[members] = min(known.fit.cost, costs.get(members, np.inf))
    for number in () if hurried else entry.members:
        rest = tuple(i for i in entry.members if i != number)
        budget = parts.case.budget.share(REFINING)
        if not np.isfinite(costs.get(frozenset(rest), np.inf)) and not budget.exhausted:
            with contextlib.suppress(OutOfTime):
                costs[frozenset(rest)] = _estimated(parts, rest, budget).fit.cost
    costs[frozenset(entry.members)] = entry.fit.cost
    return costs


def _estimated(parts: Ingredients, members: tuple[int, ...], budget: Budget) -> Entry:
    """Estimate a set from where re-calibration ended."""
    start, path = parts.null.fit.theta, parts.null.fit.path
    return enter(parts.arena, members, start, path, lambda: budget.exhausted)
