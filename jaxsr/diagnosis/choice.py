"""The choice of one set of mechanisms, remade as long as its rivals can be bettered."""

from __future__ import annotations

from collections.abc import Callable

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest import CONTEST_TOLERANCE, Arena, Entry, enter, neutral_values
from jaxsr.diagnosis.corners import out_of_corners
from jaxsr.diagnosis.decide import (
    Detection,
    detect,
    detect_in_noise,
    most_credible,
    plausible,
    simplest_adequate,
    without_duplicates,
)
from jaxsr.diagnosis.exchange import exchange
from jaxsr.diagnosis.refine import LIMITED, residual_to_noise

ROUNDS = 4
"""Times that a decision is made anew because a smaller or another set did better than before."""
MERGED = 3
"""Single mechanisms that are estimated again from where a larger set ended."""

Decision = tuple[Arena, list[Entry], Entry, Detection]
"""The arena, the entries to be believed, the chosen one among them, and the test of it."""


def decide(case: Case, arena: Arena, entries: list[Entry]) -> Decision:
    """Choose an entry; re-calibration alone unless another clearly beats it."""
    exchanged: set[tuple[int, ...]] = set()
    for _ in range(ROUNDS):
        good, chosen, detection = _choose(case, arena, entries)
        if not detection.detected:
            break
        simpler = ablate(arena, chosen, entries, case)
        replaced = {e.members for e in simpler}
        entries = [e for e in entries if e.members not in replaced] + simpler
        if not simpler and chosen.members in exchanged:
            break
        exchanged.add(chosen.members)
        entries = exchange(arena, chosen, entries, lambda: case.search.exhausted)
        entries = _merged(arena, chosen, entries, lambda: case.search.exhausted)
    good, chosen, detection = _choose(case, arena, entries)
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


def _choose(case: Case, arena: Arena, entries: list[Entry]) -> tuple[list[Entry], Entry, Detection]:
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
        places = [arena.super_model.candidates[i].tried for i in chosen.members]
        detection = detect_in_noise(null, chosen, count * max(places, default=1))
    return good, chosen if detection.detected else null, detection


def ablate(arena: Arena, chosen: Entry, entries: list[Entry], case: Case) -> list[Entry]:
    """Enter the chosen set without each of its members, from where the whole set ended.

    Returned are the entries that the contest lacks or has with a larger cost: a smaller set must
    not lose because its estimation stopped early.
    """

    def stop() -> bool:
        return case.search.exhausted

    have = {e.members: e for e in entries}
    neutral = neutral_values(arena.super_model)
    better = []
    for number in chosen.members:
        rest = tuple(i for i in chosen.members if i != number)
        settled = not rest and rest in have and have[rest].fit.converged
        if case.search.exhausted or settled:
            continue
        start = chosen.fit.theta.copy()
        for j in arena.super_model.index(number):
            start[j] = neutral[j]
        entry = enter(arena, rest, start, chosen.fit.path, stop, near=True)
        if rest in have and have[rest].fit.cost < entry.fit.cost:
            entry = have[rest]
        entry, _ = out_of_corners(arena, entry, stop)
        if rest not in have or entry.fit.cost < (1.0 - CONTEST_TOLERANCE) * have[rest].fit.cost:
            better.append(entry)
    return better
