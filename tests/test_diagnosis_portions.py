"""Parts of an explanation: they add up to what re-calibration could not explain."""

from __future__ import annotations

from itertools import permutations
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxsr._progress import Budget
from jaxsr.diagnosis.explaining import member_costs
from jaxsr.diagnosis.explaining.portions import MOST, By, portions

SETS = [frozenset(s) for s in ((), (0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2))]


def by_orders(members, costs):
    """Return what each member adds over all orders, by their definition."""
    found = dict.fromkeys(members, 0.0)
    orders = list(permutations(members))
    for order in orders:
        for k, member in enumerate(order):
            before, after = (costs[frozenset(order[:n])] for n in (k, k + 1))
            found[member] += (before - after) / len(orders)
    return [found[m] for m in members]


@given(st.lists(st.floats(0.1, 100.0), min_size=8, max_size=8))
def test_parts_add_up_and_none_is_negative(values):
    told = portions((0, 1, 2), dict(zip(SETS, values, strict=True)))
    if told is None:
        assert min(values) >= values[0]  # no set beats re-calibration
        return
    assert sum(told.parts) == pytest.approx(1.0)
    assert min(told.parts) >= -1e-12


def test_parts_are_averages_over_the_orders():
    costs = dict(zip(SETS, [10.0, 6.0, 7.0, 9.5, 2.0, 5.5, 6.5, 1.0], strict=True))
    told = portions((2, 0, 1), costs)
    assert told is not None and told.by is By.ORDERS
    assert told.parts == pytest.approx(np.array(by_orders((2, 0, 1), costs)) / 9.0)


def test_of_effects_that_stand_in_for_one_another_each_gets_half():
    """Little comes back without either: by what comes back alone they would explain nothing."""
    costs = {frozenset(): 10.0, frozenset({4}): 1.1, frozenset({7}): 1.1, frozenset({4, 7}): 1.0}
    told = portions((4, 7), costs)
    assert told is not None and told.parts == pytest.approx([0.5, 0.5])


def test_where_subsets_were_not_estimated_it_is_said():
    costs = {s: 10.0 - 2.0 * len(s) for s in SETS if len(s) != 1}
    told = portions((0, 1, 2), costs)
    assert told is not None and told.by is By.LEFT_OUT
    assert told.parts == pytest.approx([1 / 3] * 3)
    assert told.row(1)["part"]["by"] == "leaving one out"
    del costs[frozenset({0, 1})]
    assert portions((0, 1, 2), costs) is None


def test_a_set_that_cannot_be_simulated_does_as_well_as_what_is_inside_it():
    costs = {frozenset(): 10.0, frozenset({0}): np.inf, frozenset({1}): 4.0, frozenset({0, 1}): 1.0}
    told = portions((0, 1), costs)
    assert told is not None and told.parts == pytest.approx([1.5 / 9, 7.5 / 9])


def test_nothing_is_told_where_nothing_is_gained():
    assert portions((), {frozenset(): 1.0}) is None
    assert portions((0,), {frozenset(): 1.0, frozenset({0}): 1.0}) is None
    alone = portions((0,), {frozenset(): 2.0, frozenset({0}): 1.0})
    assert alone is not None and alone.parts == (1.0,)


def test_many_findings_ask_for_no_subset_but_the_outermost():
    members = tuple(range(MOST + 12))
    costs = {frozenset(members): 1.0, frozenset(): 100.0}
    costs |= {frozenset(members) - {i}: 1.0 + i for i in members}
    told = portions(members, costs)
    assert told is not None and told.by is By.LEFT_OUT
    assert told.parts == pytest.approx(np.array(members) / sum(members))


def test_only_sets_less_a_member_that_none_estimated_are_estimated(monkeypatch):
    def entry(*members: int, cost: float) -> Any:
        return SimpleNamespace(members=members, fit=SimpleNamespace(cost=cost, theta=0, path=None))

    asked = []

    def enter(arena, members, *_):
        asked.append(members)
        return entry(*members, cost=5.0)

    monkeypatch.setattr(member_costs, "enter", enter)
    null, chosen = entry(cost=10.0), entry(3, 1, cost=1.0)
    case = SimpleNamespace(budget=Budget())
    entries = [null, chosen, entry(1, cost=4.0), entry(1, cost=3.0)]
    parts: Any = SimpleNamespace(entries=entries, null=null, case=case, arena=None)
    costs = member_costs.costs_of_sets(parts, chosen)
    assert asked == [(3,)]
    known = {(): 10.0, (1,): 3.0, (3,): 5.0, (1, 3): 1.0}
    assert costs == {frozenset(members): cost for members, cost in known.items()}
