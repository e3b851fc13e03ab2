"""What findings matter: sums of squares without them, the rest estimated again."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.explaining.explain import Weight

if TYPE_CHECKING:
    from jaxsr.diagnosis.explaining.judge import Ingredients

REFINING = 0.15
"""Share of the time left that leading estimates out of corners and checking them may take."""


def given_entry(parts: Ingredients) -> Entry:
    """Return the entry of the given values."""
    return enter(frozen(parts.arena), (), neutral_values(parts.arena.super_model))


def frozen(arena: Arena, names: Collection[str] | None = None) -> Arena:
    """An arena in which some parameters are not estimated; by default nothing but the starts is."""
    given = replace(
        arena.super_model.given,
        parameters={
            n: replace(p, bounds=None) if names is None or n in names else p
            for n, p in arena.super_model.given.parameters.items()
        },
    )
    return replace(arena, super_model=replace(arena.super_model, given=given))


def weight_of_member(parts: Ingredients, entry: Entry, number: int, given: float) -> Weight:
    """Return what one member of a set matters; the set without it is estimated if none was."""
    rest = tuple(i for i in entry.members if i != number)
    without = min((e.fit.cost for e in parts.entries if e.members == rest), default=np.inf)
    budget = parts.case.budget.share(REFINING)
    if not np.isfinite(without) and not budget.exhausted:
        start, path = parts.null.fit.theta, parts.null.fit.path
        without = enter(parts.arena, rest, start, path, lambda: budget.exhausted).fit.cost
    return Weight.of(given, without, entry.fit.cost)


def weight_of_value(parts: Ingredients, name: str, given: float) -> Weight:
    """Return what the value of one parameter matters: the others are estimated with it as given."""
    arena, null = frozen(parts.arena, (name,)), parts.null
    theta = null.fit.theta.copy()
    at = list(arena.super_model.model.parameters).index(name)
    theta[at] = neutral_values(arena.super_model)[at]
    budget = parts.case.budget.share(REFINING)
    cost = given
    if len(parts.case.simulator.model.free_parameters) > 1:
        cost = enter(arena, (), theta, null.fit.path, lambda: budget.exhausted).fit.cost
    return Weight.of(given, cost, null.fit.cost)
