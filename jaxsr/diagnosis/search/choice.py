"""The choice of one set of mechanisms, remade as long as its rivals can be bettered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena, in_sharpest_widths, in_steps_of, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.estimation import CONTEST_TOLERANCE
from jaxsr.diagnosis.judging.corners import out_of_corners
from jaxsr.diagnosis.judging.criteria import (
    independent_residuals,
    most_credible,
    nearest_given,
    simplest_adequate,
    without_duplicates,
)
from jaxsr.diagnosis.judging.detection import Detection, detect, detect_in_noise
from jaxsr.diagnosis.judging.noise_ratio import LIMITED, residual_to_noise
from jaxsr.diagnosis.judging.plausible import plausible, sound_members
from jaxsr.diagnosis.search.exchange import exchange
from jaxsr.diagnosis.search.regrouping import regrouped

ROUNDS = 4
"""Times that a decision is made anew because a smaller or another set did better than before."""
PRUNING = 0.1
"""Share of the time left that the chosen set without each of its members is owed."""
MERGED = 3
"""Single mechanisms that are estimated again from where a larger set ended."""

Decision = tuple[Arena, list[Entry], Entry, Detection]
"""The arena, the entries to be believed, the chosen one among them, and the test of it."""


def decide(case: Case, arena: Arena, entries: list[Entry]) -> Decision:
    """Choose an entry; re-calibration alone unless another clearly beats it."""
    exchanged: set[tuple[int, ...]] = set()
    pruning = case.budget.share(PRUNING)
    for _ in range(ROUNDS):
        good, chosen, detection = choose(case, arena, entries)
        if not detection.detected:
            break
        before = entries
        entries = _with(entries, ablate(arena, chosen, entries, lambda: pruning.exhausted))
        entries = _with(entries, alone(arena, chosen, entries, case))
        if entries == before and chosen.members in exchanged:
            break
        exchanged.add(chosen.members)
        entries = exchange(arena, chosen, entries, lambda: case.search.exhausted)
        entries = regrouped(arena, chosen, entries, lambda: case.search.exhausted)
        entries = _merged(arena, chosen, entries, lambda: case.search.exhausted)
    good, chosen, detection = choose(case, arena, entries)
    # The chosen set without a member is reported whatever its estimates.
    good += [e for e in entries if set(e.members) < set(chosen.members) and e not in good]
    return arena, good, chosen, detection


def _merged(
    arena: Arena, chosen: Entry, entries: list[Entry], stop: Callable[[], bool]
) -> list[Entry]:
    """Estimate the best single mechanisms again from where a larger set ended.

    One law that jumps, caught in a corner of its cost, must not lose to two that imitate it, or
    to a richer one.
    """
    single = [e for e in entries if len(e.members) == 1 and e.fit.usable]
    if not chosen.members or chosen.fit.path is None:
        return entries
    if len(chosen.members) == 1:
        simpler = [e for e in single if e.fit.active.size < chosen.fit.active.size]
        every = arena.super_model.candidates
        single = [e for e in simpler if every[e.members[0]].sharp]
    best = {}
    for entry in sorted(single, key=lambda e: e.fit.cost)[:MERGED]:
        if stop():
            break
        near = enter(arena, entry.members, entry.fit.theta, chosen.fit.path, stop, near=True)
        near, _ = out_of_corners(arena, min(entry, near, key=lambda e: e.fit.cost), stop)
        best[entry.members] = near
    return [best.get(e.members, e) for e in entries]


def choose(case: Case, arena: Arena, entries: list[Entry]) -> tuple[list[Entry], Entry, Detection]:
    """Return the entries to be believed, the one among them to choose, and the test of it."""
    null = next(e for e in entries if not e.members)
    good = [e for e in entries if not e.members or plausible(arena, e)]
    good = without_duplicates(arena.super_model, good)
    tried = case.screened.super_model if case.screened else arena.super_model
    count = len({c.label for c in tried.candidates})
    best = min(good, key=lambda e: e.fit.cost)
    # Stretches of one run are no samples of their own: there the likelihood alone tells.
    blocks = arena.problem.segments.number > 1
    if blocks and residual_to_noise(arena, best) > LIMITED:
        chosen = simplest_adequate(arena.super_model, good)
        detection = detect(null, chosen, count)
    else:
        chosen = most_credible(arena.super_model, good)
        chosen = nearest_given(arena.super_model, chosen, good)
        places = [arena.super_model.candidates[i].tried for i in chosen.members]
        detection = detect_in_noise(null, chosen, count * max(places, default=1))
    return good, chosen if detection.detected else null, detection


def with_parts(case: Case, arena: Arena, entries: list[Entry]) -> list[Entry]:
    """Return the entries, the members of the leading set estimated alone from where it ended."""
    good = [e for e in entries if not e.members or plausible(arena, e)]
    return _with(entries, alone(arena, min(good, key=lambda e: e.fit.cost), entries, case))


def with_sound_part(case: Case, arena: Arena, whole: Entry, entries: list[Entry]) -> list[Entry]:
    """Return the entries, those members of one that keep to physics estimated without the others.

    A law that the weak view put beside them must not keep them from the contest.
    """
    part = sound_members(arena, whole) if whole.fit.usable else ()
    rest = [part] if part and part != whole.members else []
    return _with(entries, _reduced(arena, whole, rest, entries, _stop(case)))


def _with(entries: list[Entry], better: list[Entry]) -> list[Entry]:
    """Put better estimates in the places of those of the same sets."""
    replaced = {e.members for e in better}
    return [e for e in entries if e.members not in replaced] + better


def alone(arena: Arena, whole: Entry, entries: list[Entry], case: Case) -> list[Entry]:
    """Enter each member of a larger set alone, from where the whole set ended.

    Returned are those that do better than before. A resonator's frequency or a threshold may be
    found only while others stand beside it, which are not needed once it is.
    """
    singles = [(number,) for number in whole.members] if len(whole.members) > 1 else []
    return _reduced(arena, whole, singles, entries, _stop(case))


def _stop(case: Case) -> Callable[[], bool]:
    return lambda: case.search.exhausted


def ablate(
    arena: Arena, chosen: Entry, entries: list[Entry], stop: Callable[[], bool]
) -> list[Entry]:
    """Enter the chosen set without each of its members, from where the whole set ended.

    Returned are the entries that the contest lacks or has with a larger cost: a smaller set must
    not lose because its estimation stopped early.
    """
    rests = [tuple(i for i in chosen.members if i != number) for number in chosen.members]
    have = {e.members: e for e in entries}
    # what is left of one mechanism is re-calibration, which began from nothing else
    settled = () in have and have[()].fit.converged
    return _reduced(arena, chosen, [r for r in rests if r or not settled], entries, stop)


def _reduced(
    arena: Arena,
    whole: Entry,
    sets: Sequence[tuple[int, ...]],
    entries: list[Entry],
    stop: Callable[[], bool],
) -> list[Entry]:
    """Enter sets with some of the members of another, from where that ended; return the better."""
    have = {e.members: e for e in entries}
    neutral = neutral_values(arena.super_model)
    found: list[Entry] = []
    for members in sets:
        if stop():
            break
        start = whole.fit.theta.copy()
        for number in set(whole.members) - set(members):
            start[arena.super_model.index(number)] = neutral[arena.super_model.index(number)]
        entry = enter(arena, members, start, whole.fit.path, stop, near=True)
        found.append(min(entry, have.get(members, entry), key=lambda e: e.fit.cost))
    # all of them first: corners take longer than the estimates, and time may end
    better = []
    for entry in sorted(found, key=lambda e: e.fit.cost):
        known = have.get(entry.members)
        sharpest, _ = out_of_corners(arena, entry, stop)
        if known is None or sharpest.fit.cost < (1.0 - CONTEST_TOLERANCE) * known.fit.cost:
            better.append(sharpest)
    return better


def in_own_widths(arena: Arena, entry: Entry) -> Entry:
    """Return an entry with jumps as wide as suits it best, if the recordings tell it from none.

    By Schwarz's criterion: n log(cost) has to fall by more than log n.
    """
    if not arena.has_jumps(entry) or not entry.fit.usable:
        return entry

    def anew(before: Entry, place: Arena, fit_widths: bool) -> Entry:
        start = before.fit.theta, before.fit.path
        again = enter(place, before.members, *start, near=True, fit_widths=fit_widths)
        return replace(again, stepping=again.stepping or place.problem.stepping)

    own = in_steps_of(arena, entry)
    best = min(entry, anew(entry, own, True), key=lambda e: e.fit.cost)
    plain = anew(best, in_sharpest_widths(own), False)
    n = independent_residuals(best)
    told = n * np.log(plain.fit.cost / best.fit.cost) > np.log(n)
    return best if told or not plain.fit.usable else plain
