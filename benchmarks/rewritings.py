"""The same findings however a model is written: EMPS, Silverbox and a joint of the UR10e.

    python -m benchmarks.rewritings [--only emps,silverbox,ur10e] [--ways 0,1,..] [--budget S]
        [--again]

Each of the three bundled models is written in ten ways that mean the same, its start values off
by up to 50 %, its recordings' times and values rounded to nine digits, with seeds 0 to 2
(`benchmarks.model_writings`). Every diagnosis is a process of its own, as a user starts it, with
a budget of processor time (`jaxsr._clock`), so that what runs beside changes no answer. Counted
per set: runs that end with status 0 and without a traceback or warning, and those of them whose
findings (mechanism and place, values of the file's own parameters aside) are those of the bundled
file; of these there must be nine of ten. Recordings come from the folder in JAXSR_DATA_DIR (by
default ../shared/recordings beside the repository, where it exists), else from their origin.
Results, as they come: ``results/rewritings.json``, with the engine of each set; runs of the same
engine and budget are not made again unless --again is given. Ends with status 1 if a run failed or
a set keeps its findings too seldom.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.model_writings import DATASETS, WAYS, rewriting
from benchmarks.provenance import RESULTS, engine, write
from jaxsr.datasets import fetch

ROOT = Path(__file__).resolve().parents[1]
BUDGET = 60.0  # s of processor time
PATIENCE = 60.0  # budgets on the wall until a run is ended
SAME = 0.9
"""Share of the ways that must give the findings of the bundled file."""
BUNDLED = "bundled"
ROLES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "emps": (("emps_train.csv",), ("emps_pulses.csv",)),
    "silverbox": (
        tuple(f"silverbox_multisine_{k:02d}.csv" for k in (1, 2, 3)),
        ("silverbox_arrow.csv",),
    ),
    "ur10e": (("ur10e_ident.csv",), ("ur10e_unloaded.csv",)),
}
VELOCITY = {"emps": "v", "silverbox": "v", "ur10e": "v1"}
ALIKE = {"gravity": "constant_force", "end_stop": "piecewise_stiffness"}
"""Mechanisms that the data of these recordings cannot tell apart."""
EVEN = 0.01
"""Difference of probability below which a finding and its alternative are told as equal."""


@dataclass(frozen=True)
class Task:
    """One diagnosis: model file, recordings, and the name of the velocity in it."""

    model: Path
    data: tuple[Path, ...]
    held_out: tuple[Path, ...]
    velocity: str
    seed: int


@dataclass(frozen=True)
class Answer:
    """What a diagnosis came to.

    Attributes
    ----------
    status : int
        Exit status; negative where it had to be ended.
    verdict : str
    findings : tuple of str
        ``mechanism@place``, values of the file's own parameters aside; sorted.
    trouble : str
        Last line of a traceback or warning; empty where there is none.
    seconds : float
        Processor time.
    """

    status: int
    verdict: str
    findings: tuple[str, ...]
    trouble: str
    seconds: float

    @property
    def sound(self) -> bool:
        """Whether the run ended as it should."""
        return self.status == 0 and not self.trouble


def places(findings: Sequence[Mapping[str, Any]], velocity: str) -> tuple[str, ...]:
    """Return mechanism and place of findings, in names that all writings share.

    What a finding calls as probable as itself is named beside it: on a spring whose stiffness is
    free, a constant force and a bias of its sensor are one model, and the start values say which
    is told.
    """
    found = set()
    for row in findings:
        if row["family"] != "parameter":
            equal = [r for r in row["alternatives"] if row["probability"] - r["probability"] < EVEN]
            found.add(" or ".join(sorted({_place(r, velocity) for r in (row, *equal)})))
    return tuple(sorted(found))


def _place(row: Mapping[str, Any], velocity: str) -> str:
    site = str(row["site"])
    place = site if site.startswith("equation:") else site.partition(":")[0]
    if site == f"equation:{velocity}":
        place = "equation:velocity"
    return f"{ALIKE.get(row['mechanism'], row['mechanism'])}@{place}"


def diagnosed(task: Task, budget: float) -> Answer:
    """Run the command on one model file."""
    out = task.model.parent / f"out_{task.model.stem}"
    words = [sys.executable, "-m", "jaxsr", "diagnose", str(task.model), *map(str, task.data)]
    words += ["--held-out", *map(str, task.held_out), "--out", str(out)]
    words += ["--budget", f"{budget:g}", "--seed", str(task.seed)]
    told = task.model.parent / f"{task.model.stem}.err"
    own = {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "JAXSR_CLOCK": "processor"}
    with told.open("w") as stream:
        process = subprocess.Popen(
            ["timeout", "-k", "10", f"{PATIENCE * budget:.0f}", *words],
            stdout=subprocess.DEVNULL,
            stderr=stream,
            cwd=task.model.parent,
            env={**os.environ, **own},
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    text = told.read_text(encoding="utf-8", errors="replace")
    trouble = next((word for word in ("Traceback", "Warning") if word in text), "")
    if trouble or process.returncode:
        trouble = (text.strip().splitlines() or ["no end"])[-1][:200]
    document: dict[str, Any] = {"verdict": "", "findings": []}
    if (out / "diagnosis.json").is_file():
        document = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    seconds = round(usage.ru_utime + usage.ru_stime, 1)
    found = places(document["findings"], task.velocity)
    return Answer(process.returncode, document["verdict"], found, trouble, seconds)


def task_of(dataset: str, way: str, folder: Path) -> Task:
    """Write the files of one way, "0" to "9" or "bundled", and return the task."""
    data, held = ([folder / name for name in names] for names in ROLES[dataset])
    if way == BUNDLED:
        model = folder / f"{dataset}.toml"
        return Task(model, tuple(data), tuple(held), VELOCITY[dataset], 0)
    writing = rewriting(dataset, int(way))
    own = writing.write(folder / way, [*data, *held])
    split = tuple(own[: len(data)]), tuple(own[len(data) :])
    return Task(folder / way / "model.toml", *split, writing.velocity, writing.seed)


def summary(runs: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Return how many of the ways of a set end soundly, and how many keep the findings.

    `alike` counts the most that have the same findings, those of the bundled file or others.
    """
    ways = {way: row for way, row in runs.items() if way != BUNDLED}
    sound = [row for row in ways.values() if row["status"] == 0 and not row["trouble"]]
    bundled = runs.get(BUNDLED)
    same = [r for r in sound if bundled and set(r["findings"]) == set(bundled["findings"])]
    return {
        "ways": len(ways),
        "sound": len(sound),
        "same_findings": len(same),
        "alike": max(Counter(frozenset(r["findings"]) for r in sound).values(), default=0),
        "same_verdict": sum(bool(bundled) and r["verdict"] == bundled["verdict"] for r in sound),
    }


def kept() -> tuple[dict[str, dict[str, Any]], dict[str, dict[str, Any]]]:
    """Return the runs that the result holds, and their summaries, by set."""
    path = RESULTS / "rewritings.json"
    document = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    return document.get("runs", {}), document.get("summary", {})


def main() -> int:
    """Run, print, write; 1 where findings depend on the writing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=",".join(DATASETS), help="sets, with commas between")
    parser.add_argument("--ways", default=",".join(map(str, range(WAYS))), help="0 to 9")
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds of processor time")
    parser.add_argument("--again", action="store_true", help="also what the result holds")
    given = parser.parse_args()
    local = ROOT.parent / "shared" / "recordings"
    if local.is_dir():
        os.environ.setdefault("JAXSR_DATA_DIR", str(local))
    about = {"engine": engine(), "budget_s": given.budget}
    runs, rates = kept()
    asked = given.only.split(",")
    for dataset in asked:
        if given.again or not about.items() <= rates.get(dataset, {}).items():
            runs[dataset] = {}
        own = runs.setdefault(dataset, {})
        with tempfile.TemporaryDirectory() as folder:
            fetch(dataset, Path(folder))
            for way in (BUNDLED, *given.ways.split(",")):
                if way in own:
                    continue
                answer = diagnosed(task_of(dataset, way, Path(folder)), given.budget)
                own[way] = {**vars(answer), "findings": list(answer.findings)}
                words = ", ".join(answer.findings) or "no finding"
                print(
                    f"{dataset} {way}: {answer.verdict or answer.status}, {words} "
                    f"({answer.seconds:.0f} s) {answer.trouble}".rstrip(),
                    flush=True,
                )
                rates[dataset] = {**about, **summary(own)}
                body = {"summary": rates, "runs": runs}
                write("rewritings", "one model, written in ten ways", [0, 1, 2], body)
    last = {name: summary(runs[name]) for name in asked}
    for name, rate in last.items():
        print(name, rate)
    return int(
        any(r["sound"] < r["ways"] or r["same_findings"] < SAME * r["ways"] for r in last.values())
    )


if __name__ == "__main__":
    sys.exit(main())
