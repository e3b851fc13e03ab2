"""Dry friction, stops and play that the given model has: its values re-calibrated, no law beside.

    python -m benchmarks.known_friction [--quick] [--jobs N] [--seed S] [--machines NAME ...]

Every machine (`benchmarks.frictional_machines`) has a law with a corner in its own model, all
values of which are wrong by up to a quarter; nothing else is missing, or one law. By the command as
it is and, as an ablation, with such laws of the given model rounded over a fixed width. An answer
is right where the findings beside values are that law at its place, or none, and the verdict says
so; beside it stands how many of the values are within their intervals of 95 %. Budgets are of
processor time. Writes ``results/known_friction.json``; --quick (one machine, no file) fails where
its answer is wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.frictional_machines import HELD_OUT, MACHINES
from benchmarks.planted import (
    Task,
    answered_with_values,
    answers,
    asked,
    counted,
    misjudged,
    told_with_values,
    with_values,
)
from benchmarks.provenance import write
from jaxsr.diagnosis.mechanisms.super_model import SuperModel

BUDGET, SEED = 60.0, 0
QUICK = ("conveyor",)
SHARP, ROUNDED = "as the recordings say", "rounded over a fixed width"


def diagnosed(task: Task) -> dict[str, Any]:
    """Return the row of one diagnosis."""
    if task.way == ROUNDED:
        SuperModel.given_jumps = False
    machine = MACHINES[task.machine]
    # One draw a machine, the same for both ways.
    rng = np.random.default_rng([task.seed, list(MACHINES).index(task.machine), task.lacking])
    recordings, model = machine.recordings(rng, task.lacking), misjudged(machine.model, rng)
    return asdict(task) | answered_with_values(machine, model, recordings, task.lacking, BUDGET)


def main() -> int:
    """Run, print, write; 1 where the quick machine is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    given = asked(parser, MACHINES, SEED)
    os.environ["JAXSR_CLOCK"] = "processor"
    machines = QUICK if given.quick else given.machines or tuple(MACHINES)
    ways = (SHARP,) if given.quick else (SHARP, ROUNDED)
    lacking = (False,) if given.quick else (False, True)
    tasks = [Task(m, w, missing, given.seed) for m in machines for w in ways for missing in lacking]
    rows = answers(tasks, diagnosed, told_with_values, given.jobs)
    counts = with_values(counted(rows, HELD_OUT), rows, HELD_OUT)
    if given.quick:
        return int(not all(row["right"] for row in rows))
    if not given.machines:
        document = {"budget_s": BUDGET, "summary": counts, "rows": rows}
        write("known_friction", "friction that the given model has", [given.seed], document)
    return 0


if __name__ == "__main__":
    sys.exit(main())
