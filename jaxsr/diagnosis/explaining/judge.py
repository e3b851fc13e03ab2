"""Judging a decision: final estimates, findings by their shares, the verdict."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxsr._deadline import OutOfTime, limited
from jaxsr._result import StoppedBy, Verdict
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
from jaxsr.diagnosis.explaining.value_findings import REFINING, told_values
from jaxsr.diagnosis.explaining.wrong_values import frozen
from jaxsr.diagnosis.judging.parsimony import without_given
from jaxsr.diagnosis.judging.refine import Estimate, Ground, plain, refine
from jaxsr.diagnosis.judging.weights import Alternative
from jaxsr.diagnosis.open_mass import OpenMass, Proposal, open_mass
from jaxsr.diagnosis.shooting.arena import neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.models import Edit, Model, apply_edit

SHARPENING = 0.3
"""Share of the time left that estimates without the rounding of jumps may take."""
TIE = 0.2
"""Mass of what was not compared, with another verdict, that makes a case undecided."""
ENDING, HURRIED = 0.1, 0.05
"""Shares of the time budget before whose end estimates are left where they stand, and before which
findings are told by these."""


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
    read_off: bool = False  # whether the verdict is what the readings themselves show


def judge(parts: Ingredients) -> Judged:
    """Refine both models and give the verdict, what was not compared left open.

    Where time ends that, the estimates stand as the search left them; where it ends that as well,
    nothing is said.
    """
    for kept, judged_by in ((ENDING, _judged_by_compared), (HURRIED, _judged_as_left)):
        last = parts.case.budget.keeping(kept * parts.case.budget.seconds)
        with contextlib.suppress(OutOfTime), limited(lambda last=last: last.remaining == 0.0):
            return _judged(parts, judged_by(parts))
    found = plain(parts.arena, parts.null)
    mass = open_mass(_proposals(parts))
    return Judged(found, found, Verdict.UNDECIDED, [], [], open=mass)


def _judged(parts: Ingredients, judged: Judged) -> Judged:
    """Return a verdict on what was compared with what was not left open."""
    mass = _open_mass(parts)
    rows = [_lowered(row, mass.factor) for row in judged.findings]
    verdict = judged.verdict
    if mass.against(verdict) > TIE and not judged.read_off:
        verdict = Verdict.UNDECIDED
    return replace(judged, findings=rows, verdict=verdict, open=mass)


def _open_mass(parts: Ingredients) -> OpenMass:
    """Mass of what was not compared, where something ended the search before its time."""
    case = parts.case
    ended = parts.stopped in (StoppedBy.BUDGET, StoppedBy.INTERRUPTED)
    if not (ended or case.budget.interrupted or case.failures.lines):
        return open_mass([], parts.borne_out)
    return open_mass(_proposals(parts), parts.borne_out)


def _proposals(parts: Ingredients) -> list[Proposal]:
    """Return what the search could have compared, and what it did."""
    case = parts.case
    seen = () if case.seen is None else case.seen.candidates
    every = [*seen, *parts.arena.super_model.candidates]
    return list(case.compared.proposals(every, parts.entries))


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
        case.seen.grid if case.seen else None,
        case.budget.share(REFINING),
        case.budget.share(SHARPENING),
    )
    recalibrated = refine(ground, parts.null, thorough=not parts.chosen.members)
    recalibrated = not_worse(parts, completed(parts, recalibrated))
    if not parts.chosen.members:
        return _without_mechanism(parts, ground, recalibrated)
    parts, best = _worthy(parts, ground)
    return _told(parts, recalibrated, best)


def _judged_as_left(parts: Ingredients) -> Judged:
    """Give the verdict with estimates as the search left them."""
    recalibrated = plain(parts.arena, parts.null)
    if not parts.chosen.members:
        return _by_claim(parts, recalibrated)
    return _told(parts, recalibrated, plain(parts.arena, parts.chosen), hurried=True)


def _told(
    parts: Ingredients, recalibrated: Estimate, best: Estimate, hurried: bool = False
) -> Judged:
    """Say what the members of the chosen set are; if `hurried` without a further estimate."""
    best = parts.weights.told_of(best)
    rows, rivals, order = _rows(parts, parts.chosen, best, hurried)
    rows, rounding, edits = _with_sensors(parts, best, rows, _given(parts).fit.cost)
    read_off = max((row["share"] for row in rounding), default=0.0) > rows[0]["share"]
    verdict = Verdict.MEASUREMENT if read_off else _verdict(parts, order)
    every = sorted([*rows, *rounding], key=lambda row: -row["share"])
    told = Judged(recalibrated, best, verdict, every, rivals, tuple(edits), read_off=read_off)
    if parts.borne_out or _runs_better(parts, recalibrated, best):
        return told
    # The set is named, and nobody is given a model that follows worse than the re-calibrated one.
    return replace(told, explained=recalibrated, leader=parts.chosen)


def _runs_better(parts: Ingredients, before: Estimate, after: Estimate) -> bool:
    """Whether a model follows whole recordings better than another."""
    first, second = (
        e.lean.free_run(parts.case.prepared, e.theta, None).nrmse for e in (before, after)
    )
    return second < first


def _without_mechanism(parts: Ingredients, ground: Ground, recalibrated: Estimate) -> Judged:
    """Judge re-calibration alone; where nothing is claimed, what comes nearest is named."""
    judged = _by_claim(parts, recalibrated)
    leading = [e for e in parts.entries if e.members and e.fit.cost < parts.null.fit.cost]
    if judged.verdict is not Verdict.UNDECIDED or judged.findings or not leading:
        return judged
    super_model, weights = parts.arena.super_model, parts.weights
    leader = max(leading, key=lambda e: weights.share(super_model, e))
    rows, rivals, _ = _rows(parts, leader, refine(ground, leader, thorough=False))
    return replace(judged, findings=rows, rivals=rivals, leader=leader)


def _worthy(parts: Ingredients, ground: Ground) -> tuple[Ingredients, Estimate]:
    """Return the chosen set, refined, and what it is compared with."""
    best = completed(parts, refine(ground, parts.chosen))
    while (fewer := without_given(parts.chosen, parts.arena, parts.entries, best)) is not None:
        parts = replace(parts, chosen=fewer)
        best = completed(parts, refine(ground, fewer))
    return parts, best


def _rows(
    parts: Ingredients, entry: Entry, estimate: Estimate, hurried: bool = False
) -> tuple[list[dict[str, Any]], list[tuple[int, list[Alternative]]], list[int]]:
    """Findings of an entry by falling share, what could replace each, and the order by share."""
    rows, rivals = [], []
    given = _given(parts).fit.cost
    costs = costs_of_sets(parts, entry, hurried)
    for k, number in enumerate(entry.members):
        known = parts.arena.super_model, entry, number, parts.entries
        probability, others = parts.weights.alternatives(*known)
        weight = Weight.of(
            given, costs.get(frozenset(entry.members) - {number}, np.inf), entry.fit.cost
        )
        rows.append(finding_row(parts, estimate, k, number, probability, others, weight))
        rivals.append((number, others))
    if (told := portions(entry.members, costs)) is not None:
        rows = [row | told.row(k) for k, row in enumerate(rows)]
    order = sorted(range(len(rows)), key=lambda k: -rows[k]["share"])
    return [rows[k] for k in order], rivals, order


def _verdict(parts: Ingredients, order: list[int]) -> Verdict:
    """Verdict of the largest share, where a claim is made."""
    largest = parts.arena.super_model.candidates[parts.chosen.members[order[0]]]
    undecided = parts.claim.verdict is Verdict.UNDECIDED
    return Verdict.UNDECIDED if undecided else largest.verdict


def _by_claim(parts: Ingredients, recalibrated: Estimate) -> Judged:
    """Return what is said where the most probable set is re-calibration alone."""
    claim = parts.claim
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
    return replace(judged, confusable=told.confusable, read_off=measured)


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


def _given(parts: Ingredients) -> Entry:
    """Return the given values' entry."""
    return enter(frozen(parts.arena), (), neutral_values(parts.arena.super_model))


def explained(judged: Judged) -> Model:
    """The explained model: the given one with every finding and all estimates."""
    model = judged.explained.model
    for edit in judged.edits:
        model = apply_edit(model, edit)
    return model
