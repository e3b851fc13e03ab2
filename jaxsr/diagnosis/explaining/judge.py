"""Judging a decision: final estimates, findings by their shares, the verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxsr._deadline import OutOfTime, limited
from jaxsr._result import StoppedBy, Verdict
from jaxsr.diagnosis.contest.arena import neutral_values
from jaxsr.diagnosis.contest.blocks import gain
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.explaining.explain import (
    Weight,
    finding_row,
    rounding_rows,
    where,
)
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.explaining.member_costs import costs_of_sets
from jaxsr.diagnosis.explaining.portions import portions
from jaxsr.diagnosis.explaining.recalibrating import completed, not_worse
from jaxsr.diagnosis.explaining.rectifying import rectified_rows
from jaxsr.diagnosis.explaining.value_findings import REFINING, moved_values, told_values
from jaxsr.diagnosis.explaining.wrong_values import frozen
from jaxsr.diagnosis.judging.alternatives import TIE, Alternative, alternatives, odds
from jaxsr.diagnosis.judging.criteria import most_credible
from jaxsr.diagnosis.judging.detection import SIGNIFICANCE, detect_in_noise
from jaxsr.diagnosis.judging.equivalence import equivalent
from jaxsr.diagnosis.judging.noise_ratio import LIMITED, model_limited, residual_to_noise
from jaxsr.diagnosis.judging.parsimony import without_given, worth_their_constants
from jaxsr.diagnosis.judging.refine import Estimate, Ground, plain, refine
from jaxsr.diagnosis.open_mass import OpenMass, Proposal, open_mass
from jaxsr.diagnosis.verdict import Claim
from jaxsr.models import Edit, Model, apply_edit

UNEXPLAINED = 5.0
"""Ratio of re-calibrated residual to sensor noise from which a mismatch stays unexplained."""
SHARPENING = 0.3
"""The same for estimates without the rounding of jumps, and their comparison."""
ENDING = 0.1
"""Share of the time budget before whose end estimates are left where they stand."""
WRONG = 0.02
"""Log mean square that re-calibration must gain over the given values for these to be wrong."""
CONSTANT = 1.0
"""Free-run error (NRMSE) of the best constant, the mean of the readings."""
MATTERS = 1e-3
"""Share of the free-run error that physics left out must remove to be claimed."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Estimates, verdict and findings."""

    recalibrated: Estimate
    explained: Estimate
    verdict: Verdict
    findings: list[dict[str, Any]]
    rivals: list[tuple[int, list[Alternative]]]
    edits: tuple[Edit, ...] = ()  # of readings alone, which no simulation feels
    leader: Entry | None = None  # what `rivals` could replace, where nothing was chosen
    open: OpenMass = field(default_factory=OpenMass)  # of what was not compared
    confusable: tuple[list[Any], ...] = ()  # wrong values that others do as well as


def judge(parts: Ingredients) -> Judged:
    """Refine both models and give the verdict, what was not compared left open.

    Where time ends that, the estimates stand as the search left them, and nothing is said.
    """
    last = parts.case.budget.keeping(ENDING * parts.case.budget.seconds)
    try:
        with limited(lambda: last.remaining == 0.0):
            return _judged(parts)
    except OutOfTime:
        found = plain(parts.arena, parts.null)
        mass = open_mass(_proposals(parts))
        return Judged(found, found, Verdict.UNDECIDED, [], [], open=mass)


def _judged(parts: Ingredients) -> Judged:
    judged = _judged_by_compared(parts)
    mass = _open_mass(parts, judged)
    rows = [_lowered(row, mass.factor) for row in judged.findings]
    verdict = judged.verdict
    if mass.against(verdict) > TIE or not mass.follows:
        verdict = Verdict.UNDECIDED
    return replace(judged, findings=rows, verdict=verdict, open=mass)


def _open_mass(parts: Ingredients, judged: Judged) -> OpenMass:
    """Mass of what was not compared, where something ended the search before its time.

    A model whose squared error is above the variance of the readings follows them worse than
    their mean. What the evidence decided follows them down to the noise, if only from start to
    start: no simulation of what is unstable stays near a recording for long.
    """
    case, fitted = parts.case, judged.explained
    horizon = None if parts.headline == parts.horizons[-1] else parts.headline
    follows = parts.weights is not None
    if not follows:
        run = fitted.lean.free_run(case.prepared, fitted.theta, horizon, like=case.prepared)
        follows = not run.nrmse >= CONSTANT
    ended = parts.stopped in (StoppedBy.BUDGET, StoppedBy.INTERRUPTED)
    if not (ended or case.budget.interrupted or case.failures.lines):
        return open_mass([], follows)
    return open_mass(_proposals(parts), follows)


def _proposals(parts: Ingredients) -> list[Proposal]:
    """Return what the search could have compared, and what it did."""
    case = parts.case
    super_models = [parts.arena.super_model]
    if case.screened is not None:
        super_models.insert(0, case.screened.super_model)
    return list(case.compared.proposals(super_models, parts.entries, parts.chosen))


def _lowered(row: dict[str, Any], factor: float) -> dict[str, Any]:
    """Return a finding with its probabilities, over what was compared, lowered by a factor."""
    others = [{**a, "probability": factor * a["probability"]} for a in row["alternatives"]]
    return {**row, "probability": factor * row["probability"], "alternatives": others}


def _judged_by_compared(parts: Ingredients) -> Judged:
    """Give the verdict as if what was compared were everything."""
    case, arena = parts.case, parts.arena
    ground = Ground(
        arena,
        case.prepared,
        tuple(h for h in parts.horizons if h <= parts.headline),
        case.screened.grid if case.screened else None,
        case.budget.share(REFINING),
        case.budget.share(SHARPENING),
    )
    recalibrated = refine(ground, parts.null, thorough=not parts.chosen.members)
    recalibrated = not_worse(parts, completed(parts, recalibrated))
    if not parts.chosen.members:
        judged = _without_finding(parts, recalibrated)
        leading = [e for e in parts.entries if e.members and e.fit.cost < parts.null.fit.cost]
        if (
            judged.verdict is Verdict.UNDECIDED
            and leading
            and not (parts.claim and judged.findings)
        ):
            # Nothing is believed; what comes nearest is named.
            leader = _nearest(parts, leading)
            rows, rivals, _ = _rows(parts, leader, refine(ground, leader, thorough=False))
            judged = replace(judged, findings=rows, rivals=rivals, leader=leader)
        return judged
    parts, best = _worthy(parts, ground)
    if parts.weights is not None:
        best = parts.weights.told_of(best)
    rows, rivals, order = _rows(parts, parts.chosen, best)
    rows, rounding, edits = _with_sensors(parts, best, rows, _given(parts).fit.cost)
    verdict = _verdict(parts, order, rivals)
    if max((row["share"] for row in rounding), default=0.0) > rows[0]["share"]:
        verdict = Verdict.MEASUREMENT
    by_runs = parts.claim is None and verdict is not Verdict.MEASUREMENT
    every = sorted([*rows, *rounding], key=lambda row: -row["share"])
    if by_runs and not _simulates_better(parts, recalibrated, best):
        # Short runs of late or clipped readings start from what those do not tell: the set is
        # named, and nobody is given a model that follows worse than the re-calibrated one.
        undecided = Judged(recalibrated, recalibrated, Verdict.UNDECIDED, every, rivals)
        return replace(undecided, leader=parts.chosen)
    return Judged(recalibrated, best, verdict, every, rivals, tuple(edits))


def _nearest(parts: Ingredients, entries: Sequence[Entry]) -> Entry:
    """Return the most probable of some sets, by the evidence where that decided."""
    super_model, weights = parts.arena.super_model, parts.weights
    if weights is None:
        return most_credible(super_model, entries)
    return max(entries, key=lambda e: weights.share(super_model, e))


def _worthy(parts: Ingredients, ground: Ground) -> tuple[Ingredients, Estimate]:
    """Return the chosen set, refined, and what it is compared with."""
    if parts.weights is None:  # what the evidence says of mechanisms stands
        rivals = worth_their_constants(parts.chosen, parts.arena, parts.entries)
        parts = replace(parts, entries=rivals)
    best = completed(parts, refine(ground, parts.chosen))
    while (fewer := without_given(parts.chosen, parts.arena, parts.entries, best)) is not None:
        parts = replace(parts, chosen=fewer)
        best = completed(parts, refine(ground, fewer))
    return parts, best


def _rows(
    parts: Ingredients, entry: Entry, estimate: Estimate
) -> tuple[list[dict[str, Any]], list[tuple[int, list[Alternative]]], list[int]]:
    """Findings of an entry by falling share, what could replace each, and the order by share."""
    rows, rivals = [], []
    given = _given(parts).fit.cost
    costs = costs_of_sets(parts, entry)
    for k, number in enumerate(entry.members):
        known = parts.arena.super_model, entry, number, parts.entries
        if parts.weights is not None:
            probability, others = parts.weights.alternatives(*known)
        else:
            probability, others = alternatives(*known, parts.rng)
        weight = Weight.of(
            given, costs.get(frozenset(entry.members) - {number}, np.inf), entry.fit.cost
        )
        rows.append(finding_row(parts, estimate, k, number, probability, others, weight))
        rivals.append((number, others))
    if (told := portions(entry.members, costs)) is not None:
        rows = [row | told.row(k) for k, row in enumerate(rows)]
    order = sorted(range(len(rows)), key=lambda k: -rows[k]["share"])
    return [rows[k] for k in order], rivals, order


def _verdict(parts: Ingredients, order: list[int], rivals: list) -> Verdict:
    """Verdict of the largest share, unless a cause of another kind is nearly as probable.

    Where a state hides, an estimate may end far from the best one: what is left above the noise
    then says that none of the sets can be trusted.
    """
    candidates = parts.arena.super_model.candidates
    number, others = rivals[order[0]]
    own = candidates[number].verdict
    if parts.claim is not None:
        return Verdict.UNDECIDED if parts.claim.verdict is Verdict.UNDECIDED else own
    if parts.case.screened is None and model_limited(parts.arena, parts.chosen):
        return Verdict.UNDECIDED
    model = parts.arena.super_model.given
    doubt = sum(
        a.probability
        for a in others
        if candidates[a.number].verdict != own
        and not equivalent(model, candidates[number], candidates[a.number])
    )
    return Verdict.UNDECIDED if doubt > TIE else own


def _simulates_better(parts: Ingredients, recalibrated: Estimate, best: Estimate) -> bool:
    """Whether the explained model beats re-calibration in free run, the measure of the report.

    By `MATTERS`, over the headline's horizon or over whole recordings: short runs begin at noisy
    readings, which can hide what a model gains, and long ones of an unstable system, which follow
    no better than a constant, tell nothing.
    """

    def better(horizon: float | None) -> bool:
        before, after = (
            e.lean.free_run(parts.case.prepared, e.theta, horizon).nrmse
            for e in (recalibrated, best)
        )
        return after < min(before * (1.0 - MATTERS), CONSTANT)

    whole = parts.headline == parts.horizons[-1]
    return (not whole and better(parts.headline)) or better(None)


def _without_finding(parts: Ingredients, recalibrated: Estimate) -> Judged:
    """Tell nothing from a wrong value from a mismatch that no mechanism explains."""
    if parts.claim is not None:
        return _by_claim(parts, recalibrated, parts.claim)
    given = _given(parts)
    names = moved_values(parts, recalibrated)
    findings, explained, alike = [], recalibrated, ()
    _, rounding, edits = _with_sensors(parts, recalibrated, [], given.fit.cost)
    if names and _differ(given, recalibrated):
        probability = odds(parts.arena.super_model, recalibrated.entry, given, parts.rng)
        told = told_values(parts, recalibrated, names, given.fit.cost)
        findings = told.rows(dict.fromkeys(names, probability), probability)
        explained, alike = told.estimate, told.confusable
    unexplained = residual_to_noise(recalibrated.arena, recalibrated.entry) > UNEXPLAINED
    if findings or rounding:
        both = sorted([*rounding, *findings], key=lambda row: -row["share"])
        measured = both[0]["family"] == "measurement"
        first = Verdict.MEASUREMENT if measured else Verdict.PARAMETER
        # wrong values do not account for what stands far above the noise
        first = Verdict.UNDECIDED if unexplained and not rounding else first
        judged = Judged(recalibrated, explained, first, both, [], tuple(edits))
        return replace(judged, confusable=alike)
    verdict = Verdict.UNDECIDED if unexplained else Verdict.NOTHING
    return Judged(recalibrated, recalibrated, verdict, [], [])


def _by_claim(parts: Ingredients, recalibrated: Estimate, claim: Claim) -> Judged:
    """Return what is said where the most probable set is re-calibration alone."""
    assert parts.weights is not None
    cost, labels = _given(parts).fit.cost, "wrong_value@parameter:{}".format
    free = parts.case.simulator.model.free_parameters
    names = [n for n in free if labels(n) in claim.leading]
    told = told_values(parts, recalibrated, names, cost)
    each = {n: parts.weights.of_label(labels(n)) for n in names}
    findings = told.rows(each, parts.weights.of_any(map(labels, names)))
    _, rounding, edits = _with_sensors(parts, recalibrated, [], cost)
    both = sorted([*rounding, *findings], key=lambda row: -row["share"])
    measured = bool(both) and both[0]["family"] == "measurement"
    verdict = Verdict.MEASUREMENT if measured else claim.verdict
    judged = Judged(recalibrated, told.estimate, verdict, both, [], tuple(edits))
    return replace(judged, confusable=told.confusable)


def _with_sensors(
    parts: Ingredients, estimate: Estimate, rows: list[dict[str, Any]], given: float
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], list[Edit]]:
    """Return rows with shares of the whole mismatch, those of sensors' readings, and their edits.

    Readings that lost their signs are a part of the mismatch that the estimates do not see.
    """
    rounding, edits = rounding_rows(parts, estimate, given)
    unsigned, more = [], []
    if parts.case.rectified:
        unsigned, more = rectified_rows(parts.case, estimate, given, where(parts))
    seen = 1.0 - max((row["share"] for row in unsigned), default=0.0)
    rows, rounding = (
        [{**r, "share": seen * r["share"]} for r in part] for part in (rows, rounding)
    )
    return rows, [*rounding, *unsigned], [*edits, *more]


def _differ(given: Entry, recalibrated: Estimate) -> bool:
    """Whether re-calibration beats the given values: by the likelihood, or block by block.

    Blocks of which noise leaves little in some tell less than all residuals together.
    """
    best = recalibrated.entry
    if residual_to_noise(recalibrated.arena, best) <= LIMITED:
        test = detect_in_noise(given, best, 1)
        return test.detected and test.log_gain > WRONG
    mean, _, p = gain(given.errors, best.errors)
    return p < SIGNIFICANCE and mean > WRONG


def _given(parts: Ingredients) -> Entry:
    """Return the given values' entry."""
    return enter(frozen(parts.arena), (), neutral_values(parts.arena.super_model))


def explained(judged: Judged) -> Model:
    """The explained model: the given one with every finding and all estimates."""
    model = judged.explained.model
    for edit in judged.edits:
        model = apply_edit(model, edit)
    return model
