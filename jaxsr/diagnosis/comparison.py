"""The sets that are compared: leaders of the weak view estimated in free run, and grown."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import overload

import numpy as np

from jaxsr._result import StoppedBy
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.compared import LOCATED, RECALIBRATION
from jaxsr.diagnosis.contest.arena import (
    Arena,
    in_widths_of_best,
    neutral_values,
    with_rounded_jumps,
)
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.integration import choose_stepping, with_smooth
from jaxsr.diagnosis.contest.output_weights import rescaled
from jaxsr.diagnosis.contest.scoring import horizons
from jaxsr.diagnosis.judging.leading import leading_beside
from jaxsr.diagnosis.judging.noise_ratio import in_noise, residual_to_noise
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.laws.newcomers import ABOVE_NOISE
from jaxsr.diagnosis.laws.tangent_laws import promise
from jaxsr.diagnosis.locating.located import with_located
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.search.choice import with_sound_part
from jaxsr.diagnosis.search.contenders import Start, contenders, leading_sets
from jaxsr.diagnosis.search.horizon import Headline, Outlook
from jaxsr.diagnosis.search.regrouping import settled
from jaxsr.diagnosis.search.restarts import Restarts
from jaxsr.diagnosis.search.stepwise import grow
from jaxsr.models import Simulator
from jaxsr.models.states import spread

Contest = tuple[Arena, list[Entry], float, StoppedBy]
"""The arena, its entries, the headline's horizon in s, and why no more sets were tried."""

PATIENCE = 1.0 / 12.0
"""Share of the time budget after which the estimation of one set stops where it is."""
MOST_PATIENCE = 10.0
"""The same in seconds: what takes longer is caught in a law that jumps."""
NULL_ITERATIONS = 120
"""Iterations of re-calibration alone: no mechanism must win because it stopped early."""
RESTARTING = 0.1
"""Share of the time left that re-calibration from other starts may take."""
LOCATING = 0.25
"""The same from which forces are located beside a set that explains everything: with less, what is
left is for telling that set from its parts."""
GROWING = 0.7
"""Share of the time left that larger sets may take: the rest is for telling rivals apart."""
GROWING_LESS, MORE = 0.4, 0.5
"""The same where a law without a name promises less than `MORE` times the cost that any single
mechanism leaves."""
PROMISING = 0.7
"""Error left in the weak view, relative to re-calibration, below which a set must do well."""
MOST_BROKEN = 2
"""Sets that do not do so well, from which the weak view is not believed about larger ones."""
HIDDEN = 2.5
"""Residual in longer segments, in sizes of the noise, from which an effect is looked for that short
ones do not show."""


@overload
def contest(case: Case) -> Contest: ...
@overload
def contest(case: Case, beyond: float) -> Contest | None: ...
def contest(case: Case, beyond: float | None = None) -> Contest | None:
    """Estimate the leading sets in free run, hold blocks back, and tell why that ended.

    `beyond` asks for segments longer than a headline that shows nothing: starts estimated for
    every short segment absorb what acts rarely. None where nothing more is left there either.
    """
    sets = leading_sets(case)
    super_model, starts = contenders(case, sets)
    promised = {}
    if case.screened is not None:
        null_error = case.screened.screening.empty.error
        promised = {m: s.error / null_error for (m, _), s in zip(starts[1:], sets, strict=True)}

    def stop() -> bool:
        return case.search.exhausted

    first = starts[min(1, len(starts) - 1)][0]
    opened = opening(case, super_model, starts, promised.get(first, 0.0), beyond)
    if opened is None:
        return None
    arena, null, headline, starts = opened
    entries = [null]
    if beyond is None:
        case.so_far.append((arena, [null], headline.seconds))
    # Where re-calibration is near the noise, larger sets grow from single ones.
    calm = residual_to_noise(arena, entries[0]) <= ABOVE_NOISE
    if beyond is not None and residual_to_noise(arena, entries[0]) < HIDDEN:
        return None
    attempt, known = case.failures.attempt, (arena, entries)
    if not calm:
        known = attempt("regrouping", lambda: settled(arena, entries, stop), known)
    arena, entries = known
    if calm or not _at_noise(arena, entries):
        arena, entries = attempt(
            "estimating the leading sets",
            lambda: _screened(case, arena, entries, starts[1:], promised, calm),
            known,
        )
    case.progress.stage("trying every mechanism in free run")
    if len(entries) == 1:
        arena, entries = rescaled(arena, entries, stop)
    arena, entries = in_widths_of_best(arena, entries)
    if beyond is None:
        case.so_far.append((arena, list(entries), headline.seconds))
    stopped = case.search.stopped_by
    if entries[0].fit.usable:
        short = case.search.remaining < LOCATING * case.budget.seconds
        known = arena, entries
        if not (stop() or (short and _at_noise(arena, entries))):
            known = attempt("locating forces", lambda: with_located(*known, stop), known)
            if not stop():
                case.compared.reach(LOCATED)
        arena, entries = known
        if stop():
            hurried = (e for e in entries if not e.fit.converged)
            case.compared.leave(arena.super_model, {i for e in hurried for i in e.members})
        entries, stopped = _grown(case, arena, entries)
        arena, entries = in_widths_of_best(arena, entries)
    return arena, entries, headline.seconds, stopped


def opening(
    case: Case,
    super_model: SuperModel,
    starts: list[Start],
    promised: float = 0.0,
    beyond: float | None = None,
    led: bool = False,
) -> tuple[Arena, Entry, Headline, list[Start]] | None:
    """Lay out the arena of some candidates and estimate re-calibration in it.

    `promised` is what the leading set, the second of `starts`, leaves in the weak view, relative to
    re-calibration; sets that are `led` have a path to start from. None where segments `beyond` a
    horizon do not exist.
    """
    case.compared.screen(case.screened, super_model)
    simulator = Simulator(super_model.model)
    case.progress.stage("choosing integration steps and the horizon")
    stepping = choose_stepping(simulator, case.prepared, starts[min(1, len(starts) - 1)][1])
    base = starts[0][1][: len(case.simulator.model.parameters)]
    stepping = with_smooth(stepping, case.simulator, case.prepared, base)
    scale = 0.01 * spread(np.concatenate([p.outputs for p in case.prepared]))

    def stop() -> bool:
        return case.search.exhausted

    outlook = Outlook(super_model, case.prepared, stepping, scale, simulator, stop)
    starts = outlook.usable_starts(starts)
    if beyond is None:
        headline = outlook.headline(starts, promised, led)
    else:
        longer = outlook.beyond(beyond)
        if longer is None:
            return None
        headline = Headline(longer, [longer])
    arena = outlook.first_usable(headline, starts[0][1])
    arena = replace(arena, patience=min(PATIENCE * case.budget.seconds, MOST_PATIENCE))
    arena = with_rounded_jumps(arena)
    case.progress.stage("telling sets of mechanisms from the path of the re-calibrated model")
    arena, null = _recalibrated(arena, headline, starts[0][1], stop)
    if beyond is None:
        restarting = case.search.share(RESTARTING)

        def shortest() -> Arena:
            return with_rounded_jumps(outlook.arena(horizons(case.prepared)[0]))

        restarts = Restarts(arena, shortest, lambda: restarting.exhausted, NULL_ITERATIONS)
        null = case.failures.attempt("starting anew", lambda: restarts.best(null), null)
    if null.fit.converged or not stop():
        case.compared.reach(RECALIBRATION)
    return arena, null, headline, starts


def _recalibrated(
    arena: Arena, headline: Headline, start: np.ndarray, stop: Callable[[], bool]
) -> tuple[Arena, Entry]:
    """Estimate the given structure, from where the weak view or shorter segments lead it.

    What is left above the noise may be the doing of the weights, where the steps of a converter
    pass for motion: with outputs weighed by their noise, the given values are another start.
    """
    entry = enter(arena, (), start, None, stop, NULL_ITERATIONS)
    before = headline.calibrated.get(arena.seconds)
    if before is not None and before.fit.cost < entry.fit.cost:
        entry = enter(arena, (), before.fit.theta, before.fit.path, stop, NULL_ITERATIONS)
    if residual_to_noise(arena, entry) > ABOVE_NOISE:
        weighed, given = in_noise(arena), neutral_values(arena.super_model)
        again = enter(weighed, (), given, None, stop, NULL_ITERATIONS)
        if again.fit.usable and residual_to_noise(weighed, again) <= ABOVE_NOISE:
            return weighed, again
    return arena, entry


def _at_noise(arena: Arena, entries: Sequence[Entry]) -> bool:
    """Whether a set that keeps to physics leaves no more than the sensors' noise."""
    good = [e for e in entries if e.members and plausible(arena, e)]
    best = min(good, key=lambda e: e.fit.cost, default=None)
    return best is not None and residual_to_noise(arena, best) <= ABOVE_NOISE


def _screened(
    case: Case,
    arena: Arena,
    entries: list[Entry],
    starts: Sequence[Start],
    promised: Mapping[tuple[int, ...], float],
    calm: bool,
) -> tuple[Arena, list[Entry]]:
    """Estimate the leading sets of the weak view; `calm` leaves the larger ones out."""

    def stop() -> bool:
        return case.search.exhausted

    case.progress.stage(f"estimating {len(starts)} sets of mechanisms in free run")
    null, weighed, broken = entries[0], len(entries) > 1, 0  # promises of the weak view
    for number, (members, start) in enumerate(starts):
        if stop():
            break
        if len(members) > 1 and (calm or broken >= MOST_BROKEN):
            continue
        label = _label(arena.super_model, members)
        case.progress.update(number / len(starts), leading_beside(label, arena, entries))
        path = null.fit.path if null.fit.usable else None
        entry = enter(arena, members, start, path, stop)
        promise = promised.get(members, 1.0)
        if path is not None and broken < MOST_BROKEN and _astray(null, entry, promise):
            # Along the re-calibrated model's path, what is missing seemed not to act.
            again = enter(arena, members, start, None, stop)
            entry = min(entry, again, key=lambda e: e.fit.cost)
            broken += _astray(null, entry, promise)
        best = min(e.fit.cost for e in entries)
        entries = [e for e in entries if e.members != members or e.fit.cost < entry.fit.cost]
        if all(e.members != members for e in entries):
            entries.append(entry)
        if entry.fit.cost < null.fit.cost:
            entries = with_sound_part(case, arena, entry, entries)
        if not weighed:
            arena, entries = in_widths_of_best(arena, entries)
            arena, entries = rescaled(arena, entries, stop)
            weighed, null = True, entries[0]
        if entry.fit.cost < best and not calm:
            arena, entries = settled(arena, entries, stop)
            null = next(e for e in entries if not e.members)
            if _at_noise(arena, entries):
                break
    return arena, entries


def _grown(case: Case, arena: Arena, entries: list[Entry]) -> tuple[list[Entry], StoppedBy]:
    """Return larger sets as well, and why no more were tried.

    Less time is theirs where a law without a name promises far more than any mechanism.
    """
    growing = case.search.share(GROWING)
    compared = case.compared

    def tell(fraction: float, text: str) -> None:
        case.progress.update(fraction, leading_beside(text, arena, entries))

    rounds = grow(arena, entries, lambda: growing.exhausted, tell, compared)
    for size in itertools.count(1):
        larger = case.failures.attempt("growing sets", lambda: next(rounds, None), None)
        if larger is None:
            break
        entries = larger
        best = min((e for e in entries if plausible(arena, e)), key=lambda e: e.fit.cost)
        if size == 1 and residual_to_noise(arena, best) > ABOVE_NOISE:
            null = next(e for e in entries if not e.members)
            if promise(arena, null) < MORE * best.fit.cost:
                growing = case.search.share(GROWING_LESS)
    return entries, growing.stopped_by


def _astray(null: Entry, entry: Entry, promised: float) -> bool:
    """Whether an estimate has not half the effect that the weak view promised."""
    return promised < PROMISING and entry.fit.cost > 0.5 * (1.0 + promised) * null.fit.cost


def _label(super_model: SuperModel, members: tuple[int, ...]) -> str:
    return " + ".join(super_model.candidates[i].label for i in members) or "re-calibration"
