"""Assembling the diagnosis: verdict, fit on held-out recordings, evidence."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from jaxsr._result import StoppedBy
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
from jaxsr.models.segments import Prepared
from jaxsr.recordings import check_recording


def assemble(parts: Ingredients) -> Diagnosis:
    """Refine, judge, and only then open the held-out recordings."""
    case = parts.case
    case.progress.stage("refining the explained model")
    judged = judge(parts)
    explained_model = explained(judged)
    case.progress.stage("free runs on the training recordings")
    train = _runs(parts, judged, case.prepared)
    held = prepare(case.simulator.model, parts.held_out) if parts.held_out else ()
    if held:
        case.progress.stage("free runs on the held-out recordings")
    held_runs = _runs(parts, judged, held) if held else None
    half_width = case.screened.half_width if case.screened else None
    forces = Forces.of(judged, case.prepared, half_width) if half_width else None
    others = Forces.of(judged, held, half_width) if half_width and held else None
    force = force_errors(case.simulator.model, forces, others)
    document = _document(parts, judged, train, held_runs, held, force)
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
    inner = sensitivities(parts.arena, parts.chosen.fit, exclude=parts.chosen.members)
    outer = sensitivities(parts.arena, parts.null.fit)
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
    columns = [model.column(c) for c in (*model.inputs, *model.outputs)]
    inputs = [model.column(c) for c in model.inputs]
    checks = [
        {"file": c.file, "channel": c.channel, "check": c.check, "message": c.message}
        for p in case.prepared
        for c in check_recording(p.recording, columns, inputs)
    ]
    return {
        "schema": SCHEMA,
        "verdict": judged.verdict.value,
        "findings": judged.findings,
        "calibration": calibration_rows(judged.explained, model),
        "fit": fit,
        "confusable": confusable_rows(parts, outer),
        "smallest_detectable": detectable_rows(parts, inner),
        "next_experiment": next_experiment(parts, judged.rivals),
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


def _version() -> str:
    try:
        return version("jaxsr-dynamics")
    except PackageNotFoundError:
        return "unknown"
