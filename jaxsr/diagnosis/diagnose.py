"""The diagnosis: calibrate, screen, weigh, contest where doubt is left, refine, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from jaxsr._deadline import OutOfTime, limited
from jaxsr._progress import Budget, Progress, Silent, as_budget
from jaxsr._result import StoppedBy
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.compared import Compared
from jaxsr.diagnosis.comparison import Contest, contest
from jaxsr.diagnosis.contest.arena import (
    in_steps_of,
)
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.scoring import horizons
from jaxsr.diagnosis.explaining.document import assemble
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.explanations import deviations_of, explanations, unnamed, weights_of
from jaxsr.diagnosis.failures import Failures, unsimulable
from jaxsr.diagnosis.hurried import decided_in_time
from jaxsr.diagnosis.input_noise import idle_noise, quieted
from jaxsr.diagnosis.judging.noise_ratio import residual_to_noise
from jaxsr.diagnosis.judging.weights import Weights
from jaxsr.diagnosis.laws.newcomers import ABOVE_NOISE, with_curve, with_nameless, with_unnamed
from jaxsr.diagnosis.laws.renaming import with_names
from jaxsr.diagnosis.rectified import Rectified, signed
from jaxsr.diagnosis.result import Diagnosis
from jaxsr.diagnosis.search.believed import believed
from jaxsr.diagnosis.search.choice import (
    Decision,
    choose,
    decide,
    in_own_widths,
    with_parts,
)
from jaxsr.diagnosis.search.large_contest import decided_among_many, with_many_equations
from jaxsr.diagnosis.settled import (
    above_noise,
    answered,
    decided_by_evidence,
    plainest,
    weighed,
)
from jaxsr.diagnosis.setup import screen_all
from jaxsr.diagnosis.thinning import Whole, prepare_search, time_for
from jaxsr.diagnosis.unsigned import rectified_sensors
from jaxsr.diagnosis.verdict import FALSE_CLAIM, Claim, Costs, claimed
from jaxsr.models import Model, Simulator
from jaxsr.models.given import simulator_of
from jaxsr.models.python_base import with_function
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

Decided = tuple[Decision, float, StoppedBy]
"""The decision, its headline's horizon in s, and why no more sets were tried."""

SEARCHING, DECIDING = 0.7, 0.78
"""Shares of the time budget after which no more sets are tried, and nothing more is compared."""
HEARING = 0.05
"""Share of the time budget in which it is told whether noise of the inputs acted."""
SCREENING = 0.25
"""Share of the time budget after which no more memories are screened in the weak view."""
REPORTING = 2.0
"""Time kept for refining and reporting, relative to that of reading and screening."""
SLOW, MOST_REPORTING = 10.0, 0.45
"""The same relative to the estimation of the leading set; its largest share of the time budget."""
OWN, OWN_SLOW = 0.05, 4.0
"""Time that a set's own widths of jumps may need: a share of the budget, and relative to the
estimation of the set."""
ENDING = 0.15
"""Share of the time budget, at least, before whose end everything dear is left where it stands."""
AGAIN = 0.2
"""Share of the time budget from which longer segments are still asked."""


def diagnose(
    simulator: Simulator | Model | str | Path,
    data: Sequence[str | Path | Recording],
    *,
    held_out: Sequence[str | Path | Recording] = (),
    seed: int = 0,
    budget: float | Budget | None = None,
    false_claim_cost: float = FALSE_CLAIM,
    progress: Progress | None = None,
    command: str | None = None,
) -> Diagnosis:
    """Find what a simulator leaves out.

    Parameters
    ----------
    simulator : Simulator, Model or path
        The given model, or the file that `Simulator.from_file` reads it from.
    data : sequence of path or Recording
        Recordings that every choice rests on.
    held_out : sequence of path or Recording
        Opened once, after the explained model is final, to report the fit.
    seed : int
        Of the bootstrap behind the probabilities and of the evolutionary search.
    budget : float, optional
        Seconds; the best so far is reported when they are spent.
    false_claim_cost : float
        What a wrong verdict costs, against abstaining: a verdict is claimed where it is so many
        times as probable as all others together, and is *undecided* elsewhere.
    progress : Progress, optional
    command : str, optional
        Kept in the provenance.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        A recording cannot be read or lacks a column of the model, or a cost is negative.

    Notes
    -----
    Mechanisms are weighed by their evidence first (`diagnosis.settled`). Where that leaves doubt,
    sets of them are screened in the weak view together with the free parameters, the leading sets
    are estimated in free run by multiple shooting, and compared on blocks held back in turn.
    docs/method.md has the formulas.
    """
    progress, costs = progress or Silent(), Costs(false_claim_cost)
    budget = as_budget(budget)
    began = budget.elapsed  # after the start of the program, which is no measure of what follows
    rng = np.random.default_rng(seed)
    simulator = simulator_of(simulator)
    files = simulator.files
    if simulator.function is not None:
        simulator = with_function(simulator.model, simulator.function)
    simulator = Simulator(simulator.model.pinned(), files=files)
    failures = Failures(progress)
    read = _read(simulator, data, budget, failures)
    progress.stage("screening mechanisms in the weak view")
    last = budget.keeping(max(ENDING * budget.seconds, budget.elapsed - began))
    early = budget.share(SCREENING)
    with limited(lambda: last.remaining == 0.0):
        screened = failures.attempt(
            "screening", lambda: screen_all(simulator, read.prepared, early), None
        )
    # What was slow to read and to screen is slow to report.
    reading = max(budget.elapsed - began, time_for(read.whole, budget.seconds))
    reporting = max((1.0 - SEARCHING) * budget.seconds, REPORTING * reading)
    search = budget.keeping(reporting)
    case = Case(simulator, read.prepared, screened, budget, search, progress, failures)
    case = replace(case, quiet=read.quiet, rectified=read.rectified)
    try:
        with limited(lambda: last.remaining == 0.0):
            (decision, headline, grown), weights, claim = _decided(case, costs, reading, rng)
    except OutOfTime:
        (decision, headline, grown), weights, claim = decided_in_time(case), None, None
    if not any(e.fit.usable for e in decision[1]):
        raise unsimulable(simulator, case.prepared)
    if claim is None:
        decision = believed(case, decision, costs.allow, seed)
    arena, good, chosen, detection = decision
    null = next(e for e in good if not e.members)
    ingredients = Ingredients(
        case=case,
        arena=in_steps_of(arena, chosen),
        entries=good,
        null=null,
        chosen=chosen,
        detection=detection,
        headline=headline,
        horizons=horizons(case.prepared),
        held_out=held_out,
        rng=rng,
        seed=seed,
        command=command,
        stopped=grown,
        whole=read.whole,
        weights=weights,
        claim=claim,
    )
    return assemble(ingredients)


@dataclass(frozen=True)
class _Read:
    """What a diagnosis works on.

    Attributes
    ----------
    prepared : tuple of Prepared
    whole : Whole or None
        All recordings, where that is more than a search should work on.
    rectified : tuple of Rectified
        Sensors whose readings have lost their signs; the recordings have them back.
    quiet : tuple of str
        Inputs of which noise is recorded that did not act.
    """

    prepared: tuple[Prepared, ...]
    whole: Whole | None
    rectified: tuple[Rectified, ...]
    quiet: tuple[str, ...]


def _read(
    simulator: Simulator, data: Sequence[str | Path | Recording], budget: Budget, failures: Failures
) -> _Read:
    """Read recordings, give readings their signs back, tell noise of inputs that did not act."""
    model = simulator.model
    prepared, whole = prepare_search(model, data, seconds=budget.seconds)
    telling = budget.share(SCREENING)
    rectified = failures.attempt(
        "telling signs of readings",
        lambda: rectified_sensors(simulator, prepared, lambda: telling.exhausted),
        (),
    )
    if rectified:
        recorded = [p.recording for p in prepared] if whole is None else whole.recordings
        items = signed(model, recorded, rectified)
        prepared, whole = prepare_search(model, items, seconds=budget.seconds)
    if whole is not None:
        return _Read(prepared, whole, rectified, ())
    hearing, heard = budget.share(HEARING), prepared
    quiet = failures.attempt(
        "telling noise of inputs",
        lambda: idle_noise(simulator, heard, lambda: hearing.exhausted),
        (),
    )
    return _Read(quieted(model, prepared, quiet) if quiet else prepared, None, rectified, quiet)


def _decided(
    case: Case, costs: Costs, reading: float, rng: np.random.Generator
) -> tuple[Decided, Weights | None, Claim | None]:
    """Decide by the evidence where it can, else by a contest of free runs."""
    evidence = decided_by_posterior(case, costs, rng)
    if evidence is not None:
        return evidence
    if with_many_equations(case):
        return decided_among_many(case, rng), None, None
    return decided_among_few(case, reading, rng), None, None


def decided_by_posterior(
    case: Case, costs: Costs, rng: np.random.Generator
) -> tuple[Decided, Weights, Claim] | None:
    """Decide by the evidence of the recordings.

    None where nothing was weighed, or free runs do not bear it out: something is there then that
    the posterior does not see. A law without a name that they do not is set aside before that: it
    was written for a path that it need not follow. Where time ended the search, what was not asked
    about stays open.
    """
    found = weighed(case, rng)
    if found is None or len(found.hypotheses) == 1:
        return None
    attempt, doing = case.failures.attempt, "estimating what the evidence says"
    while (decision := attempt(doing, partial(decided_by_evidence, case, found), None)) is None:
        laws = found.nameless
        if not laws or case.search.exhausted:
            return None
        found = found.without(laws)
    above = above_noise(decision, found.leader.noise)
    told = explanations(found, case.simulator.model, above)
    claim = claimed(told, unnamed(told), costs)
    decision = answered(decision, claim, case.simulator.model.free_parameters)
    decision, renamed = plainest(decision, claim, lambda: case.search.exhausted)
    weights = replace(weights_of(told, renamed), deviations=deviations_of(found))
    return decision, weights, claim


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
    return attempt("naming a law", lambda: with_names(case, decision), decision), headline, grown


def looked_further(case: Case, before: Decided, rng: np.random.Generator) -> Decided:
    """Decide on longer segments than the headline's, where those show an effect beyond doubt.

    Their errors may grow for other reasons, so that nothing less counts than a set that
    brings them down to the noise.
    """
    further = replace(case, compared=Compared())
    field = contest(further, beyond=before[1])
    if field is None:
        return before
    after = decided(further, field, rng)
    arena, _, chosen, detection = after[0]
    if not detection.detected or residual_to_noise(arena, chosen) >= ABOVE_NOISE:
        return before
    case.compared.become(further.compared)
    return after
