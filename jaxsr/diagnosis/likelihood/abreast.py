"""Sets of models with many equations of motion: several members come or go at once.

A robot lacks friction in every joint. Asked about one after the other, each law is estimated beside
what the other joints leave, and most of the time goes into sets that are not the answer. The table
of one path answers for several laws as it does for one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.diagnosis.likelihood.proposals import (
    LOOKED_AT,
    Members,
    exclusive,
    gains,
    swaps,
    without,
)
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.super_model import SuperModel

ABREAST = 3
"""Laws at so many equations are asked about at once; two are a pair."""


def many(equations: int, members: Members) -> bool:
    """Whether a set has more members than `ABREAST`, of a model of more equations of motion.

    The table alone tells its rivals.
    """
    return min(equations, len(members)) > ABREAST


def room(work: Workspace, most: int) -> int:
    """Return how many members a set may have, which are `most` for every two equations."""
    return most * max(len(work.force_states) // 2, 1)


def laws(super_model: SuperModel) -> list[int]:
    """Return the candidates that are laws at equations of motion, without states of their own."""
    every = enumerate(super_model.candidates)
    return [i for i, c in every if c.site.startswith("equation:") and not c.states]


def abreast(super_model: SuperModel, table: Table, members: Members, least: float) -> list[Members]:
    """Return the set with one more law at every equation that asks for one, if several do.

    One after the other is chosen, each beside those before, as long as the next one promises enough
    (forward selection on the Gram matrix). Laws with states of their own are not among them.

    Parameters
    ----------
    table : Table
        About the path of the set.
    least : float
        Log evidence that each must promise.
    """
    candidates, chosen = super_model.candidates, list(members)
    base, every = list(table.base), [i for i in laws(super_model) if i in table.own]
    for i in members:
        base += [k for k in table.own.get(i, ()) if k not in base]
    free = {candidates[i].site for i in every}
    known = table.best(base)
    while free:
        offered = [i for i in every if candidates[i].site in free]
        offered = [i for i in offered if not exclusive(super_model, (*chosen, i))]
        owner = {k: i for i in offered for k in table.own[i] if k not in base}
        if not owner:
            break
        columns = sorted(owner)
        promised = gains(table, base, columns)[0]
        first = dict.fromkeys(owner[columns[k]] for k in np.argsort(-promised))
        best, law = max(
            (table.best([*base, *(k for k in table.own[i] if k not in base)]), i)
            for i in [*first][:LOOKED_AT]
        )
        if best < known + least:
            break
        known = best
        chosen.append(law)
        base += [k for k in table.own[law] if k not in base]
        free.discard(candidates[law].site)
    return [tuple(sorted(chosen))] if len(chosen) >= len(members) + ABREAST else []


def rivals_of_many(
    super_model: SuperModel, table: Table, members: Members, price: float, behind: float
) -> list[Members]:
    """Return what may stand in the place of a set of many, the most promising first.

    What is left without all the members that the table would rather be without, one after the
    other; then the sets with one member less, or exchanged, that promise enough: of a small set all
    of the former are asked.

    Parameters
    ----------
    table : Table
        About the path of the set.
    price : float
        Log prior odds against a member.
    behind : float
        Log evidence by which a set may promise less than the one that stands.
    """
    base = list(table.base)
    for i in members:
        base += [k for k in table.own.get(i, ()) if k not in base]
    whole = table.best(base)

    def lost(gone: Sequence[int]) -> float:
        columns = [k for i in gone for k in table.own.get(i, ()) if k not in table.base]
        return whole - without(table, base, columns) if columns else np.inf

    gone: list[int] = []
    least = 0.0
    while len(gone) + 1 < len(members):
        trial = {i: lost([*gone, i]) for i in members if i not in gone}
        i = min(trial, key=lambda i: trial[i])
        if trial[i] > least + price:
            break
        gone.append(i)
        least = trial[i]
    few = [tuple(i for i in members if i not in gone)] if len(gone) > 1 else []
    alone = sorted((lost([i]), i) for i in members)
    fewer = [tuple(m for m in members if m != i) for log, i in alone if log < behind]
    return [*few, *fewer, *swaps(super_model, table, members, len(members), behind)]
