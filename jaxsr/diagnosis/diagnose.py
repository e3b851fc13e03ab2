"""The diagnosis: weigh, estimate in free run, claim, report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from jaxsr._deadline import OutOfTime, limited
from jaxsr._progress import Budget, Progress, Silent, as_budget
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.decision import Decision
from jaxsr.diagnosis.explaining.document import assemble
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.explanations import deviations_of, explanations, unnamed, weights_of
from jaxsr.diagnosis.failures import Failures, unsimulable
from jaxsr.diagnosis.hurried import decided_in_time, unweighed
from jaxsr.diagnosis.input_noise import idle_noise, quieted
from jaxsr.diagnosis.likelihood.posterior import Posterior
from jaxsr.diagnosis.rectified import Rectified, signed
from jaxsr.diagnosis.result import Diagnosis
from jaxsr.diagnosis.settled import (
    above_noise,
    answered,
    decided_by_evidence,
    plainest,
    weighed,
)
from jaxsr.diagnosis.setup import seen_by
from jaxsr.diagnosis.shooting.arena import in_steps_of
from jaxsr.diagnosis.shooting.scoring import horizons
from jaxsr.diagnosis.thinning import Whole, prepare_search, time_for
from jaxsr.diagnosis.unsigned import rectified_sensors
from jaxsr.diagnosis.verdict import FALSE_CLAIM, Costs, claimed
from jaxsr.models import Model, Simulator
from jaxsr.models.given import simulator_of
from jaxsr.models.python_base import with_function
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

SEARCHING = 0.7
"""Share of the time budget after which no more sets are tried."""
HEARING = 0.05
"""Share of the time budget in which it is told whether noise of the inputs acted."""
TELLING = 0.25
"""Share of the time budget in which signs of readings are told."""
REPORTING = 2.0
"""Time kept for refining and reporting, relative to that of reading and screening."""
ENDING = 0.15
"""Share of the time budget, at least, before whose end everything dear is left where it stands."""


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
    Mechanisms are weighed by their evidence; the leading set is estimated in free run by multiple
    shooting, which must bear it out (`diagnosis.settled`). docs/method.md has the formulas.
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
    progress.stage("looking at the equations in the weak view")
    last = budget.keeping(max(ENDING * budget.seconds, budget.elapsed - began))
    with limited(lambda: last.remaining == 0.0):
        seen = failures.attempt(
            "looking at the equations", lambda: seen_by(simulator, read.prepared), None
        )
    # What was slow to read and to look at is slow to report.
    reading = max(budget.elapsed - began, time_for(read.whole, budget.seconds))
    reporting = max((1.0 - SEARCHING) * budget.seconds, REPORTING * reading)
    search = budget.keeping(reporting)
    case = Case(simulator, read.prepared, seen, budget, search, progress, failures)
    case = replace(case, quiet=read.quiet, rectified=read.rectified)
    try:
        with limited(lambda: last.remaining == 0.0):
            decision = _decided(case, costs, rng)
    except OutOfTime:
        decision = decided_in_time(case)
    if not any(e.fit.usable for e in decision.entries):
        raise unsimulable(simulator, case.prepared)
    decision = replace(decision, arena=in_steps_of(decision.arena, decision.chosen))
    ingredients = Ingredients(
        **vars(decision),
        case=case,
        horizons=horizons(case.prepared),
        held_out=held_out,
        seed=seed,
        command=command,
        whole=read.whole,
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
    telling = budget.share(TELLING)
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


def _decided(case: Case, costs: Costs, rng: np.random.Generator) -> Decision:
    """Decide by the evidence of the recordings, which free runs must bear out.

    A law without a name that they do not is set aside before the rest is asked: it was written for
    a path that it need not follow. Beside a named set that they do not bear out, the search goes on
    from what has none of its members, until nothing else leads: then something acts that the
    posterior does not see. Where time ended the search, what was not asked about stays open.
    """
    attempt, found = case.failures.attempt, weighed(case, rng)
    doing = "estimating what the evidence says"
    while found is not None:
        decision = attempt(doing, partial(decided_by_evidence, case, found), None)
        if decision is None:
            break
        known, laws, other = found, found.nameless, None
        if not decision.borne_out and not case.search.exhausted:
            further = partial(found.further, found.leader.members)
            other = found.without(laws) if laws else attempt("searching further", further, None)
        if other is None:
            return _claimed(case, known, decision, costs)
        found = other
    return unweighed(case)


def _claimed(case: Case, found: Posterior, decision: Decision, costs: Costs) -> Decision:
    """Return a decision with what the posterior and two costs claim."""
    model = case.simulator.model
    told = explanations(found, model, above_noise(decision, found.leader.noise))
    claim = claimed(told, unnamed(told) if decision.borne_out else 1.0, costs)
    decision = answered(decision, claim, model.free_parameters)
    decision, renamed = plainest(decision, lambda: case.search.exhausted)
    weights = replace(weights_of(told, renamed), deviations=deviations_of(found))
    return replace(decision, weights=weights)
