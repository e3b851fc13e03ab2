"""Laws outside the family: told without a name where they act, and nothing told where none does.

    python -m benchmarks.nameless_laws [--quick] [--jobs N] [--seed S] [--machines NAME ...]

Every machine (`benchmarks.nameless_machines`) with the law that its model lacks, by the command as
it is and, as an ablation, with one law of each error; and with nothing missing. An answer is right
where the verdict is, the one finding has no name and its place is that of the law. What a recording
that was held out keeps of the error that re-calibration leaves is `left`. Budgets are of processor
time. Writes ``results/nameless_laws.json``; --quick (one machine, no file) fails where its answer
is wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import jaxsr._clock as clock
import jaxsr.diagnosis.laws.selection as selection
from benchmarks.nameless_machines import HELD_OUT, MACHINES
from benchmarks.planted import answers, asked, counted
from benchmarks.provenance import write
from jaxsr.diagnosis import diagnose
from jaxsr.models import Simulator

BUDGET, SEED = 120.0, 0
QUICK = ("van der Pol",)
WRITTEN, FEW, NOTHING = "laws written", "one of each error", "nothing missing"


@dataclass(frozen=True)
class Task:
    """One diagnosis."""

    machine: str
    way: str
    seed: int


def diagnosed(task: Task) -> dict[str, Any]:
    """Return the row of one diagnosis."""
    if task.way == FEW:
        selection.unlike = lambda *_: []
    machine, lacking = MACHINES[task.machine], task.way != NOTHING
    # One draw a machine, the same for all ways.
    rng = np.random.default_rng([task.seed, list(MACHINES).index(task.machine), lacking])
    recordings = [*machine.recordings(rng, lacking), *machine.recordings(rng, lacking)]
    began = clock.now()
    model = Simulator(machine.model)
    found = diagnose(model, recordings[:2], held_out=recordings[2:3], budget=BUDGET)
    told = [(f["mechanism"], f["site"]) for f in found.findings]
    wanted = [(machine.mechanism, f"equation:{machine.state}")] if lacking else []
    verdict = "structure" if lacking else "nothing"
    fit = found.document["fit"]["held_out"] or {}
    after, before = ((fit.get(which) or [None])[-1] for which in ("explained", "recalibrated"))
    return {
        **asdict(task),
        "verdict": found.verdict,
        "findings": told,
        "term": found.findings[0]["term"] if told else None,
        "right": found.verdict == verdict and told == wanted,
        "left": None if after is None or before is None else after / before,  # a run may end
        "seconds": round(clock.now() - began, 1),
    }


def told(row: dict[str, Any]) -> str:
    """Return a row as a line."""
    what = ", ".join(f"{mechanism} at {site}" for mechanism, site in row["findings"]) or "-"
    mark = "right" if row["right"] else "WRONG"
    name = f"{row['machine']}, {row['way']}"
    left = "-" if row["left"] is None else f"{row['left']:.3f}"
    return f"{name:48} {mark} {row['verdict']}: {what} (left {left}, {row['seconds']} s)"


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how many answers are right and what they leave, on machines seen and held out."""
    found = counted(rows, HELD_OUT)
    for way, parts in found.items():
        for part, counts in parts.items():
            held = part == "held out"
            own = [r for r in rows if r["way"] == way and (r["machine"] in HELD_OUT) is held]
            ends = [np.inf if r["left"] is None else r["left"] for r in own]
            middle = float(np.median(ends)) if ends else np.inf
            counts["left"] = middle if np.isfinite(middle) else None
    return found


def main() -> int:
    """Run, print, write; 1 where the quick machine is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    given = asked(parser, MACHINES, SEED)
    os.environ["JAXSR_CLOCK"] = "processor"
    machines = QUICK if given.quick else given.machines or tuple(MACHINES)
    ways = (WRITTEN,) if given.quick else (WRITTEN, FEW, NOTHING)
    tasks = [Task(m, w, given.seed) for m in machines for w in ways]
    rows = answers(tasks, diagnosed, told, given.jobs)
    counts = summary(rows)
    if given.quick:
        return int(not all(row["right"] for row in rows))
    if not given.machines:
        document = {"budget_s": BUDGET, "summary": counts, "rows": rows}
        write("nameless_laws", "laws that are none of those offered", [given.seed], document)
    return 0


if __name__ == "__main__":
    sys.exit(main())
