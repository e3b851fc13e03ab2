"""What may stand beside or in the place of what: exclusions, swaps, and pairs that show together.

All of it is read off the table of one path: its Gram matrix answers for every set of columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from jaxsr.diagnosis.likelihood.evidence import modes
from jaxsr.diagnosis.likelihood.table import Table
from jaxsr.diagnosis.mechanisms.candidate import UNLIMITED, UNNAMED, Candidate
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import as_late

CERTAIN = 1e-6
"""Deviation of a constant held where its mechanism does nothing, in that of its belief."""
REPEATED = frozenset({"periodic", "external"})
"""Families of which one site may have several: lines of a spectrum, pushes."""
LOOKED_AT = 8
"""Pairs and single columns whose promise is looked at with bounds in account."""
CONTAINED = (
    frozenset(
        {
            *("coulomb_friction", "stribeck_friction", "position_dependent_friction"),
            "load_dependent_friction",
        }
    ),
    frozenset({"coupling_damping", "coupled_friction"}),
    frozenset({"quadratic_drag", "power_law_drag"}),
    frozenset({"piecewise_stiffness", "end_stop"}),
)
"""Mechanisms of which one contains another, or that are one and the same at another strength."""
Members = tuple[int, ...]


def exclusive(super_model: SuperModel, members: Sequence[int]) -> bool:
    """Whether two members cannot both be meant: forms of one law, or one law inside another."""
    return any(
        _excluded(super_model.candidates[i], super_model.candidates[j])
        for i, j in combinations(members, 2)
    )


def _excluded(first: Candidate, second: Candidate) -> bool:
    if first.site != second.site:
        return False
    if UNNAMED in (first.mechanism, second.mechanism):  # one law stands for all forces there
        return not (first.states or second.states)
    if first.mechanism != second.mechanism:
        pair = {first.mechanism, second.mechanism}
        return any(pair <= group for group in CONTAINED) and not _facing(first, second)
    return first.family not in REPEATED and not _facing(first, second)


def _facing(first: Candidate, second: Candidate) -> bool:
    """Whether one acts beyond a place and the other below one, as two stops do."""

    def side(of: Candidate) -> str:
        text = " ".join(template for _, template in of.terms)
        return "".join(sorted({ramp for ramp in ("Max(", "Min(") if ramp in text}))

    return {side(first), side(second)} == {"Max(", "Min("}


def without(table: Table, chosen: Sequence[int], gone: Sequence[int]) -> float:
    """Return the log evidence of columns, some of them held where they do nothing.

    Parameters
    ----------
    chosen : sequence of int
        Columns, those that are gone included.
    gone : sequence of int
    """
    held = np.isin(np.arange(len(table.value)), list(gone))
    deviation = np.where(held, CERTAIN * table.belief.deviation, table.belief.deviation)
    # Zero is where a bound of the belief may be: certainty needs room on both sides of it.
    low = np.where(held, -UNLIMITED, table.belief.low)
    high = np.where(held, UNLIMITED, table.belief.high)
    belief = replace(table.belief, deviation=deviation, low=low, high=high)
    return replace(table, belief=belief).best(chosen)


def swaps(
    super_model: SuperModel, table: Table, members: Members, most: int, behind: float
) -> list[Members]:
    """Return sets with one member exchanged for another mechanism, the most promising first.

    Parameters
    ----------
    table : Table
        About the path of the set.
    most : int
        Of the sets that are returned.
    behind : float
        Log evidence by which a set may promise less than the one that stands.
    """
    base = [*table.base]
    for i in members:
        base += [k for k in table.own.get(i, ()) if k not in base]
    least = table.best(base) - behind
    promised: list[tuple[float, Members]] = []
    for gone in members:
        rest = tuple(i for i in members if i != gone)
        removed = [k for k in table.own.get(gone, ()) if k not in table.base]
        for i, columns in table.own.items():
            further = [k for k in columns if k not in base]
            changed = tuple(sorted((*rest, i)))
            if i in members or not further or exclusive(super_model, changed):
                continue
            log = without(table, [*base, *further], removed)
            if log > least:
                promised.append((log, changed))
    best: dict[tuple[str, ...], Members] = {}  # forms of a mechanism differ by their start alone
    for _, changed in sorted(promised, reverse=True):
        best.setdefault(tuple(super_model.candidates[i].label for i in changed), changed)
    return list(best.values())[:most]


def kin(super_model: SuperModel, members: Members) -> list[Members]:
    """Return sets with one law that jumps exchanged for another of which one contains the other.

    How round jumps are is estimated beside each of them: the table, which knows one width, does not
    tell how they compare.
    """
    candidates, best = super_model.candidates, dict[tuple[str, ...], Members]()
    for gone in (m for m in members if candidates[m].jumps):
        for i, other in enumerate(candidates):
            changed = tuple(sorted((*(m for m in members if m != gone), i)))
            same = other.mechanism == candidates[gone].mechanism
            if same or not other.jumps or not _excluded(candidates[gone], other):
                continue
            if not exclusive(super_model, changed):
                best.setdefault(tuple(candidates[k].label for k in changed), changed)
    return list(best.values())


def shifts(super_model: SuperModel, members: Members) -> list[Members]:
    """Return sets with one member that makes a signal late exchanged for another that does.

    To first order in its time a lag is a delay: the table, which is linear in it, does not tell how
    they compare. Of one input and one output either is late for both.
    """
    candidates, best = super_model.candidates, dict[tuple[str, ...], Members]()
    for gone in members:
        for i, other in enumerate(candidates):
            changed = tuple(sorted((*(m for m in members if m != gone), i)))
            if i in members or not as_late(super_model.given, candidates[gone], other):
                continue
            if not exclusive(super_model, changed):
                best.setdefault(labels(super_model, changed), changed)
    return list(best.values())


def labels(super_model: SuperModel, members: Members) -> tuple[str, ...]:
    """Return what the members of a set are called, in order of their numbers."""
    return tuple(super_model.candidates[i].label for i in sorted(members))


def plain_of_kin(
    super_model: SuperModel, proposed: Sequence[Members]
) -> tuple[list[Members], list[Members]]:
    """Split proposals into the plainest of their kin, and those with one of more constants."""
    plain: list[Members] = []
    kindred: list[Members] = []

    def constants(members: Members) -> int:
        return sum(len(super_model.candidates[i].parameters) for i in members)

    for members in sorted(proposed, key=constants):
        near = {labels(super_model, m) for m in kin(super_model, tuple(sorted(members)))}
        contains = any(labels(super_model, other) in near for other in plain)
        (kindred if contains else plain).append(members)
    return [m for m in proposed if m in plain], [m for m in proposed if m in kindred]


def forms(super_model: SuperModel, members: Members) -> list[Members]:
    """Return sets with one law exchanged for the other forms of its mechanism.

    Forms have other constants (Bouc-Wen, Dahl and LuGre of a hysteresis); variants that differ by
    their starts alone are one form.
    """
    candidates, best = super_model.candidates, dict[tuple[int, frozenset[str]], Members]()
    for gone in members:
        own = frozenset(spec.name for spec in candidates[gone].parameters)
        for i, other in enumerate(candidates):
            names = frozenset(spec.name for spec in other.parameters)
            if other.label == candidates[gone].label and names != own and i not in members:
                changed = tuple(sorted((*(m for m in members if m != gone), i)))
                best.setdefault((gone, names), changed)
    return list(best.values())


def pairs(
    super_model: SuperModel, table: Table, members: Members, most: int, least: float
) -> list[Members]:
    """Return sets with two further mechanisms that promise more together than any one alone.

    Parameters
    ----------
    most : int
        Of the sets that are returned.
    least : float
        Log evidence that the second must add to what the best single one promises.
    """
    base = [*table.base]
    for i in members:
        base += [k for k in table.own.get(i, ()) if k not in base]
    owner = {
        k: i
        for i, columns in table.own.items()
        for k in columns
        if k not in base and i not in members
    }
    columns = sorted(owner)
    if len(columns) < 2:
        return []
    single, double = gains(table, base, columns)
    found: dict[tuple[str, ...], Members] = {}
    for place in np.argsort(-double, axis=None):
        a, b = np.unravel_index(place, double.shape)
        if double[a, b] < single.max() + least or len(found) == LOOKED_AT:
            break
        first, second = owner[columns[a]], owner[columns[b]]
        grown = tuple(sorted({*members, first, second}))
        if first != second and not exclusive(super_model, grown):
            found.setdefault(tuple(super_model.candidates[i].label for i in grown), grown)

    def promised(further: Sequence[int]) -> float:
        """Log evidence with bounds and other columns of the same mechanisms in account."""
        own = [k for i in further for k in table.own[i] if k not in base]
        return table.best([*base, *own])

    alone = [promised([owner[columns[k]]]) for k in np.argsort(-single)[:LOOKED_AT]]
    together = {grown: promised([i for i in grown if i not in members]) for grown in found.values()}
    kept = [g for g in together if together[g] > max(alone) + least]
    return sorted(kept, key=lambda g: -together[g])[:most]


def gains(
    table: Table, base: Sequence[int], columns: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    r"""Log evidence that single columns, and pairs of them, add to the base.

    With the base eliminated, S and s the posterior precision (scaled by the prior) and the pull of
    the columns, \tfrac12 (s' S^{-1} s - \log |S|), the noise of the base held.

    Returns
    -------
    single : ndarray, shape (columns,)
    double : ndarray, shape (columns, columns)
    """
    prior = table.prior(base)
    found = modes(table.grams, base, prior)
    best = int(np.argmax([m.log_evidence for m in found]))
    products, noise = table.grams[best].products, found[best].noise
    deviation = table.belief.deviation
    scale = deviation / np.sqrt(noise)
    mean = table.belief.mean - table.value
    inner = products[1:, 1:] * np.outer(scale, scale) + np.eye(len(deviation))
    pull = -products[1:, 0] * deviation / noise + mean / deviation
    at, of = np.array(base, int), np.array(columns, int)
    across = np.linalg.solve(inner[np.ix_(at, at)], inner[np.ix_(at, of)])
    matrix = inner[np.ix_(of, of)] - inner[np.ix_(of, at)] @ across
    left = pull[of] - across.T @ pull[at]
    own = np.maximum(np.diag(matrix), 1.0)
    single = 0.5 * (left**2 / own - np.log(own))
    determinant = np.outer(own, own) - matrix**2
    alike = determinant <= 1e-9 * np.outer(own, own)  # two columns that are one
    determinant = np.where(alike, 1.0, determinant)
    square = np.outer(left**2, own)
    together = (square + square.T - 2.0 * matrix * np.outer(left, left)) / determinant
    double = 0.5 * (together - np.log(determinant))
    return single, np.where(alike | np.tri(len(of), dtype=bool), -np.inf, double)
