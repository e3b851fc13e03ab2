"""Machines of which no sensor reads the positions, with starts sought in the readings and without.

    python -m benchmarks.unread_positions [--quick] [--jobs N] [--seed S]

Every machine (`benchmarks.unread_machines`) twice, with an effect left out and with nothing; every
recording twice, by the command as it is and with the search for starts switched off
(`jaxsr.models.filter_bank`), as an ablation. An answer is right where the verdict and, beside an
effect, the first finding's mechanism and place are. Budgets are of processor time. Writes
``results/unread_positions.json``; --quick (two machines as the command is, no file) fails where
an answer that the committed results have right is wrong. A full run ends with status 1 if the
command has fewer than nine of ten right.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import product
from multiprocessing import get_context
from typing import Any

import numpy as np

import jaxsr._clock as clock
import jaxsr.models.hidden as hidden
from benchmarks.provenance import RESULTS, write
from benchmarks.unread_machines import MACHINES
from jaxsr.diagnosis import diagnose
from jaxsr.models import Simulator

BUDGET, ASKED, SEED = 120.0, 0.9, 0
QUICK = ("marker", "generator")
SOUGHT, LEFT = "starts sought", "starts left"


@dataclass(frozen=True)
class Task:
    """One diagnosis."""

    machine: str
    lacking: bool
    way: str
    seed: int


def diagnosed(task: Task) -> dict[str, Any]:
    """Return the row of one diagnosis."""
    if task.way == LEFT:
        hidden.bends = lambda model, states: False
    machine = MACHINES[task.machine]
    # One draw a machine, the same for both ways.
    rng = np.random.default_rng([task.seed, list(MACHINES).index(task.machine), task.lacking])
    recordings = machine.recordings(rng, task.lacking)
    began = clock.now()
    found = diagnose(Simulator(machine.model), recordings, budget=BUDGET)
    first = {"mechanism": None, "site": None, **(found.findings or [{}])[0]}
    wanted = (machine.mechanism, f"equation:{machine.state}") if task.lacking else (None, None)
    verdict = "structure" if task.lacking else "nothing"
    return {
        **asdict(task),
        "verdict": found.verdict,
        "mechanism": first["mechanism"],
        "site": first["site"],
        "right": found.verdict == verdict and (first["mechanism"], first["site"]) == wanted,
        "seconds": round(clock.now() - began, 1),
    }


def told(row: dict[str, Any]) -> str:
    """Return a row as a line."""
    what = row["mechanism"] or "no mechanism"
    state = "lacking" if row["lacking"] else "whole"
    mark = "right" if row["right"] else "WRONG"
    name = f"{row['machine']}, {state}, {row['way']}"
    return f"{name:48} {mark} {row['verdict']}: {what} ({row['seconds']} s)"


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how many answers are right, by way."""
    ways = dict.fromkeys(r["way"] for r in rows)
    return {
        way: {
            "right": sum(r["right"] for r in rows if r["way"] == way),
            "of": sum(r["way"] == way for r in rows),
        }
        for way in ways
    }


def main() -> int:
    """Run, print, write; 1 where too few answers are right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=SEED)
    given = parser.parse_args()
    os.environ["JAXSR_CLOCK"] = "processor"
    machines = QUICK if given.quick else tuple(MACHINES)
    ways = (SOUGHT,) if given.quick else (SOUGHT, LEFT)
    tasks = [
        Task(m, lacking, w, given.seed) for m, lacking, w in product(machines, (True, False), ways)
    ]
    rows: list[dict[str, Any]] = []
    # A process a task: one leaves a search switched off behind.
    with ProcessPoolExecutor(
        given.jobs, mp_context=get_context("spawn"), max_tasks_per_child=1
    ) as pool:
        for row in pool.map(diagnosed, tasks):
            rows.append(row)
            print(told(row), flush=True)
    counts = summary(rows)
    for way, count in counts.items():
        print(f"{way}: {count['right']} of {count['of']} right")
    if given.quick:
        committed = json.loads((RESULTS / "unread_positions.json").read_text(encoding="utf-8"))
        was = {
            (r["machine"], r["lacking"])
            for r in committed["rows"]
            if r["right"] and r["way"] == SOUGHT
        }
        return int(any((r["machine"], r["lacking"]) in was and not r["right"] for r in rows))
    title = "machines of which no sensor reads the positions"
    write(
        "unread_positions",
        title,
        [given.seed],
        {"budget_s": BUDGET, "summary": counts, "rows": rows},
    )
    return int(counts[SOUGHT]["right"] < ASKED * counts[SOUGHT]["of"])


if __name__ == "__main__":
    sys.exit(main())
