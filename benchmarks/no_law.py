"""Discoveries in recordings that hold no law, and in some that do: what is claimed.

    python -m benchmarks.no_law [--quick] [--jobs N] [--names walk-21,law-decay]

Forty recordings without a law (random walks and other chance, aliased motions, too few rows, the
driving input left out), a third of them of kinds that the verdict was not developed on; and laws
with modest noise. Right: no law claimed in 38 of the 40, at most one of the others undecided. A
full run writes ``results/no_law.json``, as rows come; --quick (four short cases) writes nothing.
Ends with status 1 if it is wrong.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from typing import Any

from benchmarks import provenance

SEED = 0
SECONDS = 20.0
QUICK_SECONDS = 5.0
QUICK = ("walk-21", "aliased-lorenz-20", "few-predators-12", "law-decay")
MOST_CLAIMED, MOST_LOST = 2, 1
CLAIMS = ("law", "several")


def run(task: tuple[str, int, float]) -> dict[str, Any]:
    """Search one case."""
    import numpy as np

    import jaxsr
    from benchmarks.no_law_cases import LAWS, NO_LAW, UNSEEN

    name, seed, seconds = task
    cases = NO_LAW | LAWS
    case = cases[name](np.random.default_rng([seed, list(cases).index(name)]))
    began = time.perf_counter()
    found = jaxsr.discover(
        case.recordings,
        jaxsr.Roles(states=case.states, **case.options),
        run=jaxsr.Run(seed=seed, budget=seconds),
    )
    return {
        "name": name,
        "seed": seed,
        "holds_law": name in LAWS,
        "unseen": name in UNSEEN,
        "verdict": found.verdict,
        "reason": found.reason,
        "free_run_nrmse": found.free_run_nrmse,
        "alternatives": len(found.judgement.alternatives),
        "found": str(found).split("\n"),
        "seconds": round(time.perf_counter() - began, 1),
    }


def wrong(row: dict[str, Any]) -> bool:
    """Tell whether a law is claimed where none is, or lost where one is."""
    return (row["verdict"] in CLAIMS) != row["holds_law"]


def show(row: dict[str, Any]) -> None:
    """Print one case."""
    error = row["free_run_nrmse"]
    told = "" if error is None else f"NRMSE {error:.2g} "
    mark = "WRONG " if wrong(row) else ""
    print(f"{mark}{row['name']} {row['seed']}: {row['verdict']} ({row['seconds']} s) {told}"
          f"{row['reason']}", flush=True)  # fmt: skip
    if mark:
        print("    " + "\n    ".join(row["found"]), flush=True)


def main() -> int:
    """Run, print, write; return the exit status."""
    from benchmarks.no_law_cases import LAWS, NO_LAW

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="four short cases, writes nothing")
    parser.add_argument("--names", default="", help="comma-separated; all by default")
    parser.add_argument("--seeds", default=str(SEED), help="comma-separated")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    given = parser.parse_args()
    names = given.names.split(",") if given.names else list(QUICK if given.quick else NO_LAW | LAWS)
    seeds = [int(s) for s in given.seeds.split(",")]
    seconds = QUICK_SECONDS if given.quick else SECONDS
    tasks = [(name, seed, seconds) for seed in seeds for name in names]
    rows: list[dict[str, Any]] = []
    whole = not given.quick and not given.names
    context = multiprocessing.get_context("spawn")
    with context.Pool(given.jobs, maxtasksperchild=8) as pool:
        for row in pool.imap_unordered(run, tasks):
            rows.append(row)
            show(row)
            if whole:
                ordered = sorted(rows, key=lambda r: (r["seed"], r["name"]))
                body = {"summary": summary(rows), "budget_seconds": SECONDS, "runs": ordered}
                provenance.write("no_law", "recordings with and without a law", seeds, body)
    told = summary(rows)
    print(json.dumps(told))
    bad = told["claimed"] > MOST_CLAIMED * len(seeds) or told["lost"] > MOST_LOST * len(seeds)
    if given.quick:
        bad = told["claimed"] + told["lost"] > 0
    print("wrong" if bad else "no more wrong than may be")
    return int(bad)


def summary(rows: list[dict[str, Any]]) -> dict[str, int]:
    """Count laws claimed where none is, and laws lost."""
    none = [r for r in rows if not r["holds_law"]]
    some = [r for r in rows if r["holds_law"]]
    return {
        "without_law": len(none),
        "claimed": sum(wrong(r) for r in none),
        "claimed_unseen_kinds": sum(wrong(r) and r["unseen"] for r in none),
        "with_law": len(some),
        "lost": sum(wrong(r) for r in some),
        "several": sum(r["verdict"] == "several" for r in some),
    }


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
