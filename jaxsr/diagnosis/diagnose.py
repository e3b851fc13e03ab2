"""The diagnosis: calibrate, screen, contest, decide, refine, report."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import overload

import numpy as np

from jaxsr._progress import Budget, Progress, Silent, as_budget
from jaxsr._result import StoppedBy
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import (
    Arena,
    in_steps_of,
    in_widths_of_best,
    neutral_values,
    with_rounded_jumps,
)
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.integration import choose_stepping, with_smooth
from jaxsr.diagnosis.contest.output_weights import rescaled
from jaxsr.diagnosis.contest.scoring import horizons
from jaxsr.diagnosis.explaining.document import assemble
from jaxsr.diagnosis.explaining.judge import Ingredients
from jaxsr.diagnosis.failures import Failures, unsimulable
from jaxsr.diagnosis.judging.alternatives import likelier_without
from jaxsr.diagnosis.judging.noise_ratio import in_noise, residual_to_noise
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.laws.newcomers import ABOVE_NOISE, with_curve, with_nameless, with_unnamed
from jaxsr.diagnosis.laws.tangent_laws import promise
from jaxsr.diagnosis.locating.located import with_located
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.result import Diagnosis
from jaxsr.diagnosis.search.choice import (
    Decision,
    choose,
    decide,
    in_own_widths,
    with_parts,
    with_sound_part,
)
from jaxsr.diagnosis.search.contenders import Start, contenders, leading_sets
from jaxsr.diagnosis.search.horizon import Headline, Outlook
from jaxsr.diagnosis.search.large_contest import decided_among_many, with_many_equations
from jaxsr.diagnosis.search.regrouping import settled
from jaxsr.diagnosis.search.stepwise import grow
from jaxsr.diagnosis.setup import screen_all
from jaxsr.diagnosis.thinning import prepare_search, time_for
from jaxsr.models import Simulator
from jaxsr.models.python_base import with_function
from jaxsr.models.states import spread
from jaxsr.recordings import Recording

Contest = tuple[Arena, list[Entry], float, StoppedBy]
"""The arena, its entries, the headline's horizon in s, and why no more sets were tried."""
Decided = tuple[Decision, float, StoppedBy]
"""The decision, its headline's horizon in s, and why no more sets were tried."""

PATIENCE = 1.0 / 12.0
"""Share of the time budget after which the estimation of one set stops where it is."""
MOST_PATIENCE = 10.0
"""The same in seconds: what takes longer is caught in a law that jumps."""
NULL_ITERATIONS = 120
"""Iterations of re-calibration alone: no mechanism must win because it stopped early."""
SEARCHING, DECIDING = 0.7, 0.78
"""Shares of the time budget after which no more sets are tried, and nothing more is compared."""
REPORTING = 2.0
"""Time kept for refining and reporting, relative to that of reading and screening."""
SLOW, MOST_REPORTING = 10.0, 0.45
"""The same relative to the estimation of the leading set; its largest share of the time budget."""
OWN, OWN_SLOW = 0.05, 4.0
"""Time that a set's own widths of jumps may need: a share of the budget, and relative to the
estimation of the set."""
AGAIN = 0.2
"""Share of the time budget from which longer segments are still asked."""
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


def diagnose(
    simulator: Simulator,
    data: Sequence[str | Path | Recording],
    *,
    held_out: Sequence[str | Path | Recording] = (),
    seed: int = 0,
    budget: float | Budget | None = None,
    progress: Progress | None = None,
    command: str | None = None,
) -> Diagnosis:
    """Find what a simulator leaves out.

    Parameters
    ----------
    simulator : Simulator
        The given model.
    data : sequence of path or Recording
        Recordings that every choice rests on.
    held_out : sequence of path or Recording
        Opened once, after the explained model is final, to report the fit.
    seed : int
        Of the bootstrap behind the probabilities and of the evolutionary search.
    budget : float, optional
        Seconds; the best so far is reported when they are spent.
    progress : Progress, optional
    command : str, optional
        Kept in the provenance.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        A recording cannot be read or lacks a column of the model.

    Notes
    -----
    Sets of mechanisms are screened in the weak view together with the free parameters, the
    leading sets are estimated in free run by multiple shooting, and compared on blocks held
    back in turn. DESIGN.md, sections 1.2 and 1.3, gives the reasons.
    """
    progress = progress or Silent()
    budget = as_budget(budget)
    rng = np.random.default_rng(seed)
    if simulator.function is not None:
        simulator = with_function(simulator.model, simulator.function)
    prepared, whole = prepare_search(simulator.model, data)
    progress.stage("screening mechanisms in the weak view")
    failures = Failures(progress)
    screened = failures.attempt("screening", lambda: screen_all(simulator, prepared), None)
    # What was slow to read and to screen is slow to report.
    reading = max(budget.elapsed, time_for(whole, budget.seconds))
    reporting = max((1.0 - SEARCHING) * budget.seconds, REPORTING * reading)
    search = budget.keeping(reporting)
    case = Case(simulator, prepared, screened, budget, search, progress, failures)
    if with_many_equations(case):
        decision, headline, grown = decided_among_many(case, rng)
    else:
        decision, headline, grown = decided_among_few(case, reading, rng)
    arena, good, chosen, detection = decision
    if not any(e.fit.usable for e in good):
        raise unsimulable(simulator, prepared)
    null = next(e for e in good if not e.members)
    if likelier_without(arena.super_model, chosen, good, np.random.default_rng(seed)):
        chosen = null
    ingredients = Ingredients(
        case=case,
        arena=in_steps_of(arena, chosen),
        entries=good,
        null=null,
        chosen=chosen,
        detection=detection,
        headline=headline,
        horizons=horizons(prepared),
        held_out=held_out,
        rng=rng,
        seed=seed,
        command=command,
        stopped=grown,
        whole=whole,
    )
    return assemble(ingredients)


def decided_among_few(case: Case, reading: float, rng: np.random.Generator) -> Decided:
    """Grow sets of mechanisms in free run and decide, on longer segments if need be."""
    budget, field = case.budget, contest(case)
    if not any(e.fit.usable for e in field[1]):
        raise unsimulable(case.simulator, case.prepared)
    case = leaving_time(case, field[1], reading)
    decision, headline, grown = decided(case, field, rng)
    if not decision[-1].detected and case.search.remaining >= AGAIN * budget.seconds:
        before = decision, headline, grown
        decision, headline, grown = case.failures.attempt(
            "looking further ahead", lambda: looked_further(case, before, rng), before
        )
    arena, good, decisive, detection = decision
    needed = max(OWN * budget.seconds, OWN_SLOW * decisive.seconds)
    if case.search.remaining > needed or not np.isfinite(budget.seconds):
        chosen = case.failures.attempt(
            "finding the widths of jumps", lambda: in_own_widths(arena, decisive), decisive
        )
        good = [chosen if e is decisive else e for e in good]
        decision = arena, good, chosen, detection
    return decision, headline, case.stopped_by(grown)


def leaving_time(case: Case, entries: Sequence[Entry], reading: float) -> Case:
    """Return the case with as much time for the report as its leading set and `reading` tell."""
    whole = case.budget.seconds
    leader = min(entries, key=lambda e: e.fit.cost)
    slow = min(SLOW * leader.seconds, MOST_REPORTING * whole)
    reporting = max((1.0 - DECIDING) * whole, REPORTING * reading, slow)
    return replace(case, search=case.budget.keeping(reporting))


def decided(case: Case, field: Contest, rng: np.random.Generator) -> Decided:
    """Choose among the sets of a contest and what the evolution adds to them."""
    arena, entries, headline, grown = field
    attempt = case.failures.attempt
    entries = attempt("estimating parts", lambda: with_parts(case, arena, entries), entries)
    known = arena, entries
    curved = attempt("finding a curve", lambda: with_curve(case, known, rng), known)
    arena, entries = attempt(
        "finding an unnamed law", lambda: with_unnamed(case, curved, rng), curved
    )
    case.progress.stage("deciding")
    plain = (arena, *choose(case, arena, entries))
    decision = attempt("deciding", lambda: decide(case, arena, entries), plain)
    decision = attempt(
        "finding an unnamed law", lambda: with_nameless(case, decision, rng), decision
    )
    return decision, headline, grown


def looked_further(case: Case, before: Decided, rng: np.random.Generator) -> Decided:
    """Decide on longer segments than the headline's, where those show an effect beyond doubt.

    Their errors may grow for other reasons, so that nothing less counts than a set that
    brings them down to the noise.
    """
    field = contest(case, beyond=before[1])
    if field is None:
        return before
    after = decided(case, field, rng)
    arena, _, chosen, detection = after[0]
    clear = detection.detected and residual_to_noise(arena, chosen) < ABOVE_NOISE
    return after if clear else before


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
    simulator = Simulator(super_model.model, case.simulator.function)
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
        leader = starts[min(1, len(starts) - 1)][0]
        headline = outlook.headline(starts, promised.get(leader, 0.0))
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
    entries = [null]
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
    stopped = case.search.stopped_by
    if entries[0].fit.usable:
        short = case.search.remaining < LOCATING * case.budget.seconds
        known = arena, entries
        if not (stop() or (short and _at_noise(arena, entries))):
            known = attempt("locating forces", lambda: with_located(*known, stop), known)
        arena, entries = known
        entries, stopped = _grown(case, arena, entries)
        arena, entries = in_widths_of_best(arena, entries)
    return arena, entries, headline.seconds, stopped


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
        case.progress.update(number / len(starts), _label(arena.super_model, members))
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
    rounds = grow(arena, entries, lambda: growing.exhausted, case.progress.update)
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
