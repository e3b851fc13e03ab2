"""Assembling the diagnosis: verdict, fit on held-out recordings, evidence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from jaxsr._result import StoppedBy
from jaxsr.diagnosis.contest.arena import neutral_values
from jaxsr.diagnosis.contest.scoring import FreeRun
from jaxsr.diagnosis.contest.uncertainty import Sensitivities, sensitivities
from jaxsr.diagnosis.explaining.evidence import Forces, build_evidence, force_errors
from jaxsr.diagnosis.explaining.explain import (
    calibration_rows,
    confusable_rows,
    detectable_rows,
    next_experiment,
)
from jaxsr.diagnosis.explaining.judge import Ingredients, Judged, explained, judge
from jaxsr.diagnosis.explaining.whole_runs import Runs, whole_horizons, whole_runs
from jaxsr.diagnosis.result import SCHEMA, Diagnosis
from jaxsr.diagnosis.thinning import Whole, prepare_search
from jaxsr.models.segments import Prepared
from jaxsr.recordings import check_recording

LEFT = 0.05
"""Share of the time budget that evidence leaves for drawing and writing."""
SHORT, FULL = 0.35, 0.6
"""Shares of the time left after which runs over all of long recordings end: short ones, and those
over whole recordings."""


def assemble(parts: Ingredients) -> Diagnosis:
    """Refine, judge, and only then open the held-out recordings."""
    case = parts.case
    case.progress.stage("refining the explained model")
    judged = judge(parts)
    explained_model = explained(judged)
    case.progress.stage("free runs on the training recordings")
    train = _runs(parts, judged, case.prepared, parts.whole)
    held, held_runs = (), None
    if parts.held_out:
        held, held_whole = prepare_search(case.simulator.model, parts.held_out)
        case.progress.stage("free runs on the held-out recordings")
        held_runs = _runs(parts, judged, held, held_whole)
    half_width = case.screened.half_width if case.screened else None
    forces = Forces.of(judged, case.prepared, half_width) if half_width else None
    others = Forces.of(judged, held, half_width) if half_width and held else None
    force = force_errors(case.simulator.model, forces, others)
    document = _document(parts, judged, train, held_runs, force)
    remarks = len(document["data_checks"])
    evidence = build_evidence(parts, judged, explained_model, train, held_runs, forces, remarks)
    return Diagnosis(
        verdict=judged.verdict.value,
        findings=judged.findings,
        model=explained_model,
        given=case.simulator.model,
        fit=document["fit"],
        document=document,
        evidence=evidence,
    )


def _horizons(parts: Ingredients) -> list[float]:
    """Horizons of the report in s, the last one the whole recording."""
    return parts.horizons if parts.whole is None else whole_horizons(parts.whole, parts.horizons)


def _runs(
    parts: Ingredients, judged: Judged, prepared: Sequence[Prepared], whole: Whole | None
) -> Runs:
    """Free runs of the three models at every horizon; piece by piece over `whole`, if given."""
    before, after = judged.recalibrated, judged.explained
    own = after.theta if prepared is parts.case.prepared else after.elsewhere
    models = {
        "given": (before.lean, neutral_values(parts.arena.super_model)),
        "recalibrated": (before.lean, before.theta),
        "explained": (after.lean, own),
    }
    if after is before:
        del models["explained"]
    horizons = _horizons(parts)
    if whole is None:
        runs: dict[str, list[FreeRun]] = {name: [] for name in models}
        for horizon in horizons:
            length = None if horizon == horizons[-1] else horizon
            for name, (lean, theta) in models.items():
                runs[name].append(lean.free_run(prepared, theta, length, like=parts.case.prepared))
        found = Runs(runs, tuple(p.recording for p in prepared))
    else:
        stops = _until(parts, SHORT), _until(parts, FULL)
        found = whole_runs(whole, models, horizons, parts.headline, stops)
    found.models.setdefault("explained", found.models["recalibrated"])
    return found


def _until(parts: Ingredients, share: float) -> Callable[[], bool]:
    budget = parts.case.budget.share(share)
    return lambda: budget.exhausted


def _document(
    parts: Ingredients,
    judged: Judged,
    train: Runs,
    held_runs: Runs | None,
    force: dict[str, Any] | None,
) -> dict[str, Any]:
    case, model = parts.case, parts.case.simulator.model
    inner, outer = _sensitivities(parts)
    fit: dict[str, Any] = {
        "measure": "free-run NRMSE",
        "horizons_s": _horizons(parts),
        "headline_s": parts.headline,
        "train": {name: [r.nrmse for r in runs] for name, runs in train.models.items()},
        "held_out": None,
        "force": force,
    }
    if held_runs is not None:
        scores = {name: [r.nrmse for r in runs] for name, runs in held_runs.models.items()}
        fit["held_out"] = {**scores, "files": [r.name for r in held_runs.recordings]}
    columns = [model.column(c) for c in (*model.inputs, *model.outputs)]
    inputs = [model.column(c) for c in model.inputs]
    checks = [
        {"file": c.file, "channel": c.channel, "check": c.check, "message": c.message}
        for r in train.recordings
        for c in check_recording(r, columns, inputs)
    ]
    checks += _thinned(parts, judged, train)
    return {
        "schema": SCHEMA,
        "verdict": judged.verdict.value,
        "findings": judged.findings,
        "calibration": calibration_rows(judged.explained, model),
        "fit": fit,
        "confusable": confusable_rows(parts, outer) if outer else [],
        "smallest_detectable": detectable_rows(parts, inner) if inner else {},
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
            "data_sha256": {r.name: r.sha256 for r in train.recordings},
        },
    }


def _sensitivities(parts: Ingredients) -> tuple[Sensitivities | None, Sensitivities | None]:
    """Effects of all candidates beside the chosen set and beside re-calibration, if time is left.

    The first tells how long the second takes.
    """
    budget = parts.case.budget
    if budget.remaining < LEFT * budget.seconds:
        return None, None
    before = budget.elapsed
    inner = sensitivities(parts.arena, parts.chosen.fit, exclude=parts.chosen.members)
    if parts.chosen is parts.null:
        return inner, inner
    took = budget.elapsed - before
    if budget.remaining - took < LEFT * budget.seconds:
        return inner, None
    return inner, sensitivities(parts.arena, parts.null.fit)


def _thinned(parts: Ingredients, judged: Judged, train: Runs) -> list[dict[str, str]]:
    """Say what the search worked on, where that is not everything."""
    whole = parts.whole
    if whole is None:
        return []
    pieces, many = len(parts.case.prepared), len(whole.recordings)
    every = f", one of {whole.factor} of these" if whole.factor > 1 else ""
    text = (
        f"The search worked on {pieces} stretches, {whole.searched} of {whole.samples} samples"
        f"{every}; the estimate rests on {_percent(judged.explained.share)} of all samples, the "
        f"errors in free run on {_percent(train.share)}."
    )
    file = whole.recordings[0].name if many == 1 else f"{many} recordings"
    return [{"file": file, "channel": "", "check": "thinned", "message": text}]


def _percent(share: float) -> str:
    return f"{100.0 * share:.3g} %"


def _version() -> str:
    try:
        return version("jaxsr-dynamics")
    except PackageNotFoundError:
        return "unknown"
