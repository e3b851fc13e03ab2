"""Assembling the diagnosis: verdict, fit on held-out recordings, evidence."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from jaxsr._result import InputError, StoppedBy
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import neutral_values
from jaxsr.diagnosis.contest.scoring import FreeRun
from jaxsr.diagnosis.contest.uncertainty import sensitivities
from jaxsr.diagnosis.explaining.evidence import Forces, build_evidence, force_errors
from jaxsr.diagnosis.explaining.explain import (
    calibration_rows,
    confusable_rows,
    detectable_rows,
    next_experiment,
)
from jaxsr.diagnosis.explaining.judge import Ingredients, Judged, explained, judge
from jaxsr.diagnosis.result import SCHEMA, Diagnosis
from jaxsr.diagnosis.setup import prepare
from jaxsr.models import Model
from jaxsr.models.segments import Prepared
from jaxsr.models.states import is_absent
from jaxsr.recordings import Recording, check_recording


def assemble(parts: Ingredients) -> Diagnosis:
    """Refine, judge, and only then open the held-out recordings."""
    case = parts.case
    case.progress.stage("refining the explained model")
    judged = judge(parts)
    explained_model = explained(judged)
    case.progress.stage("free runs on the training recordings")
    train = _runs(parts, judged, case.prepared)
    held, unread = _held_out(parts)
    if held:
        case.progress.stage("free runs on the held-out recordings")
    held_runs = _runs(parts, judged, held) if held else None
    forces, others = case.failures.attempt(
        "comparing forces", lambda: _forces(parts, judged, held), (None, None)
    )
    force = force_errors(case.simulator.model, forces, others)
    document = _document(parts, judged, train, held_runs, held, force)
    document["data_checks"] += [*unread, *_broken(case)]
    remarks = len(document["data_checks"])
    evidence = build_evidence(
        parts, judged, explained_model, train, held_runs, held, forces, remarks
    )
    return Diagnosis(
        verdict=judged.verdict.value,
        findings=judged.findings,
        model=explained_model,
        given=case.simulator.model,
        fit=document["fit"],
        document=document,
        evidence=evidence,
    )


def _held_out(parts: Ingredients) -> tuple[tuple[Prepared, ...], list[dict[str, str]]]:
    """Open the held-out recordings; those that cannot be used are named, and nothing is lost."""
    held, unread = [], []
    for item in parts.held_out:
        try:
            held += prepare(parts.case.simulator.model, [item])
        except InputError as error:
            name = item.name if isinstance(item, Recording | Path) else Path(item).name
            unread.append({"file": name, "channel": "", "check": "held_out", "message": str(error)})
            parts.case.progress.stage(f"left out of the held-out recordings: {error}")
    return tuple(held), unread


def _broken(case: Case) -> list[dict[str, str]]:
    """Steps of the search that broke: a reader must know what was not tried."""
    none = {"file": "", "channel": "", "check": "search"}
    return [{**none, "message": line} for line in case.failures.lines]


def _forces(
    parts: Ingredients, judged: Judged, held: Sequence[Prepared]
) -> tuple[Forces | None, Forces | None]:
    """The weak view of both roles' recordings, where equations can be read off the sensors."""
    screened = parts.case.screened
    if screened is None:
        return None, None
    forces = Forces.of(judged, parts.case.prepared, screened.half_width)
    return forces, Forces.of(judged, held, screened.half_width) if held else None


def _runs(
    parts: Ingredients, judged: Judged, prepared: Sequence[Prepared]
) -> dict[str, list[FreeRun]]:
    """Free runs of the three models at every horizon."""
    before, after = judged.recalibrated, judged.explained
    neutral = neutral_values(parts.arena.super_model)
    own = after.theta if prepared is parts.case.prepared else after.elsewhere
    runs: dict[str, list[FreeRun]] = {"given": [], "recalibrated": [], "explained": []}
    for horizon in parts.horizons:
        whole = None if horizon == parts.horizons[-1] else horizon
        for name, estimate, theta in (
            ("given", before, neutral),
            ("recalibrated", before, before.theta),
            ("explained", after, own),
        ):
            if name == "explained" and after is before:
                runs[name].append(runs["recalibrated"][-1])
                continue
            runs[name].append(
                estimate.lean.free_run(prepared, theta, whole, like=parts.case.prepared)
            )
    return runs


def _document(
    parts: Ingredients,
    judged: Judged,
    train: dict[str, list[FreeRun]],
    held_runs: dict[str, list[FreeRun]] | None,
    held: Sequence[Prepared],
    force: dict[str, Any] | None,
) -> dict[str, Any]:
    case, model = parts.case, parts.case.simulator.model
    attempt = case.failures.attempt

    def confusable() -> list[list[Any]]:
        return confusable_rows(parts, sensitivities(parts.arena, parts.null.fit))

    def detectable() -> dict[str, Any]:
        own = sensitivities(parts.arena, parts.chosen.fit, exclude=parts.chosen.members)
        return detectable_rows(parts, own)

    fit: dict[str, Any] = {
        "measure": "free-run NRMSE",
        "horizons_s": parts.horizons,
        "headline_s": parts.headline,
        "train": {name: [r.nrmse for r in runs] for name, runs in train.items()},
        "held_out": None,
        "force": force,
    }
    if held_runs is not None:
        scores = {name: [r.nrmse for r in runs] for name, runs in held_runs.items()}
        fit["held_out"] = {**scores, "files": [p.recording.name for p in held]}
    checks = [row for p in case.prepared for row in _checks(model, p.recording)]
    return {
        "schema": SCHEMA,
        "verdict": judged.verdict.value,
        "findings": judged.findings,
        "calibration": calibration_rows(judged.explained, model),
        "fit": fit,
        "confusable": attempt("comparing effects", confusable, []),
        "smallest_detectable": attempt("finding what would show", detectable, {}),
        "next_experiment": attempt(
            "choosing the next experiment", lambda: next_experiment(parts, judged.rivals), None
        ),
        "data_checks": checks,
        "provenance": {
            "version": _version(),
            "seed": parts.seed,
            "command": parts.command,
            "seconds": round(case.budget.elapsed, 1),
            "stopped_by": (
                StoppedBy.INTERRUPTED if case.budget.interrupted else parts.stopped
            ).value,
            "data_sha256": {p.recording.name: p.recording.sha256 for p in case.prepared},
        },
    }


def _checks(model: Model, recording: Recording) -> list[dict[str, str]]:
    """What a measurement may have done to the data, and the sensors that a recording lacks."""
    inputs = [model.column(c) for c in model.inputs]
    outputs = [model.column(c) for c in model.outputs]
    absent = [c for c in outputs if is_absent(recording, c)]
    present = [c for c in (*inputs, *outputs) if c not in absent]
    found = [
        {
            "file": recording.name,
            "channel": column,
            "check": "missing_samples",
            "message": f"{recording.name} has no sample of {column}",
        }
        for column in absent
    ]
    return found + [
        {"file": c.file, "channel": c.channel, "check": c.check, "message": c.message}
        for c in check_recording(recording, present, inputs)
    ]


def _version() -> str:
    try:
        return version("jaxsr-dynamics")
    except PackageNotFoundError:
        return "unknown"
