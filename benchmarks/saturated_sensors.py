"""Sensors at their limits: clipping told, with what else is missing, by machines of many forms.

    python -m benchmarks.saturated_sensors [--quick] [--jobs N] [--seed S] [--machines NAME ...]

Every machine (`benchmarks.saturated_machines`) with one sensor that is limited at the top, at the
bottom or at both ends of its range, and with nothing else or one law missing; by the command as it
is and, as an ablation, with readings at the limits weighed as all others are. An answer is right
where the findings are the clipped sensor and that law, each at its place, and no other. Budgets are
of processor time. Writes ``results/saturated_sensors.json``; --quick (one machine, no file) fails
where its answer is wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import asdict
from typing import Any

import numpy as np

import jaxsr._clock as clock
import jaxsr.diagnosis.likelihood.hypotheses as hypotheses
import jaxsr.diagnosis.likelihood.limits as limits
from benchmarks.planted import Task, answers, asked, counted
from benchmarks.provenance import write
from benchmarks.saturated_machines import HELD_OUT, MACHINES
from jaxsr.diagnosis import diagnose
from jaxsr.models import Simulator

BUDGET, SEED = 60.0, 0
QUICK = ("mass on a spring",)
CENSORED, AS_OTHERS = "readings at limits censored", "weighed as all others"


def diagnosed(task: Task) -> dict[str, Any]:
    """Return the row of one diagnosis."""
    if task.way == AS_OTHERS:
        hypotheses.limits_of = limits.limits_of = lambda *_: []
    case = MACHINES[task.machine]
    # One draw a machine, the same for both ways.
    rng = np.random.default_rng([task.seed, list(MACHINES).index(task.machine), task.lacking])
    recordings = case.recordings(rng, task.lacking)
    began = clock.now()
    found = diagnose(Simulator(case.machine.model), recordings, budget=BUDGET)
    told = {(f["mechanism"], f["site"]) for f in found.findings}
    wanted = {("clipping", f"output:{case.output}")}
    if task.lacking:
        wanted.add((case.machine.mechanism, f"equation:{case.machine.state}"))
    return {
        **asdict(task),
        "ends": case.ends,
        "verdict": found.verdict,
        "findings": sorted(told),
        "right": told == wanted and found.verdict != "undecided",
        "seconds": round(clock.now() - began, 1),
    }


def told(row: dict[str, Any]) -> str:
    """Return a row as a line."""
    what = ", ".join(f"{mechanism} at {site}" for mechanism, site in row["findings"]) or "-"
    mark = "right" if row["right"] else "WRONG"
    name = f"{row['machine']}, {'a law missing' if row['lacking'] else 'clipped'}, {row['way']}"
    return f"{name:64} {mark} {row['verdict']}: {what} ({row['seconds']} s)"


def main() -> int:
    """Run, print, write; 1 where the quick machine is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    given = asked(parser, MACHINES, SEED)
    os.environ["JAXSR_CLOCK"] = "processor"
    machines = QUICK if given.quick else given.machines or tuple(MACHINES)
    ways = (CENSORED,) if given.quick else (CENSORED, AS_OTHERS)
    tasks = [
        Task(m, w, missing, given.seed) for m in machines for w in ways for missing in (False, True)
    ]
    rows = answers(tasks, diagnosed, told, given.jobs)
    counts = counted(rows, HELD_OUT)
    if given.quick:
        return int(not all(row["right"] for row in rows))
    if not given.machines:
        document = {"budget_s": BUDGET, "summary": counts, "rows": rows}
        write("saturated_sensors", "sensors at their limits", [given.seed], document)
    return 0


if __name__ == "__main__":
    sys.exit(main())
