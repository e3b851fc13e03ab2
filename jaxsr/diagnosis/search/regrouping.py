"""Regrouping: sets altogether different from the chosen one, told by one linearisation about it.

A set that follows the recordings tells the path, whatever it calls its forces. About that path
the effect of every candidate on the readings is known, and the best sets of all can be picked as
in any linear regression. Growth, which adds to what it has, and exchange, which replaces one
member, find no set of which two members are others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena, in_widths_of_best, neutral_values
from jaxsr.diagnosis.contest.enter import enter, late_members
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.output_weights import rescaled
from jaxsr.diagnosis.contest.tangent import Tangent
from jaxsr.diagnosis.judging.criteria import criterion, independent_residuals
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.mechanisms.candidate import UNNAMED
from jaxsr.diagnosis.mechanisms.site import grows_in_proportion
from jaxsr.diagnosis.screening.screen import ENGAGED, redundant
from jaxsr.diagnosis.search.tangents import change, tangent_about

BEAM, LARGEST = 10, 3
"""Sets of a size that grow on, and the largest size unless the chosen set is larger."""
SETS, PATIENCE = 4, 3.0
"""Sets estimated in full about one path, and the seconds that each may take."""
ROUNDS = 3
"""Times that a better set is linearised anew."""
FURTHER = 0.7
"""Cost of a better set, relative to that of the one before, up to which it is linearised anew."""
NEAR = 2.0
"""Cost, relative to that of the set whose path it is, up to which that path is nearly its own."""
AMONG = 4.0
"""Cost, relative to that of the best set about a path, from which no other one counts."""
BEHIND = 1.1
"""Cost, relative to what is expected, from which a set that is known is estimated again."""
REMEMBERING = 0.25
"""Cost, relative to the centre's, that a set with a new memory must promise: such a promise is less
certain, and its estimation takes longest."""
RIDGE = 1e-10
"""Added to the diagonal of scaled normal equations."""
SEEN = 1e-12
"""Square of a column's effect beside the starts, relative to the largest, from which it counts."""


def regrouped(
    arena: Arena, centre: Entry, entries: Sequence[Entry], exhausted: Callable[[], bool]
) -> list[Entry]:
    """Return the entries, and the sets that the path of one of them speaks for, estimated."""
    found = {e.members: e for e in entries}
    if not _linear(arena, centre) or exhausted():
        return list(entries)
    best = Regrouping.of(arena, centre).best(entries)
    arena = replace(arena, patience=min(arena.patience, PATIENCE))
    for expected in best:
        if exhausted():
            break
        near = expected.fit.cost < NEAR * centre.fit.cost
        theta, path = expected.fit.theta, centre.fit.path
        entry = enter(arena, expected.members, theta, path, exhausted, near=near, fit_widths=True)
        known = found.setdefault(entry.members, entry)
        found[entry.members] = min(known, entry, key=lambda e: e.fit.cost)
    return list(found.values())


def settled(
    arena: Arena, entries: list[Entry], exhausted: Callable[[], bool]
) -> tuple[Arena, list[Entry]]:
    """Add the sets that the best entry's path speaks for, as long as one of them does better.

    The outputs are weighed, and jumps rounded, as the best one asks for. Entries come back with
    re-calibration first.
    """
    centres = set[tuple[int, ...]]()
    for _ in range(ROUNDS):
        best = _best(arena, entries)
        if best is None or best.members in centres or exhausted():
            break
        centres.add(best.members)
        grown = regrouped(arena, best, entries, exhausted)
        better = _best(arena, grown)
        if better is None or better.members == best.members:
            return arena, grown
        # of what is far behind no more is asked
        kept = [e for e in grown if not e.members or e.fit.cost < AMONG * better.fit.cost]
        kept = sorted(kept, key=lambda e: (bool(e.members), e.fit.cost))[: SETS + 1]
        arena, kept = in_widths_of_best(arena, kept)
        arena, entries = rescaled(arena, kept, exhausted)
        if better.fit.cost > FURTHER * best.fit.cost:
            break
    return arena, entries


def _best(arena: Arena, entries: Sequence[Entry]) -> Entry | None:
    """Return the entry that leaves least among those that keep to physics."""
    good = [e for e in entries if e.fit.usable and (not e.members or plausible(arena, e))]
    return min(good, key=lambda e: e.fit.cost, default=None)


def _linear(arena: Arena, centre: Entry) -> bool:
    """Whether the readings of a set of named mechanisms can be linearised about its path.

    A law without a name stands where no set of named ones does: it is not joined to others.
    """
    known = centre.fit.path is not None and centre.fit.usable
    late = late_members(arena.super_model, centre.members)
    named = all(arena.super_model.candidates[i].mechanism != UNNAMED for i in centre.members)
    return known and named and not late


@dataclass(frozen=True, eq=False)
class Regrouping:
    r"""Normal equations about the path of a set, for sets of all candidates.

    With r the residual of the centre, D_i what taking away its member i changes in the readings,
    J the derivatives by constants and the starts projected out, a set S leaves

    .. math:: \min_d \Big\| r - \sum_{i \notin S} D_i - J_S d \Big\|^2,

    free parameters among the columns J_S. D_i follows the coefficients of a member; of limits and
    dead zones, which no coefficient tells, it is the whole effect along the path.

    Attributes
    ----------
    arena : Arena
    centre : Entry
    tangent : Tangent
        Derivatives by all coefficients.
    hessian : ndarray, shape (columns, columns)
        Of the tangent's columns and of the further ones.
    gradient : ndarray, shape (columns,)
    removals : dict of int to int
        Column D of every member.
    seeds : dict of int to int
        Column of every other candidate with a threshold: its effect with that at its seed.
    """

    arena: Arena
    centre: Entry
    tangent: Tangent
    hessian: np.ndarray
    gradient: np.ndarray
    removals: dict[int, int]
    seeds: dict[int, int]

    @staticmethod
    def of(arena: Arena, centre: Entry) -> Regrouping:
        """Linearise about the path of an entry."""
        super_model, members = arena.super_model, centre.members
        tangent = tangent_about(arena, centre)
        neutral, changes = neutral_values(super_model), []
        for number in members:
            own = super_model.index(number, coefficients_only=True)
            if grows_in_proportion(super_model.candidates[number]):
                at = [tangent.columns[j] for j in own]
                step = neutral[own] - tangent.theta[own]
                changes.append(np.tensordot(step, tangent.fit.jacobian[at], 1))
            else:
                without = tangent.theta.copy()
                without[own] = neutral[own]
                changes.append(change(arena, centre, members, without))
        limits = [i for i in range(len(super_model.candidates)) if _limits(arena, centre, i)]
        for number in limits:
            beside = super_model.seeded((number,), tangent.theta)
            changes.append(change(arena, centre, (*members, number), beside))
        fit, count = tangent.fit, len(tangent.columns)
        wide = replace(fit, jacobian=np.concatenate([fit.jacobian, *(c[None] for c in changes)]))
        hessian, gradient = (a.sum(0) for a in wide.normal_equations())
        further = iter(range(count, count + len(changes)))
        removals = {number: next(further) for number in members}
        seeds = {number: next(further) for number in limits}
        return Regrouping(arena, centre, tangent, hessian, gradient, removals, seeds)

    def best(self, known: Sequence[Entry]) -> list[Entry]:
        """Expect the best sets that the `known` ones lack, or have with far larger costs.

        By Schwarz's criterion and the priors, one of each group of mechanisms and sites. What adds
        to a better set is left out.
        """
        n = independent_residuals(self.centre)
        least: dict[frozenset[str], float] = {}
        for entry in known:
            own = self._labels(entry.members)
            least[own] = min(least.get(own, np.inf), entry.fit.cost)
        better, chosen, found = [], [], self._searched(n)
        most = AMONG * min((e.fit.cost for _, e in found.values()), default=0.0)
        for _, expected in sorted(found.values(), key=lambda item: item[0]):
            own = self._labels(expected.members)
            if any(own >= other for other in better):
                continue
            better.append(own)
            behind = least.get(own, np.inf) > BEHIND * expected.fit.cost
            new = set(expected.members) - set(self.centre.members)
            likely = REMEMBERING if self.arena.super_model.remembers(tuple(new)) else np.inf
            cost = expected.fit.cost
            if behind and cost < most and cost < likely * self.centre.fit.cost:
                chosen.append(expected)
        return chosen[:SETS]

    def _labels(self, members: Sequence[int]) -> frozenset[str]:
        return frozenset(self.arena.super_model.candidates[i].label for i in members)

    def _searched(self, n: float) -> dict[tuple[int, ...], tuple[float, Entry]]:
        """Return the criteria of the sets that a beam search meets, and what they leave."""
        super_model = self.arena.super_model
        every = super_model.candidates
        usable = [i for i, c in enumerate(every) if c.mechanism != UNNAMED and self._offered(i)]
        found: dict[tuple[int, ...], tuple[float, Entry]] = {}
        beam: list[tuple[int, ...]] = [()]
        for _ in range(max(LARGEST, len(self.centre.members))):
            grown: dict[tuple[int, ...], tuple[float, Entry]] = {}
            for members in {tuple(sorted({*m, i})) for m in beam for i in usable if i not in m}:
                if redundant(super_model, members):
                    continue
                expected = self.expected(members)
                if expected is not None:
                    grown[members] = criterion(super_model, expected, n), expected
            beam = sorted(grown, key=lambda m: grown[m][0])[:BEAM]
            found |= {m: grown[m] for m in beam}
        return found

    def _offered(self, number: int) -> bool:
        """Whether a candidate changes the readings."""
        size = np.diag(self.hessian)
        if number in self.seeds:
            return bool(size[self.seeds[number]] > SEEN * size.max())
        own = self.arena.super_model.index(number, coefficients_only=True)
        at = [self.tangent.columns[j] for j in own if j in self.tangent.columns]
        return bool(at) and bool((size[at] > SEEN * size.max()).all())

    def expected(self, members: tuple[int, ...]) -> Entry | None:
        """Expect the entry of a set; None where a constant would leave its bounds.

        Of a threshold's effect at its seed, the readings must ask for a share near 1.
        """
        super_model, inside = self.arena.super_model, set(self.centre.members)
        out = [self.removals[i] for i in self.centre.members if i not in members]
        free = [j for j in super_model.base_index() if j in self.tangent.columns]
        limits = [i for i in members if i in self.seeds]
        for number in (i for i in members if i not in self.seeds):
            own = super_model.index(number, coefficients_only=number not in inside)
            free += [j for j in own if j in self.tangent.columns]
        free = list(dict.fromkeys(free))
        at = [*(self.tangent.columns[j] for j in free), *(self.seeds[i] for i in limits)]
        cost = (
            self.tangent.fit.cost
            - 2.0 * self.gradient[out].sum()
            + self.hessian[np.ix_(out, out)].sum()
        )
        pull = self.gradient[at] - self.hessian[np.ix_(at, out)].sum(1)
        part = self.hessian[np.ix_(at, at)]
        size = np.sqrt(np.maximum(np.diag(part), 1e-300))
        scaled = part / size[:, None] / size + RIDGE * np.eye(len(at))
        step = np.linalg.solve(scaled, pull / size) / size
        shares = step[len(free) :]
        if ((shares < ENGAGED[0]) | (shares > ENGAGED[1])).any():
            return None
        theta, neutral = super_model.seeded(limits, self.tangent.theta), neutral_values(super_model)
        gone = [j for i in inside - set(members) for j in super_model.index(i, True)]
        theta[gone] = neutral[gone]
        order = np.array(free, dtype=int)
        theta[order] += step[: len(free)]
        low, high = self.arena.bounds
        if ((theta[order] <= low[order]) | (theta[order] >= high[order])).any():
            return None
        cost = max(cost - float(step @ pull), 1e-300)
        estimated = np.concatenate([order, *(super_model.index(i) for i in limits)]).astype(int)
        theta = super_model.switched(members, theta)
        fit = replace(self.centre.fit, theta=theta, active=estimated, cost=cost)
        known = self.centre
        return Entry(members, fit, known.errors, converters=known.converters, starts=known.starts)


def _limits(arena: Arena, centre: Entry, number: int) -> bool:
    """Whether a candidate beside the centre has a threshold, and neither memory nor delay."""
    candidate = arena.super_model.candidates[number]
    late = late_members(arena.super_model, [number])
    return number not in centre.members and not (grows_in_proportion(candidate) or late)
