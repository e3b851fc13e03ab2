"""Diagnoses of the test rigs and robots among the real recordings, beside the figures to beat.

Each diagnosis is the command that a user types, in a process of its own: one that ends in an
error, or not at all, is a row like any other. A figure that is missed is reported as missed.
A budget is wall-clock time, so that the load of the machine is kept beside the seconds, or, with
``JAXSR_CLOCK=processor``, the processor time of the command.
"""

from __future__ import annotations

import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import jaxsr
from benchmarks import bam_laws, roll_laws
from benchmarks.recording_case import ROOT, SEED, Case, errors_at, named, values_of
from jaxsr._clock import processor
from jaxsr.models import Model

BUDGET = 60.0
PATIENCE = 3.0
"""Budgets after which a diagnosis that has not ended is ended."""
MILLI = 1e3

CED_TRAINING = 400
"""Samples of a record to learn from; the last hundred are held out, as the first pass did."""
CED_TO_BEAT = (0.46, 0.52, 0.14)  # ticks/s
KVLCC2_TO_BEAT = 1.4  # mrad
GO2_TO_BEAT = (8.0, 5.0, 15.0)  # mrad, hip, thigh, calf
TX40_COULOMB = (6.97, 8.12, 6.31, 2.48, 3.03)  # N m, published, joints 1 to 5
TX40_TO_BEAT = (0.06, 0.08, 0.10, 0.10, 0.12, 0.12)  # relative torque error, joints 1 to 6


@dataclass(frozen=True)
class Answer:
    """What the command left: its document and both models; why not, where it left none."""

    given: Model
    model: Model | None = None
    document: dict[str, Any] | None = None
    failure: str = ""

    @property
    def verdict(self) -> str:
        """The verdict, or how the command ended."""
        return self.document["verdict"] if self.document else self.failure

    @property
    def findings(self) -> list[dict[str, Any]]:
        """The findings, none where there is no answer."""
        return self.document["findings"] if self.document else []


def ask(
    case: Case, name: str, model: Path, train: Sequence[Path], held_out: Sequence[Path]
) -> Answer:
    """Run the command, keep its row and print the verdict."""
    out = model.parent / f"answer_{name}"
    command = [sys.executable, "-m", "jaxsr", "diagnose", str(model), *map(str, train)]
    command += ["--held-out", *map(str, held_out)] if held_out else []
    command += ["--out", str(out), "--seed", str(SEED), "--budget", f"{BUDGET:g}"]
    given = jaxsr.Simulator.from_file(model).model
    load = os.getloadavg()[0]
    failure, seconds = _run(command)
    if failure:
        row = {"verdict": None, "failure": failure, "seconds": round(seconds, 1)}
        case.diagnoses[name] = row | {"load_average": load}
        case.check(f"{name}: an answer", failure, "an answer", False)
        return Answer(given, failure=failure)
    document = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    case.keep(name, document, seconds)
    case.diagnoses[name]["load_average"] = load
    case.check(f"{name}: seconds", f"{seconds:.0f}", "<= 66", seconds <= 1.1 * BUDGET)
    explained = jaxsr.Simulator.from_file(out / "explained.toml").model
    return Answer(given, explained, document)


def _run(command: Sequence[str]) -> tuple[str, float]:
    """Run a command; return why it gave no answer, empty where it did, and its seconds."""
    patience = PATIENCE * BUDGET
    begin = time.perf_counter(), _processor_seconds()
    late = f"no end after {patience:.0f} s"
    failure = ""
    try:
        run = subprocess.run(
            command,
            capture_output=True,
            text=True,
            cwd=ROOT,
            timeout=None if processor() else patience,
            preexec_fn=(lambda: _limited(patience)) if processor() else None,
        )
        if run.returncode == -signal.SIGXCPU:
            failure = late
        elif run.returncode:
            last = (run.stderr.strip() or "no word").splitlines()[-1]
            failure = f"exit {run.returncode}: {last[:160]}"
    except subprocess.TimeoutExpired:
        failure = late
    if processor():
        return failure, _processor_seconds() - begin[1]
    return failure, time.perf_counter() - begin[0]


def _limited(seconds: float) -> None:
    """Let this process take no more processor time than that."""
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))


def _processor_seconds() -> float:
    """Return the processor time of the commands that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_errors(
    model: Model, file: Path, scale: float = 1.0, horizon: float | None = None
) -> list[float]:
    """Return the free-run RMSE of every output over a recording, whole unless said otherwise."""
    return [scale * error for error in errors_at(model, values_of(model), file, horizon)]


def compared(
    case: Case, what: str, answer: Answer, file: Path, to_beat: float | Sequence[float], unit: str
) -> None:
    """Check the explained model's free run against figures, with the given one's beside."""
    scale = MILLI if unit == "mrad" else 1.0
    before = run_errors(answer.given, file, scale)
    limits = list(np.atleast_1d(to_beat))
    target = f"<= {', '.join(f'{limit:.3g}' for limit in limits)} {unit}"
    after = run_errors(answer.model, file, scale) if answer.model else []
    case.figures[what] = {"given": before, "explained": after or None, "unit": unit}
    text = f"{', '.join(f'{e:.3g}' for e in after) or 'none'} (given {before[0]:.3g})"
    met = bool(after) and all(a <= b for a, b in zip(after, limits, strict=True))
    case.check(what, text, target, met)


def bam(folder: Path, quick: bool) -> Case:
    """Run the servo with a pendulum, without dry friction and with the owners' Coulomb."""
    case = Case()
    train = bam_laws.files(folder, bam_laws.GAINS)
    held = bam_laws.files(folder, (bam_laws.HELD_OUT,))
    bare = ask(case, "bam_frictionless", folder / "bam_xl330_frictionless.toml", train, held)
    case.find(bare, "coulomb_friction", "equation:w")
    found = ask(case, "bam", folder / "bam_xl330.toml", train, held)
    case.find(found, "load_dependent_friction", "equation:w")
    runs = bam_laws.Runs.read(train), bam_laws.Runs.read(held)
    by_law = {name: bam_laws.fit(runs[0], extra) for name, extra in bam_laws.LAWS.items()}
    laws = {n: MILLI * _mean(bam_laws.errors(runs[1], v)) for n, v in by_law.items()}
    case.figures["owners_laws"] = by_law
    to_beat = min(laws.values())
    for name, answer in (("bam_frictionless", bare), ("bam", found)):
        models = {"given": answer.given, "explained": answer.model}
        errors = {
            key: _mean([run_errors(model, file, MILLI)[0] for file in held])
            for key, model in models.items()
            if model
        }
        case.figures[f"{name}_held_out_rmse_mrad"] = errors | laws
        after = errors.get("explained", math.inf)
        reached = f"{after:.3g} mrad" if answer.model else "none"
        text = f"{reached} (given {errors['given']:.3g})"
        case.check(f"{name}: held-out kp 200", text, f"<= {to_beat:.3g} mrad", after <= to_beat)
    return case


def ced(folder: Path, quick: bool) -> Case:
    """Run the coupled drives, whose counter reads the speed without its sign."""
    case = Case()
    train, held = [], []
    for k in (1, 2, 3):
        table = pd.read_csv(folder / f"ced_prbs{k}.csv")
        for files, part in ((train, table[:CED_TRAINING]), (held, table[CED_TRAINING:])):
            path = folder / f"ced_prbs{k}_{'train' if files is train else 'held_out'}.csv"
            part.to_csv(path, index=False)
            files.append(path)
    found = ask(case, "ced", folder / "ced.toml", train, held)
    case.check("verdict", found.verdict, "measurement", found.verdict == "measurement")
    case.find(found, "rectified", "output:speed")
    for k, file in enumerate(held):
        compared(case, f"PRBS {k + 1}, held out", found, file, CED_TO_BEAT[k], "ticks/s")
    return case


def kvlcc2(folder: Path, quick: bool) -> Case:
    """Run the roll decays: two terms at zero speed, then a value that changed at speed."""
    case = Case()
    files = {run: folder / f"kvlcc2_{run}.csv" for run in (21337, 21338, 21340)}
    found = ask(case, "kvlcc2", folder / "kvlcc2.toml", [files[21337]], [files[21338]])
    for mechanism in ("quadratic_drag", "cubic_stiffness"):
        case.find(found, mechanism, "equation:w")
    compared(case, "run 21338, held out", found, files[21338], KVLCC2_TO_BEAT, "mrad")
    # The figure to beat is that of a fit to the held-out run: what the law can do stands beside.
    case.figures["least_squares"] = by_law = roll_laws.compared(folder)
    text = ", ".join(f"{what} {e:.2f}" for what, e in by_law["mrad"].items())
    print(f"    least squares of the same law, mrad: {text}")
    if found.model:
        table = pd.read_csv(files[21338])
        part = folder / "kvlcc2_21338_as_large.csv"
        table[: by_law["samples as large"]].to_csv(part, index=False)
        errors = run_errors(found.model, part, MILLI)
        case.figures["run 21338, swings as large as those learned from, mrad"] = errors
        print(f"    swings as large as those learned from: {errors[0]:.2f} mrad")
    if found.model:
        explained = folder / "at_rest.toml"
        left = folder / "answer_kvlcc2" / "explained.toml"
        explained.write_text(left.read_text(encoding="utf-8"), encoding="utf-8")
        speed = ask(case, "kvlcc2_at_speed", explained, [files[21340]], [])
        text = f"{speed.verdict}, {named(speed)}"
        case.check("at 15.5 kn", text, "parameter, b1", speed.verdict == "parameter")
    return case


def pendula(folder: Path, quick: bool) -> Case:
    """Run the single pendulum; the double and the triple one are reported without a target."""
    case = Case()
    files = [folder / "single_id.csv", folder / "single_vad.csv"]
    found = ask(case, "single", folder / "multiarm_pendulum.toml", files[:1], files[1:])
    for mechanism in ("coulomb_friction", "quadratic_drag"):
        case.find(found, mechanism, "equation:w")
    owners = run_errors(found.given, files[1], MILLI)[0]
    compared(case, "validation swing", found, files[1], owners, "mrad")
    for arms in ("double", "triple"):
        files = [folder / f"{arms}_id.csv", folder / f"{arms}_vad.csv"]
        answer = ask(case, arms, folder / f"{arms}_pendulum.toml", files[:1], files[1:])
        models = {"given": answer.given, "explained": answer.model}
        case.figures[f"{arms}_validation_rmse_mrad_at_1_s"] = {
            name: run_errors(model, files[1], MILLI, 1.0) for name, model in models.items() if model
        }
    return case


def go2(folder: Path, quick: bool) -> Case:
    """Run the front left leg of the quadruped, targets and angles only."""
    case = Case()
    files = [folder / "go2_train.csv", folder / "go2_held_out.csv"]
    found = ask(case, "go2", folder / "go2.toml", files[:1], files[1:])
    text = f"{found.verdict}, {named(found)}"
    case.check("verdict", text, "parameter, damping", found.verdict == "parameter")
    compared(case, "hip, thigh, calf, held out", found, files[1], GO2_TO_BEAT, "mrad")
    return case


def tx40(folder: Path, quick: bool) -> Case:
    """Run the six-axis arm with its URDF."""
    case = Case()
    files = [folder / "tx40_train.csv", folder / "tx40_held_out.csv"]
    found = ask(case, "tx40", folder / "tx40.toml", files[:1], files[1:])
    own = {(r["site"], r["mechanism"]): r["parameters"] for r in found.findings}
    for joint, published in enumerate(TX40_COULOMB, start=1):
        values = own.get((f"equation:v{joint}", "coulomb_friction"), {})
        value = next((p["value"] for n, p in values.items() if n.startswith("Fc")), math.nan)
        text = "not found" if math.isnan(value) else f"{value:.3g} N m"
        met = abs(value / published - 1.0) <= 0.1
        case.check(f"Coulomb, joint {joint}", text, f"{published} N m within 10 %", met)
    wrist = {site for site, mechanism in own if mechanism == "coupled_friction"}
    case.check("wrist", ", ".join(wrist) or "none", "coupled_friction", bool(wrist))
    # Without an edit there are no figures of forces: null in the document.
    force = (found.document["fit"]["force"] if found.document else None) or {}
    for joint, limit in enumerate(TX40_TO_BEAT, start=1):
        row = force.get(f"equation:v{joint}", {}).get("held_out") or {}
        error = row.get("explained")
        text = "none" if error is None else f"{error:.1%}"
        met = error is not None and error <= limit
        case.check(f"torque error, joint {joint}", text, f"<= {limit:.0%}", met)
    return case


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


CASES: dict[str, tuple[str, Callable[[Path, bool], Case]]] = {
    "bam": ("bam_xl330", bam),
    "ced": ("ced", ced),
    "go2": ("go2", go2),
    "kvlcc2": ("kvlcc2", kvlcc2),
    "pendula": ("multiarm_pendulum", pendula),
    "tx40": ("tx40", tx40),
}
