r"""Parts of an explanation that add up.

A finding's share is what comes back without it. Of effects that stand in for one another little
comes back without either, so that shares say nothing of the whole. Here the squared error that the
findings take off the re-calibrated model,

.. math:: v(S) = \mathrm{SSE}(\varnothing) - \mathrm{SSE}(S),

is given out whole. By the average over all orders in which the findings F can be added (Shapley)
finding i gets

.. math::
    \sum_{S \subseteq F \setminus i} \frac{|S|!\,(|F| - |S| - 1)!}{|F|!}
    \bigl(v(S \cup i) - v(S)\bigr).

That asks for every subset. Where a search did not estimate them all, each gets what comes back
without it, scaled so that all parts add up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from math import factorial, isfinite
from typing import Any

MOST = 8
"""Findings of which all subsets are asked for."""

Costs = Mapping[frozenset[int], float]
"""Members of a set to its squared error, all else re-estimated; infinite where none holds."""


class By(StrEnum):
    """How an explanation is given out."""

    ORDERS = "all orders"
    LEFT_OUT = "leaving one out"


@dataclass(frozen=True)
class Portions:
    """Part of each finding in what re-calibration could not explain; they add up to 1."""

    parts: tuple[float, ...]
    by: By

    def row(self, position: int) -> dict[str, Any]:
        """Return one finding's part in the form of docs/files.md."""
        return {"part": {"value": self.parts[position], "by": self.by.value}}


def portions(members: Sequence[int], costs: Costs) -> Portions | None:
    """Give out what a set explains beyond re-calibration over its members.

    Parameters
    ----------
    members : sequence of int
    costs : mapping
        Of the sets that were estimated; the empty one is re-calibration.

    Returns
    -------
    Portions or None
        None where the set explains no more than re-calibration, or too few sets were
        estimated.
    """
    whole = frozenset(members)
    told = len(members) <= MOST and all(s in costs for s in _subsets(members))
    if not told and any(s not in costs for s in _outermost(members)):
        return None
    least = _least(_subsets(members) if told else _outermost(members), costs)
    gains = {subset: least[frozenset()] - cost for subset, cost in least.items()}
    if told:
        parts = [_average(i, members, gains) for i in members]
    else:
        parts = [gains[whole] - gains[whole - {i}] for i in members]
    total = sum(parts)
    if not (isfinite(total) and total > 0.0):
        return None
    return Portions(tuple(part / total for part in parts), By.ORDERS if told else By.LEFT_OUT)


def _subsets(members: Sequence[int]) -> list[frozenset[int]]:
    sizes = range(len(members) + 1)
    return [frozenset(s) for size in sizes for s in combinations(members, size)]


def _least(wanted: Sequence[frozenset[int]], costs: Costs) -> dict[frozenset[int], float]:
    """Return the costs of sets, none above that of a set inside it: it can do the same.

    An estimate may have ended short of that, or hold no simulation.
    """
    return {s: min(costs[t] for t in wanted if t <= s) for s in wanted}


def _outermost(members: Sequence[int]) -> list[frozenset[int]]:
    """Return re-calibration, the whole, and the whole without each."""
    whole = frozenset(members)
    return [frozenset(), whole, *(whole - {i} for i in members)]


def _average(member: int, members: Sequence[int], gains: Mapping[frozenset[int], float]) -> float:
    """Return what a member adds, on average over the orders in which all can be added."""
    count, others = len(members), [i for i in members if i != member]
    return sum(
        factorial(len(s))
        * factorial(count - len(s) - 1)
        / factorial(count)
        * (gains[s | {member}] - gains[s])
        for s in _subsets(others)
    )
