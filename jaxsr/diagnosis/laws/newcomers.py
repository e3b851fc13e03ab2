"""Newcomers: laws without a name that enter the contest once the named ones have been compared."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.compared import UNNAMED as UNNAMED_LAWS
from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values, with_rounded_jumps
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.integration import choose_stepping
from jaxsr.diagnosis.judging.noise_ratio import LIMITED, residual_to_noise
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.laws.curves import Curve, curves_at, laws_along
from jaxsr.diagnosis.laws.tangent_laws import laws_at, places
from jaxsr.diagnosis.laws.unnamed import (
    FORCES,
    NAMELESS,
    UNNAMED,
    Law,
    crowded,
    crowded_over_position,
    nameless,
    worth_no_name,
)
from jaxsr.diagnosis.laws.weak_laws import propose_unnamed
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.search.choice import Decision, decide
from jaxsr.models import Simulator

ABOVE_NOISE = 2.0
"""Ratio of residual to sensor noise from which a law is sought that no named mechanism covers."""
REMOVED = 0.3
"""Share of the re-calibrated error up to which a mismatch counts as explained."""
PLACES = 3
"""Equations, of those seen from re-calibration and from the best set, that a law is sought at."""
BESIDE = 1.5
"""Factor by which a law beside another mechanism must promise less than one alone."""
ROUNDS = 2
"""Times that a law is written, the second time about the free run with the first."""

Field = tuple[Arena, list[Entry]]
"""An arena and its entries."""


def with_curve(case: Case, field: Field, rng: np.random.Generator) -> Field:
    """Enter one curve over the position in the place of several springs and ripples over it."""
    arena, entries = field
    good = [e for e in entries if e.fit.usable and plausible(arena, e)]
    if not good:
        return field
    best = min(good, key=lambda e: e.fit.cost)
    for state, rest in crowded_over_position(arena, best):
        case.progress.stage("estimating one curve for several forces over a position")
        curves = [c for c in curves_at(case, best, state) if c.variable != state]
        found = _with_curves(case, (arena, entries), best, curves, rest, rng)
        if found is not None and _worth_no_name((arena, entries), found, best):
            arena, entries = found
    return arena, entries


def with_unnamed(case: Case, field: Field, rng: np.random.Generator) -> Field:
    """Enter a law without a name where no set of named mechanisms comes near the noise.

    First what the evolution writes through the simulator, then what it writes where the sensors
    show the equations, then curves. Where named ones explain most of the mismatch, they must leave
    far more than the noise, and only a law that reaches it, or explains most of what they leave,
    may stand for them.
    """
    arena, entries = field
    null = next(e for e in entries if not e.members)
    best = min((e for e in entries if e is null or plausible(arena, e)), key=lambda e: e.fit.cost)
    unexplained = np.sqrt(best.error / max(null.error, 1e-300)) > REMOVED
    enough = ABOVE_NOISE if unexplained else LIMITED
    asked = residual_to_noise(arena, best) > enough
    if not asked or not case.search.exhausted:
        case.compared.reach(UNNAMED_LAWS)
    if case.search.exhausted or not asked:
        return field
    case.progress.stage("searching a law that no named mechanism covers")
    kept, most = field, best.fit.cost
    least = (NAMELESS if unexplained else REMOVED**2) * most
    for found in _unnamed(case, field, (null, best), rng, unexplained):
        leading = _leading(field, found)
        if leading is None:
            continue
        if residual_to_noise(found[0], leading) < ABOVE_NOISE:
            return found
        if leading.fit.cost < (least if nameless(found[0], leading) else most):
            kept, most = found, leading.fit.cost
            least = NAMELESS * most
    return kept


def _unnamed(
    case: Case,
    field: Field,
    about: tuple[Entry, Entry],
    rng: np.random.Generator,
    unexplained: bool,
) -> Iterator[Field]:
    """Yield the field with laws that may stand for the best entry's, one way after another."""
    best = about[1]
    yield from _through_simulator(case, field, about, rng)
    if unexplained:
        found = _written(case, field, best, rng)
        if found is not None and _worth_no_name(field, found, best):
            yield found
    for state, rest in _places(case, field[0], best):
        found = _with_curves(case, field, best, curves_at(case, best, state), rest, rng)
        if found is not None:
            yield found


def _through_simulator(
    case: Case, field: Field, about: tuple[Entry, Entry], rng: np.random.Generator
) -> Iterator[Field]:
    """Yield the field with laws that the evolution writes about the free runs of some entries.

    A law found is written anew about its own free run, where that is not yet near the noise.
    """
    arena, best = field[0], about[1]
    promising = [p for e in dict.fromkeys(about) for p in places(arena, e)]
    promising.sort(key=lambda p: p.cost * BESIDE ** len(p.rest))
    for place in promising[:PLACES]:
        if place.cost > NAMELESS * best.fit.cost:
            return
        known, here = field, place
        for _ in range(ROUNDS):
            laws = laws_at(case, here, rng)
            if not laws or case.search.exhausted:
                break
            known = with_candidates(case, known, here.entry, laws, (here.rest,))
            yield known
            leading = _leading(field, known)
            again = places(known[0], leading) if leading is not None else []
            here = next((p for p in again if p.site.state == place.site.state), None)
            if here is None:
                break


def _written(case: Case, field: Field, best: Entry, rng: np.random.Generator) -> Field | None:
    """Enter a law that the evolution writes from what the sensors leave of an equation."""
    proposed = propose_unnamed(case, field[0], best, rng)
    if proposed is None:
        return None
    proposal, rest = proposed
    return with_candidates(case, field, best, [proposal], ((), rest, best.members))


def _leading(before: Field, found: Field) -> Entry | None:
    """Return the best entry whose set the field `before` did not have, None where none is new."""
    known = {frozenset(e.members) for e in before[1]}
    new = (e for e in found[1] if frozenset(e.members) not in known)
    return min(new, key=lambda e: e.fit.cost, default=None)


def _worth_no_name(before: Field, found: Field, named: Entry) -> bool:
    leading = _leading(before, found)
    return leading is not None and worth_no_name(found[0], leading, named)


def with_nameless(case: Case, decision: Decision, rng: np.random.Generator) -> Decision:
    """Let the evolution write one law in the place of several named forces at one equation.

    A push among them is left out of the free run about which the law is written.
    """
    arena, good, chosen, _ = decision
    crowds = {state for state, _ in crowded(arena, chosen, good)}
    passing = {i for i in chosen.members if arena.super_model.candidates[i].passing}
    lasting = tuple(i for i in chosen.members if i not in passing)
    about = next((e for e in good if e.members == lasting), chosen)
    for place in (p for p in places(arena, about) if p.site.state in crowds):
        case.progress.stage("searching one law for several forces at one place")
        laws = laws_at(case, place, rng)
        if not laws or case.search.exhausted:
            continue
        rival = decide(case, *with_candidates(case, (arena, good), chosen, laws, (place.rest,)))
        new = frozenset(rival[2].members) not in {frozenset(e.members) for e in good}
        if new and (not nameless(rival[0], rival[2]) or worth_no_name(rival[0], rival[2], chosen)):
            decision = rival
    return decision


def _with_curves(
    case: Case,
    field: Field,
    chosen: Entry,
    curves: Sequence[Curve],
    rest: tuple[int, ...],
    rng: np.random.Generator,
) -> Field | None:
    """Enter free curves, each alone and beside the members `rest`, and laws that follow the best.

    None where no curve can be estimated.
    """
    if not curves or case.search.exhausted:
        return None
    known = len(field[0].super_model.candidates)
    forces = [(curve.proposed(),) for curve in curves]
    wider, entries = with_candidates(case, field, chosen, forces, ((), rest))
    best = _leading(field, (wider, entries))
    if best is None or not best.fit.usable:
        return None
    if residual_to_noise(wider, best) > LIMITED:
        return wider, entries
    laws = laws_along(case, wider, curves[best.members[-1] - known], best, rng)
    if not laws:
        return wider, entries
    return with_candidates(case, (wider, entries), best, laws, (best.members[:-1],))


def _places(case: Case, arena: Arena, best: Entry) -> list[tuple[str, tuple[int, ...]]]:
    """Return equations at which a law may be missing, with the members of `best` elsewhere.

    Those at which it has forces; all where it has none.
    """
    every, dynamic = arena.super_model.candidates, case.simulator.model.dynamic_states
    at: dict[str, list[int]] = {}
    for number in best.members:
        state = every[number].site.partition(":")[2]
        if every[number].family in (*FORCES, "external") and state in dynamic:
            at.setdefault(state, []).append(number)
    states: Iterable[str] = at or dynamic
    return [(s, tuple(i for i in best.members if i not in at.get(s, ()))) for s in states]


def with_candidates(
    case: Case,
    field: Field,
    chosen: Entry,
    proposals: Sequence[Law],
    beside: Sequence[tuple[int, ...]],
) -> Field:
    """Enter the contest again with more candidates, each law by itself beside the sets `beside`.

    Each of these is a part of the chosen set, and starts from where that ended. What the contest
    knows already, by its name, stands for itself; sets that it has tried are not tried again.
    """

    def stop() -> bool:
        return case.search.exhausted

    arena, entries = field
    old, tried = arena.super_model, {frozenset(e.members) for e in entries}
    by_name = {c.key: i for i, c in enumerate(old.candidates) if c.mechanism != UNNAMED}
    unknown = [(c, v) for law in proposals for c, v in law if c.key not in by_name]
    super_model = old
    if unknown:
        super_model = SuperModel.build(old.given, [*old.candidates, *(c for c, _ in unknown)])
    simulator = Simulator(super_model.model)
    stepping, scale = arena.problem.stepping, arena.problem.scale
    neutral = neutral_values(super_model)
    added = neutral[len(old.model.parameters) :]
    if len(simulator.smoothed_arguments) != len(stepping.widths):  # a law that jumps
        start = np.concatenate([chosen.fit.theta, *(values for _, values in unknown)])
        stepping = choose_stepping(simulator, case.prepared, start)
    same = stepping == arena.problem.stepping
    if unknown:
        setting = super_model, case.prepared, stepping, arena.seconds, scale, simulator
        new = build_arena(*setting, arena if same else None)
        new = new if same else replace(with_rounded_jumps(new), patience=arena.patience)
    else:
        new = arena
    leading = sorted(entries, key=lambda e: e.error)[:4]
    null = next(e for e in entries if not e.members)
    sets = {e.members: e for e in (null, chosen, *leading)}
    if same:
        again = [replace(e, fit=e.fit.extended(added)) for e in entries]
    else:
        starts = {m: (np.concatenate([e.fit.theta, added]), e.fit.path) for m, e in sets.items()}
        again = [enter(new, m, *start, stop, near=True) for m, start in starts.items()]
    numbers = iter(range(len(old.candidates), len(super_model.candidates)))
    own = [
        [by_name[c.key] if c.key in by_name else next(numbers) for c, _ in law] for law in proposals
    ]
    for members in dict.fromkeys(beside):
        start = np.concatenate([sets.get(members, chosen).fit.theta, added])
        for i in set(chosen.members) - set(members):
            start[super_model.index(i)] = neutral[super_model.index(i)]
        for ours, law in zip(own, proposals, strict=True):
            if {*members, *ours} in tried:
                continue
            theta = start.copy()
            for number, (_, values) in zip(ours, law, strict=True):
                theta[super_model.index(number)] = values
            again.append(enter(new, tuple(sorted({*members, *ours})), theta, stop=stop))
    return new, again
