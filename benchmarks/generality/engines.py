"""The engines that are compared: what answers a case in the form of a ``diagnosis.json``."""

from __future__ import annotations

import json
import time
import traceback
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.evidence import document, weighed
from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.posterior import Posterior
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare
from jaxsr.diagnosis.shooting.integration import choose_stepping
from jaxsr.diagnosis.shooting.scoring import free_run, horizons
from jaxsr.models import Model, Simulator

BUDGET = 120.0
"""Seconds of a diagnosis: twice what the command takes by default, for a machine that is shared."""
KEPT = ("verdict", "findings", "fit", "provenance")


def by_diagnosis(folder: Path, budget: float) -> dict[str, Any]:
    """Return what the commands' diagnosis says of a case."""
    arguments = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    found = diagnose(
        Simulator.from_file(folder / arguments["model"]),
        [folder / name for name in arguments["data"]],
        held_out=[folder / name for name in arguments["held_out"]],
        seed=arguments["seed"],
        budget=budget,
    )
    return {k: v for k, v in found.document.items() if k in KEPT}


def by_evidence(folder: Path, budget: float) -> dict[str, Any]:
    """Return what the likelihood with latent forces says of a case; it has no budget yet.

    Raises
    ------
    ArithmeticError
        Not even re-calibration can be followed.
    """
    arguments = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    model = folder / arguments["model"]
    found = weighed(model, [folder / name for name in arguments["data"]])
    if found is None:
        raise ArithmeticError("nothing can be followed")
    answer = document(found)
    answer["latent"] = found.leader.share
    held = [folder / name for name in arguments["held_out"]]
    try:
        answer["fit"] = held_out(Simulator.from_file(model).model, found, held)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        answer["fit"] = {"not_run": f"{type(error).__name__}: {error}"}
    return answer


def held_out(given: Model, found: Posterior, files: list[Path]) -> dict[str, Any]:
    """Return free-run errors of re-calibration and of the leading set on recordings held out."""
    null = next(h for h in found.hypotheses if not h.members)
    prepared = prepare(given, files)
    span = horizons(prepared)[-1]
    rows = {}
    for key, hypothesis in (("recalibrated", null), ("explained", found.leader)):
        model, theta = alone(given, found, hypothesis)
        again = prepare(model, files)
        simulator = Simulator(model)
        stepping = choose_stepping(simulator, again, theta)
        with np.errstate(all="ignore"):
            rows[key] = [free_run(simulator, stepping, again, theta, span).nrmse]
    return {"horizons_s": [span], "headline_s": span, "held_out": rows}


def alone(given: Model, found: Posterior, hypothesis: Hypothesis) -> tuple[Model, np.ndarray]:
    """Return the model of a hypothesis without the other candidates, and its parameters.

    A push is no part of the model: it does not act on what is held out.
    """
    members = [i for i in hypothesis.members if not found.candidates[i].passing]
    own = SuperModel.build(given, [found.candidates[i] for i in members])
    full = SuperModel.build(given, found.candidates)
    whole = dict(zip(full.model.parameters, hypothesis.theta, strict=True))
    values = {n: p.value for n, p in own.model.parameters.items()}
    values |= {n: whole[n] for n in values if n in given.parameters}
    for mine, member in zip(own.names, members, strict=True):
        theirs = full.names[member]
        values |= {mine[k]: float(whole[theirs[k]]) for k in mine if theirs.get(k) in whole}
    theta = np.array([values[n] for n in own.model.parameters])
    # states of a mechanism start by themselves where candidates are compared
    starts = [state.initial for i in members for state in found.candidates[i].states]
    further = own.model.states[len(given.states) :]
    initial = {**own.model.initial, **dict(zip(further, starts, strict=True))}
    return replace(own.model, initial=initial), own.switched(range(len(members)), theta)


ENGINES: dict[str, Callable[[Path, float], dict[str, Any]]] = {
    "diagnosis": by_diagnosis,
    "evidence": by_evidence,
}


def answered(engine: str, folder: Path, name: str, budget: float) -> dict[str, Any]:
    """Return an engine's row of a case; what breaks is its answer."""
    wall, processor = time.perf_counter(), time.process_time()
    answer, broke = None, ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            answer = ENGINES[engine](folder / "cases" / name, budget)
    except Exception as error:  # a case that breaks is a case that is wrong
        at = traceback.extract_tb(error.__traceback__)[-1]
        broke = f"{type(error).__name__}: {error} ({Path(at.filename).name}:{at.lineno})"[:300]
    return {
        "case": name,
        "engine": engine,
        "answer": answer,
        "broke": broke,
        "seconds": round(time.perf_counter() - wall, 1),
        "cpu_seconds": round(time.process_time() - processor, 1),
    }
