"""Recordings without any noise, as another simulator writes them: values and one law found.

    python -m benchmarks.noise_free [--quick] [--jobs N] [--seed S] [--machines NAME ...]

Every machine as a tight solver has it, all digits kept, all values of its model wrong by up to a
quarter; nothing else is missing, or one law. By the command as it is and, as an ablation, with
sensors as fine as double precision. An answer is right where the findings beside values are that
law at its place, or none, and the verdict says so; beside it stands how many of the values are
within their intervals of 95 %. Budgets are of processor time. Writes ``results/noise_free.json``;
--quick (one machine, no file) fails where its answer is wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import asdict
from typing import Any

import numpy as np

import benchmarks.frictional_machines as frictional
import benchmarks.saturated_machines as saturated
import jaxsr.diagnosis.shooting.converters as converters
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

BUDGET, SEED = 60.0, 0
QUICK = ("mass on a spring",)
AS_IS, DOUBLE = "as fine as a converter", "as fine as double precision"
DOUBLE_BITS = 52
LATER = ("filter and converter", "strain gauge", "cart")
"""Of the machines of `saturated_machines` those that were first run without noise afterwards."""
MACHINES = {name: case.machine for name, case in saturated.MACHINES.items()}
MACHINES |= frictional.HELD_OUT
HELD_OUT = (*LATER, *frictional.HELD_OUT)


def diagnosed(task: Task) -> dict[str, Any]:
    """Return the row of one diagnosis."""
    if task.way == DOUBLE:
        converters.BITS = DOUBLE_BITS
    machine = MACHINES[task.machine]
    # One draw a machine, the same for both ways.
    rng = np.random.default_rng([task.seed, list(MACHINES).index(task.machine), task.lacking])
    recordings = machine.recordings(rng, task.lacking, noise=0.0)
    model = misjudged(machine.model, rng)
    return asdict(task) | answered_with_values(machine, model, recordings, task.lacking, BUDGET)


def main() -> int:
    """Run, print, write; 1 where the quick machine is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    given = asked(parser, MACHINES, SEED)
    os.environ["JAXSR_CLOCK"] = "processor"
    machines = QUICK if given.quick else given.machines or tuple(MACHINES)
    ways = (AS_IS,) if given.quick else (AS_IS, DOUBLE)
    tasks = [
        Task(m, w, missing, given.seed) for m in machines for w in ways for missing in (False, True)
    ]
    rows = answers(tasks, diagnosed, told_with_values, given.jobs)
    counts = with_values(counted(rows, HELD_OUT), rows, HELD_OUT)
    if given.quick:
        return int(not all(row["right"] for row in rows))
    if not given.machines:
        document = {"budget_s": BUDGET, "summary": counts, "rows": rows}
        write("noise_free", "recordings without noise", [given.seed], document)
    return 0


if __name__ == "__main__":
    sys.exit(main())
