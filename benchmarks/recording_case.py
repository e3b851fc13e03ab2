"""One set of real recordings judged: diagnoses, promises kept and missed, figures."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import jax
import numpy as np

import jaxsr
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.result import Diagnosis
from jaxsr.diagnosis.setup import prepare
from jaxsr.diagnosis.shooting.arena import build_arena
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.integration import choose_stepping
from jaxsr.diagnosis.shooting.scoring import free_run
from jaxsr.models import Model
from jaxsr.models.segments import Prepared

ROOT = Path(__file__).resolve().parents[1]
SEED = 0


class Found(Protocol):
    """What the checks read of a diagnosis."""

    @property
    def verdict(self) -> str: ...

    @property
    def findings(self) -> list[dict[str, Any]]: ...


@dataclass(frozen=True)
class Check:
    """One promise: what, the value reached, the target, and whether it is met."""

    what: str
    value: str
    target: str
    met: bool


@dataclass
class Case:
    """Results of one data set: a row per diagnosis, the checks, further figures."""

    diagnoses: dict[str, dict[str, Any]] = field(default_factory=dict)
    checks: list[Check] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)

    def check(self, what: str, value: Any, target: str, met: bool) -> None:
        """Keep a check and print it."""
        self.checks.append(Check(what, str(value), target, bool(met)))
        print(f"  {'met    ' if met else 'NOT MET'} {what}: {value} (target {target})", flush=True)

    def keep(self, name: str, document: dict[str, Any], seconds: float) -> None:
        """Keep the row of a diagnosis and print the verdict."""
        kept = ("site", "mechanism", "probability", "alternatives", "term", "parameters", "share")
        findings = document["findings"]
        self.diagnoses[name] = {
            "verdict": document["verdict"],
            "findings": [{key: row.get(key) for key in kept} for row in findings],
            **{key: document[key] for key in ("calibration", "fit", "smallest_detectable")},
            "stopped_by": document["provenance"]["stopped_by"],
            "seconds": round(seconds, 1),
        }
        words = named_rows(findings) or "no finding"
        print(f"{name}: {document['verdict']}, {words} ({seconds:.0f} s)", flush=True)

    def find(self, found: Found, mechanism: str, site: str) -> None:
        """Check that a mechanism is among the findings."""
        met = (mechanism, site) in effects(found)
        self.check("finding", named(found), f"{mechanism}@{site}", met)


def diagnose(
    case: Case, name: str, model: Path, train: list[Path], held_out: list[Path]
) -> Diagnosis:
    """Diagnose, keep the row and print the verdict."""
    begin = time.perf_counter()
    simulator = jaxsr.Simulator.from_file(model)
    found = jaxsr.diagnose(simulator, train, held_out=held_out, seed=SEED)
    seconds = time.perf_counter() - begin
    jax.clear_caches()  # each diagnosis compiles its own simulators
    case.keep(name, found.document, seconds)
    return found


def named(found: Found) -> str:
    """Return the findings with their parameters in a line."""
    return named_rows(found.findings)


def named_rows(findings: Sequence[dict[str, Any]]) -> str:
    """Return rows of findings with their parameters in a line."""
    rows = []
    for row in findings:
        values = ", ".join(f"{k} {p['value']:.4g}" for k, p in row["parameters"].items())
        rows.append(f"{row['mechanism']}@{row['site']} ({values})")
    return "; ".join(rows)


def effects(found: Found) -> set[tuple[str, str]]:
    """Return mechanism and site of every finding."""
    return {(row["mechanism"], row["site"]) for row in found.findings}


def alternatives(found: Found) -> dict[str, float]:
    """Return the probability of every alternative, by mechanism."""
    best: dict[str, float] = {}
    for row in found.findings:
        for other in row["alternatives"]:
            name = other["mechanism"]
            best[name] = max(best.get(name, 0.0), other["probability"])
    return best


def values_of(model: Model) -> np.ndarray:
    """Return the parameter values of a model in its order."""
    return np.array([p.value for p in model.parameters.values()])


def recalibrated(model: Model, train: tuple[Prepared, ...], seconds: float) -> np.ndarray:
    """Re-estimate the given structure over segments of `seconds`, as the diagnosis does."""
    simulator = jaxsr.Simulator(model)
    stepping = choose_stepping(simulator, train, values_of(model))
    deviation = np.nanstd(np.concatenate([p.outputs for p in train]), axis=0)
    alone = SuperModel.build(model, [])
    arena = build_arena(alone, train, stepping, seconds, 0.01 * deviation, simulator)
    return enter(arena, (), values_of(model)).fit.theta


def rmse(
    model: Model,
    theta: np.ndarray,
    train: tuple[Prepared, ...],
    held: tuple[Prepared, ...],
    horizons: Iterable[float | None],
) -> list[float]:
    """Return the free-run RMSE of the first output at each horizon; None is the whole length."""
    simulator = jaxsr.Simulator(model)
    train, held = (tuple(prepare(model, [p.recording for p in items])) for items in (train, held))
    stepping = choose_stepping(simulator, train, theta)
    runs = (free_run(simulator, stepping, held, theta, h) for h in horizons)
    return [float(run.rmse[0, 0]) for run in runs]


def errors_at(model: Model, theta: np.ndarray, file: Path, horizon: float | None) -> list[float]:
    """Return the free-run RMSE of every output over one recording; None is the whole length."""
    items = tuple(prepare(model, [file]))
    simulator = jaxsr.Simulator(model)
    run = free_run(simulator, choose_stepping(simulator, items, theta), items, theta, horizon)
    return [float(error) for error in run.rmse[0]]
