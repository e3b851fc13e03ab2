"""Assembling the diagnosis: verdict, fit on held-out recordings, evidence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from jaxsr._deadline import OutOfTime, limited, unlimited
from jaxsr._progress import Repeated
from jaxsr._result import InputError, StoppedBy
from jaxsr._versions import environment, own_version
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.explaining.bounds import bound_rows
from jaxsr.diagnosis.explaining.detectable import detectable_rows
from jaxsr.diagnosis.explaining.evidence import Forces, build_evidence, force_errors
from jaxsr.diagnosis.explaining.experiment import next_experiment
from jaxsr.diagnosis.explaining.explain import (
    calibration_rows,
    confusable_rows,
)
from jaxsr.diagnosis.explaining.ingredients import Ingredients
from jaxsr.diagnosis.explaining.judge import Judged, explained, judge
from jaxsr.diagnosis.explaining.whole_runs import Runs, whole_horizons, whole_runs
from jaxsr.diagnosis.input_noise import quieted
from jaxsr.diagnosis.rectified import Rectified, signed
from jaxsr.diagnosis.result import SCHEMA, Diagnosis
from jaxsr.diagnosis.setup import open_recording
from jaxsr.diagnosis.shooting.arena import neutral_values
from jaxsr.diagnosis.shooting.scoring import FreeRun, not_run
from jaxsr.diagnosis.shooting.uncertainty import Sensitivities, sensitivities
from jaxsr.diagnosis.thinning import Whole, prepare_search
from jaxsr.models import Model
from jaxsr.models.physical_constants import remarks
from jaxsr.models.segments import Prepared
from jaxsr.models.states import input_table, is_absent, output_table
from jaxsr.recordings import DataCheck, Recording, check_recording

LEFT = 0.05
"""Share of the time budget that evidence leaves for drawing and writing."""
SHORT, FULL = 0.35, 0.6
"""Shares of the time left after which runs over all of long recordings end: short ones, and those
over whole recordings."""


def assemble(parts: Ingredients) -> Diagnosis:
    """Refine, judge, and only then open the held-out recordings.

    What time ends is left out; at the end some is kept for drawing and writing.
    """
    last = parts.case.budget.keeping(LEFT * parts.case.budget.seconds)
    with limited(lambda: last.remaining == 0.0):
        return _assembled(parts)


def _assembled(parts: Ingredients) -> Diagnosis:
    case = parts.case
    case.progress.stage("refining the explained model")
    judged = judge(parts)
    explained_model = explained(judged)
    case.progress.stage("free runs on the training recordings")
    train = _runs(parts, judged, case.prepared, parts.whole)
    with unlimited():
        held, held_whole, unread = _held_out(parts)
    held_runs = None
    if held:
        case.progress.stage("free runs on the held-out recordings")
        held_runs = _runs(parts, judged, held, held_whole)
    forces, others = case.failures.attempt(
        "comparing forces", lambda: _forces(parts, judged, held), (None, None)
    )
    force = force_errors(case.simulator.model, forces, others)
    document = _document(parts, judged, train, held_runs, force)
    for name, error in unread.items():
        row = {"file": name, "channel": "", "check": "held_out", "message": str(error)}
        document["data_checks"].append(row)
    document["data_checks"] += _broken(case, [said] if (said := _left_open(parts, judged)) else [])
    count = len(document["data_checks"])
    evidence = build_evidence(
        parts, judged, explained_model, train, held_runs, (forces, others), count
    )
    return Diagnosis(
        model=explained_model,
        given=case.simulator.model,
        document=document,
        evidence=evidence,
        unread=tuple(unread.values()),
    )


def _horizons(parts: Ingredients) -> list[float]:
    """Horizons of the report in s, the last one the whole recording."""
    return parts.horizons if parts.whole is None else whole_horizons(parts.whole, parts.horizons)


def _held_out(
    parts: Ingredients,
) -> tuple[tuple[Prepared, ...], Whole | None, dict[str, InputError]]:
    """Open the held-out recordings; those that cannot be used are named, and nothing is lost."""
    model, good, unread = parts.case.simulator.model, [], {}
    for item in parts.held_out:
        try:
            recording = open_recording(model, item)
            _ = input_table(model, recording), output_table(model, recording)
            good.append(recording)
        except InputError as error:
            name = item.name if isinstance(item, Recording | Path) else Path(item).name
            unread[name] = error
            parts.case.progress.stage(f"left out of the held-out recordings: {error}")
    if not good:
        return (), None, unread
    if parts.case.rectified:
        good = signed(model, good, parts.case.rectified)
    seconds = parts.case.budget.seconds
    prepared, whole = prepare_search(model, good, checked=False, seconds=seconds)
    if parts.case.quiet and whole is None:
        prepared = quieted(model, prepared, parts.case.quiet)
    return prepared, whole, unread


def _broken(case: Case, more: list[str]) -> list[dict[str, str]]:
    """Steps of the search that broke, and `more`: a reader must know what was not tried."""
    none = {"file": "", "channel": "", "check": "search"}
    return [{**none, "message": line} for line in (*case.failures.lines, *more)]


def _stopped(parts: Ingredients) -> StoppedBy:
    """Why no more was compared."""
    return StoppedBy.INTERRUPTED if parts.case.budget.interrupted else parts.stopped


def _left_open(parts: Ingredients, judged: Judged) -> str:
    """Say what was not compared, and whether anything follows the recordings."""
    return judged.open.in_words(_stopped(parts))


def _forces(
    parts: Ingredients, judged: Judged, held: Sequence[Prepared]
) -> tuple[Forces | None, Forces | None]:
    """The weak view of both roles' recordings, where equations can be read off the sensors."""
    seen = parts.case.seen
    if seen is None:
        return None, None
    forces = Forces.of(judged, parts.case.prepared, seen.half_width)
    return forces, Forces.of(judged, held, seen.half_width) if held else None


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
        last = parts.case.budget.keeping(LEFT * parts.case.budget.seconds)

        def run(name: str, horizon: float) -> FreeRun:
            lean, theta = models[name]
            length = None if horizon == horizons[-1] else horizon
            needed = horizon == parts.headline
            try:
                return lean.free_run(
                    *(prepared, theta, length, parts.case.prepared),
                    lambda: last.exhausted and not needed,
                )
            except OutOfTime:
                return not_run(prepared)

        at = _in_time(parts, horizons)
        done = {h: {name: run(name, h) for name in models} for h in at}
        nothing = not_run(prepared)
        runs = {
            name: [done[h][name] if h in done else nothing for h in horizons] for name in models
        }
        found = Runs(runs, tuple(p.recording for p in prepared))
    else:
        stops = _until(parts, SHORT), _until(parts, FULL)
        found = whole_runs(whole, models, horizons, parts.headline, stops)
    found.models.setdefault("explained", found.models["recalibrated"])
    return found


def _in_time(parts: Ingredients, horizons: Sequence[float]) -> Iterator[float]:
    """Yield the horizons to be run: the headline and the whole recordings, others as time is left.

    Longest first, as many short segments tell least of what the model is for.
    """
    budget = parts.case.budget
    pace = Repeated(budget.keeping(LEFT * budget.seconds))
    first = dict.fromkeys((parts.headline, horizons[-1]))
    for horizon in [*first, *(h for h in reversed(horizons) if h not in first)]:
        if pace.too_long() and horizon not in first:
            return
        yield horizon


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
    attempt = case.failures.attempt
    inner, outer = attempt("comparing effects", lambda: _sensitivities(parts), (None, None))

    def confused() -> list[list[Any]]:
        return confusable_rows(parts, outer) if outer else []

    def detectable() -> dict[str, Any]:
        return detectable_rows(parts, inner) if inner else {}

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
        read = held_runs.recordings
        fit["held_out"] = {**scores, "files": [r.name for r in read]}
        fit["held_out"]["sha256"] = {r.name: r.sha256 for r in read if r.sha256}
    checks = [row for r in train.recordings for row in _checks(model, r)]
    checks += [_smoothed(model, name) for name in case.quiet]
    checks += [_signed(model, sensor) for sensor in case.rectified]
    checks += bound_rows(model, judged.recalibrated, judged.explained)
    checks += [*_thinned(parts, judged, train), *map(dict, remarks(model))]
    return {
        "schema": SCHEMA,
        "verdict": judged.verdict.value,
        "findings": judged.findings,
        "calibration": calibration_rows(judged.explained, model),
        "fit": fit,
        "confusable": [*judged.confusable, *attempt("comparing effects", confused, [])],
        "smallest_detectable": attempt("telling the smallest effects", detectable, {}),
        "next_experiment": attempt(
            "choosing the next experiment",
            lambda: next_experiment(parts, judged.rivals, judged.leader or parts.chosen),
            None,
        ),
        "data_checks": checks,
        "provenance": {
            "version": own_version(),
            **environment(),
            "seed": parts.seed,
            "command": parts.command,
            "seconds": round(case.budget.elapsed, 1),
            "stopped_by": _stopped(parts).value,
            "data_sha256": {r.name: r.sha256 for r in train.recordings},
            "model_sha256": dict(case.simulator.files),
            **_open(parts, judged),
        },
    }


def _open(parts: Ingredients, judged: Judged) -> dict[str, Any]:
    """What is left open, where something is."""
    said = _left_open(parts, judged)
    return {"open": {**judged.open.as_json(), "message": said}} if said else {}


def _sensitivities(parts: Ingredients) -> tuple[Sensitivities | None, Sensitivities | None]:
    """Effects of all candidates beside the chosen set and beside re-calibration, if time is left.

    The first tells how long the second takes.
    """
    budget = parts.case.budget
    if budget.remaining < LEFT * budget.seconds or not parts.arena.super_model.candidates:
        return None, None
    before = budget.elapsed
    inner = sensitivities(parts.arena, parts.chosen.fit, exclude=parts.chosen.members)
    if parts.chosen is parts.null:
        return inner, inner
    took = budget.elapsed - before
    if budget.remaining - took < LEFT * budget.seconds:
        return inner, None
    return inner, sensitivities(parts.arena, parts.null.fit)


def _smoothed(model: Model, name: str) -> dict[str, str]:
    column = model.column(name)
    text = (
        f"the noise of {column} did not act on the system: without it the readings are likelier; "
        "it was smoothed out before use"
    )
    return {"file": "", "channel": column, "check": "input_noise", "message": text}


def _signed(model: Model, sensor: Rectified) -> dict[str, str]:
    column = model.column(sensor.output)
    text = (
        f"{column} holds absolute values; they were given the signs with which the motion is "
        "smoothest and nearest to the model's, and errors of all models are told with these"
    )
    return {"file": "", "channel": column, "check": "rectified", "message": text}


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


def _checks(model: Model, recording: Recording) -> list[dict[str, str]]:
    """What a measurement may have done to the data, and the sensors that a recording lacks."""
    inputs = [model.column(c) for c in model.inputs]
    outputs = [model.column(c) for c in model.outputs]
    absent = [c for c in outputs if is_absent(recording, c)]
    present = [c for c in (*inputs, *outputs) if c not in absent]
    try:
        checked = check_recording(recording, present, inputs)
    except OutOfTime:
        text = f"no time was left to check the readings of {recording.name}"
        checked = [DataCheck(recording.name, "", "search", text)]
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
        for c in checked
    ]
