"""What promises most beside a leading set, by the table about its path."""

from __future__ import annotations

from dataclasses import replace
from itertools import zip_longest

import numpy as np

from jaxsr.diagnosis.likelihood.abreast import many
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.proposals import exclusive
from jaxsr.diagnosis.likelihood.state import State
from jaxsr.diagnosis.likelihood.table import Table

TRIED = 6
"""Proposals that are estimated about one leader at a time."""
MEMORIES = 3
"""The same of those with states of their own."""
PROMISING = 2.0
"""Log evidence that a proposal must promise about the leader's path, its prior odds included."""


def additions(state: State, table: Table, leader: Hypothesis) -> tuple[list[int], list[int]]:
    """Candidates by what they promise beside a set, the best first, and others that are due.

    A latent force bends the path to the readings: what would take its place may promise nothing
    along such a path. Beside one, candidates are also ranked by what they promise without it, and
    the first of both rankings take turns.

    Those with states of their own have turns of their own: at the first values of their inner
    constants they promise less than they keep.
    """
    candidates = state.work.super_model.candidates
    promised, instead = promises(state, table, leader)
    large = many(len(state.work.force_states), leader.members)
    # About a large set only what promises something beside its force is asked.
    ranked = turns(promised, [] if large else instead)
    best: dict[str, int] = {}  # variants of a mechanism differ by their start alone
    for i in ranked:
        best.setdefault(candidates[i].label, i)
    plain = [i for i in best.values() if not candidates[i].states]
    first, due = plain[:TRIED], {candidates[i].label for _, i in promised}
    plain = first + [i for i in plain[TRIED:] if candidates[i].label in due]
    memories = [i for i in best.values() if candidates[i].states][:MEMORIES]
    # Readings that stand still at a limit ask for one: its column is nothing along such readings.
    clipped = [i for i in table.own if candidates[i].mechanism == "clipping"]
    others = (i for i in (*memories, *clipped) if i not in (*leader.members, *first))
    return plain, list(dict.fromkeys(others))


def turns(*rankings: list[tuple[float, int]]) -> list[int]:
    """Return candidates of several rankings, the first of each in turn."""
    ranked = (sorted(ranking, reverse=True) for ranking in rankings)
    return [i for several in zip_longest(*ranked) for _, i in filter(None, several)]


def promises(
    state: State, table: Table, leader: Hypothesis
) -> tuple[list[tuple[float, int]], list[tuple[float, int]]]:
    """Return what additions promise beside a set, and what without its latent force, if any."""
    base = list(table.base)
    for i in leader.members:
        base += [k for k in table.own.get(i, ()) if k not in base]
    calm = replace(table, grams=table.grams[:1])  # that of no latent force
    before = table.best(base), calm.best(base)
    promised, instead = [], []
    for i, columns in table.own.items():
        further = [k for k in columns if k not in base]
        if i in leader.members or not further:
            continue
        if exclusive(state.work.super_model, (*leader.members, i)):
            continue
        gain = table.best([*base, *further]) - before[0] - np.log(state.offered)
        if gain > PROMISING or not leader.members:
            promised.append((gain, i))
        if leader.share:
            instead.append((calm.best([*base, *further]) - before[1], i))
    return promised, instead
