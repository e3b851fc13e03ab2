"""The contest of a model with many equations: one large set, and what could replace its members."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxsr._result import StoppedBy
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.compared import LOCATED, RECALIBRATION, SEVERAL, UNNAMED
from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.integration import choose_stepping, rounded_explicit
from jaxsr.diagnosis.contest.output_weights import rescaled
from jaxsr.diagnosis.judging.alternatives import shares
from jaxsr.diagnosis.judging.leading import leading_beside
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.mechanisms import sensor_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.site import grows_in_proportion
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.many_equations import FAMILIES, many_equations
from jaxsr.diagnosis.screening.screen import redundant
from jaxsr.diagnosis.search.choice import Decision, choose
from jaxsr.diagnosis.search.contenders import Start, carried
from jaxsr.diagnosis.search.horizon import Outlook
from jaxsr.diagnosis.search.neighbours import Neighbours
from jaxsr.models import Simulator
from jaxsr.models.states import spread

WHOLE, PART = 25, 12
"""Iterations of a whole set, and of re-calibration alone: bad from the first, it is told soon."""
PATIENCE = 0.2
"""Share of the time budget after which the estimation of one set stops where it is."""
CLOSE = 0.01
"""Probability by one linearisation from which a rival is estimated."""
SHOWN = 3
"""Rivals of each member that are reported."""


def with_many_equations(case: Case) -> bool:
    """Whether mechanisms were screened at each of many equations."""
    return case.screened is not None and many_equations(case.screened.system)


def decided_among_many(case: Case, rng: np.random.Generator) -> tuple[Decision, float, StoppedBy]:
    """Return the decision, its headline's horizon in s, and why no more sets were tried.

    The weak view has chosen a mechanism or more at every equation. Free runs estimate them
    together and compare them with re-calibration. One linearisation then tells what lacks,
    replaces or adds a member comes close, faults of sensors and actuators and wrong constants
    among them; those are estimated, as long as one does better or comes close and there is time.
    A free run of many sharp friction laws is stiff: theirs are rounded until explicit steps do.
    """
    assert case.screened is not None
    screened = case.screened
    used = sorted({i for s in screened.screening.sets for i in s.members})
    given, candidates = case.simulator.model, screened.super_model.candidates
    super_model = SuperModel.build(given, [*(candidates[i] for i in used), *_impostors(case)])
    empty, leading = (
        (tuple(used.index(i) for i in s.members), carried(screened, super_model, used, s))
        for s in (screened.screening.empty, screened.screening.sets[0])
    )
    arena, headline = _arena(case, super_model, [empty, leading])
    arena = replace(arena, patience=PATIENCE * case.budget.seconds)
    case.progress.stage(f"estimating {len(leading[0])} mechanisms together in free run")
    entries = [enter(arena, *empty, max_iterations=PART)]
    case.so_far.append((arena, list(entries), headline))
    # what this search does not ask about leaves no mass open: sets are what it compares
    case.compared.reach(RECALIBRATION, LOCATED, SEVERAL, UNNAMED)
    case.compared.screen(screened, super_model)
    if leading[0]:  # else nothing gains at any equation
        entries.append(enter(arena, *leading, stop=_stop(case), max_iterations=WHOLE))
    arena, entries = rescaled(arena, entries, _stop(case))
    case.so_far.append((arena, list(entries), headline))
    case.progress.stage("comparing it with what lacks, replaces or adds one of them")
    first = min((e for e in entries if e.fit.usable), key=lambda e: e.fit.cost, default=entries[0])
    best, entries = case.failures.attempt(
        "comparing neighbouring sets",
        lambda: _settled(case, arena, entries, rng),
        (first, entries),
    )
    case.progress.stage("deciding")
    believed = [entries[0], best] if plausible(arena, best) else entries
    _, chosen, detection = choose(case, arena, believed)
    good = [entries[0], chosen] if chosen.members else entries
    if chosen.members and chosen.fit.usable:
        good += case.failures.attempt(
            "estimating rivals", lambda: _rivals(arena, chosen, entries), []
        )
    return (arena, good, chosen, detection), headline, case.search.stopped_by


def _settled(
    case: Case, arena: Arena, entries: list[Entry], rng: np.random.Generator
) -> tuple[Entry, list[Entry]]:
    """Return the set that none of its neighbours betters, and all that were estimated."""
    best, entries = entries[-1], list(entries)
    tried, better = {e.members for e in entries}, best.fit.usable
    while better and not case.search.exhausted:
        better = False
        around = Neighbours.of(arena, best)
        promising = _promising(around, rng)
        case.compared.tell(arena.super_model, range(len(arena.super_model.candidates)))
        for members in promising:
            if members in tried:
                continue
            if case.search.exhausted:
                case.compared.leave(arena.super_model, set(members) - set(best.members))
                continue
            tried.add(members)
            expected = around.entry(members)
            start = best.fit.theta if expected is None else expected.fit.theta
            start = np.clip(start, *arena.bounds)
            doing = f"set {len(tried)}: {_change(arena, best, members)}"
            case.progress.update(0.0, leading_beside(doing, arena, [entries[0], best]))
            entry = enter(arena, members, start, best.fit.path, _stop(case), WHOLE)
            entries.append(entry)
            if entry.fit.usable and _share(arena, best, entry, rng) > 0.5:
                best, better = entry, True
                break
    return best, entries


def _promising(around: Neighbours, rng: np.random.Generator) -> list[tuple[int, ...]]:
    """Return the sets to estimate: all changes that gain at once, then the closest neighbours."""
    super_model, members = around.arena.super_model, set(around.centre.members)
    own, close = around.entry(around.centre.members), []
    if own is None:
        return []
    for other in around.sets():
        entry = around.entry(other)
        if entry is not None:
            share = _share(around.arena, own, entry, rng)
            if share > CLOSE:
                close.append((share, entry.members))
    close.sort(reverse=True)
    together = set(members)
    for share, other in close:
        gone, new = members - set(other), set(other) - members
        changed = (together - gone) | new
        # one change of a member, and one addition at a time
        if share > 0.5 and gone <= together and (gone or together <= members):
            if not redundant(super_model, sorted(changed)):
                together = changed
    combined = tuple(sorted(together))
    return list(dict.fromkeys([combined, *(m for _, m in close)]))


def _rivals(arena: Arena, chosen: Entry, entries: list[Entry]) -> list[Entry]:
    """Return what a set leaves without each member, and with the closest rivals in its place.

    As estimated, or by one linearisation, relative to what that expects of the set itself.
    """
    around, known = Neighbours.of(arena, chosen), {e.members: e for e in entries}
    rivals: dict[int, list[Entry]] = {number: [] for number in chosen.members}
    own, found = around.entry(chosen.members), []
    gained = 1.0 if own is None else chosen.fit.cost / own.fit.cost
    for members in around.sets():
        gone = set(chosen.members) - set(members)
        if not gone:
            continue
        entry = known.get(members)
        if entry is None and (entry := around.entry(members)) is not None:
            entry = replace(entry, fit=replace(entry.fit, cost=gained * entry.fit.cost))
        if entry is None:
            continue
        if len(members) < len(chosen.members):
            found.append(entry)
        else:
            rivals[gone.pop()].append(entry)
    for others in rivals.values():
        found += sorted(others, key=lambda e: e.error)[:SHOWN]
    return found


def _change(arena: Arena, best: Entry, members: tuple[int, ...]) -> str:
    """Say how a set differs from the best one."""
    candidates = arena.super_model.candidates
    gone = sorted(candidates[i].label for i in set(best.members) - set(members))
    new = sorted(candidates[i].label for i in set(members) - set(best.members))
    if len(gone) + len(new) > 2:
        return f"{max(len(gone), len(new))} changes at once"
    return " ".join([*(f"with {n}" for n in new), *(f"without {g}" for g in gone)])


def _share(arena: Arena, best: Entry, other: Entry, rng: np.random.Generator) -> float:
    """Probability of another set against the best one."""
    return float(shares(arena.super_model, [best, other], rng)[1])


def _impostors(case: Case) -> list[Candidate]:
    """Return faults of actuators and sensors, and wrong constants, that act in proportion."""
    assert case.screened is not None
    values = np.concatenate([p.outputs for p in case.prepared])
    readings = dict(zip(case.simulator.model.outputs, values.T, strict=True))
    found = [c for c in case.screened.super_model.candidates if c.family in FAMILIES]
    found += sensor_candidates(case.simulator.model, readings)
    return [c for c in found if grows_in_proportion(c) and not c.states]


def _stop(case: Case) -> Callable[[], bool]:
    return lambda: case.search.exhausted


def _arena(case: Case, super_model: SuperModel, starts: list[Start]) -> tuple[Arena, float]:
    """Cut the recordings into segments; return the arena and the horizon of the verdict in s."""
    case.progress.stage("choosing integration steps and the horizon")
    simulator = Simulator(super_model.model)
    stepping = choose_stepping(simulator, case.prepared, starts[1][1])
    stepping = rounded_explicit(stepping, simulator, case.prepared, starts[1][1])
    scale = 0.01 * spread(np.concatenate([p.outputs for p in case.prepared]))
    outlook = Outlook(super_model, case.prepared, stepping, scale, simulator, _stop(case))
    starts = outlook.usable_starts(starts)
    headline = outlook.headline(starts)
    return outlook.first_usable(headline, starts[0][1]), headline.seconds
