"""Exchanging: what else could stand in the place of a mechanism that was chosen."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.estimation import CONTEST_TOLERANCE
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.search.nesting import INSIDE, continued
from jaxsr.diagnosis.search.peaks import peaked
from jaxsr.diagnosis.search.stepwise import Trial, expected, promising

RIVALS, KIN, RIVAL_PATIENCE = 4, 3, 3.0
"""Mechanisms estimated in the place of each of the chosen, wherever they act and at its own site,
and the seconds that each may take."""
SEVERAL_FORMS = frozenset({"stribeck_friction"})
"""Mechanisms whose forms differ in shape alone: the constants of one are a start for another."""
DELAYS = 3
"""Delays tried in the place of a lag."""


def exchange(
    arena: Arena,
    chosen: Entry,
    entries: Sequence[Entry],
    exhausted: Callable[[], bool],
) -> list[Entry]:
    """Return the entries and those with another mechanism in the place of one of the chosen.

    Growth adds to what it has; a member that came in before its betters stood beside it is found
    out only by taking it away. What does not win is what else could have been meant.
    """
    found = {e.members: e for e in entries}
    brief = replace(arena, patience=min(arena.patience, RIVAL_PATIENCE))
    for number in chosen.members:
        rest = found.get(tuple(i for i in chosen.members if i != number))
        if rest is None or not rest.fit.usable:
            continue
        label = arena.super_model.candidates[number].label
        stand = [_label_beside(arena.super_model, m, rest.members) for m in found]
        known = {text for text in stand if text and text != label}
        if exhausted():
            break
        quick = expected(arena, rest, found)
        trials = _richer(arena, number, rest, found) + _late(arena, number, rest, found)
        trials += _alike(arena.super_model, number, rest, found)
        trials += _kin(arena.super_model, number, rest, quick, known)
        if len(known) < RIVALS:
            trials += promising(arena.super_model, rest, quick, RIVALS, worth=0.0)
        distinct = {t.members: t for t in reversed(trials)}.values()
        for trial in sorted(distinct, key=lambda t: t.cost > 0.0):
            if exhausted():
                break
            known_cost = found[trial.members].fit.cost if trial.members in found else np.inf
            if known_cost <= trial.cost * (1.0 + CONTEST_TOLERANCE):
                continue
            near = trial.path is not None
            path = trial.path if near else rest.fit.path
            entry = enter(brief, trial.members, trial.theta, path, exhausted, near=near)
            if entry.fit.cost * (1.0 + CONTEST_TOLERANCE) < known_cost:
                found[entry.members] = entry
    return list(found.values())


def _richer(
    arena: Arena, number: int, rest: Entry, found: Mapping[tuple[int, ...], Entry]
) -> list[Trial]:
    """Start the richer laws of a site where the law inside them ended.

    Begun from nothing, a law with several constants that jumps may end far above the simpler one
    that it contains.
    """
    super_model = arena.super_model
    site = super_model.candidates[number].site
    richer: dict[str, list[int]] = {}
    for other, candidate in enumerate(super_model.candidates):
        if candidate.site == site and candidate.mechanism in INSIDE and other not in rest.members:
            richer.setdefault(candidate.mechanism, []).append(other)
    trials = []
    for mechanism, laws in richer.items():
        simpler, values = INSIDE[mechanism]
        plain = _beside(super_model, found.values(), rest.members, f"{simpler}@{site}")
        if plain is None:
            continue
        (inner,) = set(plain.members) - set(rest.members)
        starts = [(other, values) for other in laws]
        if mechanism == "stribeck_friction":
            starts = peaked(arena, plain, inner, laws) or starts
        for other, start in starts:
            theta = continued(super_model, plain.fit.theta, inner, other, start)
            members = tuple(sorted({*rest.members, other}))
            trials.append(Trial(members, plain.fit.cost, theta, plain.fit.path))
    return trials


def _alike(
    super_model: SuperModel, number: int, rest: Entry, found: Mapping[tuple[int, ...], Entry]
) -> list[Trial]:
    """Start the other forms of a law, with the same constants, where it ended."""
    whole = found.get(tuple(sorted({*rest.members, number})))
    own = super_model.candidates[number]
    if whole is None or own.mechanism not in SEVERAL_FORMS or not whole.fit.usable:
        return []
    names = {name: name for name in super_model.names[number]}
    forms = {own.terms: number}
    for other, candidate in enumerate(super_model.candidates):
        if candidate.label == own.label and set(super_model.names[other]) == set(names):
            forms.setdefault(candidate.terms, other)
    trials = []
    for other in set(forms.values()) - {number}:
        theta = continued(super_model, whole.fit.theta, number, other, names)
        members = tuple(sorted({*rest.members, other}))
        trials.append(Trial(members, 0.0, theta, whole.fit.path))
    return trials


def _late(
    arena: Arena, number: int, rest: Entry, found: Mapping[tuple[int, ...], Entry]
) -> list[Trial]:
    """Start delays at the time constant of a lag, which looks like one to slow motion.

    From no delay at all, one of several samples may be out of sight.
    """
    super_model = arena.super_model
    whole = found.get(tuple(sorted({*rest.members, number})))
    own = super_model.candidates[number]
    if whole is None or not (own.mechanism == "actuator_lag" and whole.fit.usable):
        return []
    trials = []
    for other, candidate in enumerate(super_model.candidates):
        if not candidate.delays or other in rest.members:
            continue
        theta = continued(super_model, whole.fit.theta, number, other, {"tau": "tau"})
        theta = np.clip(theta, *arena.bounds)
        members = tuple(sorted({*rest.members, other}))
        trials.append(Trial(members, whole.fit.cost, theta, rest.fit.path))
    return trials[:DELAYS]


def _beside(
    super_model: SuperModel, entries: Iterable[Entry], rest: Sequence[int], label: str
) -> Entry | None:
    """Return the best usable entry of `rest` and one candidate of a label."""
    chosen = [
        e for e in entries if e.fit.usable and _label_beside(super_model, e.members, rest) == label
    ]
    return min(chosen, key=lambda e: e.fit.cost, default=None)


def _kin(
    super_model: SuperModel,
    number: int,
    rest: Entry,
    quick: Sequence[Trial],
    known: Collection[str],
) -> list[Trial]:
    """Pick what may act in the place of a mechanism at its own site, the most promising first.

    That one law may be mistaken for another at its site is the nearest doubt of all.
    """
    own = super_model.candidates[number]
    at_site = {label for label in known if label.endswith(f"@{own.site}")}
    best: dict[str, Trial] = {}
    for trial in sorted(quick, key=lambda t: t.cost):
        (other,) = (super_model.candidates[i] for i in set(trial.members) - set(rest.members))
        if other.site == own.site and other.label not in (own.label, *known):
            best.setdefault(other.label, trial)
    return list(best.values())[: max(KIN - len(at_site), 0)]


def _label_beside(
    super_model: SuperModel, members: Sequence[int], rest: Sequence[int]
) -> str | None:
    """What a set has beside `rest`, where that is one mechanism."""
    more = set(members) - set(rest)
    if len(more) != 1 or len(members) != len(rest) + 1:
        return None
    return super_model.candidates[more.pop()].label
