"""Discovery on what users reported: uneven instants, many short runs, scales, clocks, Hill laws.

    python -m benchmarks.discovery_reports [--quick] [--kinds A,B] [--seeds 0,1] [--jobs N]

After public reports of users of sparse regression for dynamics (PySINDy's among them): kinds of
recordings on which a law of another form came out. Right: as many terms as the law that made the
recordings, and rates that differ from its own by less than `NEAR` of their rms over 1.5 times the
range of the data, so that a sine in place of a cubic is wrong. "Claimed wrongly": the verdict is
*law* where that is not so. A full run writes ``results/discovery_reports.json``, as rows come;
--quick (`QUICK`, seed 0) writes nothing. Ends with status 0: it reports.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from typing import Any

from benchmarks import provenance

SEEDS = range(10)
SECONDS, QUICK_SECONDS = 60.0, 10.0
QUICK = ("uneven-hardening", "scales-cells")
NEAR = 0.05
"""Rms difference of the rates over their own, above which another law was found."""
WIDER = 1.5  # times the range of the data within which rates are compared
POINTS = 400


def run(task: tuple[str, int, float]) -> dict[str, Any]:
    """Search one case."""
    import numpy as np

    import jaxsr
    from benchmarks.discovery_reports_cases import KINDS

    name, seed, seconds = task
    case = KINDS[name](np.random.default_rng([seed, list(KINDS).index(name)]))
    began, worked = time.perf_counter(), time.process_time()
    found = jaxsr.discover(
        case.recordings,
        jaxsr.Roles(states=case.states, **case.options),
        run=jaxsr.Run(seed=seed, budget=seconds),
    )
    apart = differences(case, found)
    terms = [len(found[state].terms) for state in case.states]
    right = max(apart) < NEAR and all(n <= m for n, m in zip(terms, case.terms, strict=True))
    return {
        "kind": name,
        "seed": seed,
        "right": bool(right),
        "verdict": found.verdict,
        "terms": terms,
        "apart": [float(f"{a:.3g}") for a in apart],
        "time": any("t" in t.term.variables for e in found.equations for t in e.terms),
        "free_run_nrmse": found.free_run_nrmse,
        "found": [f"{e.state}' = {e.expression}" for e in found.equations],
        "stopped_by": str(found.provenance["stopped_by"]),
        "seconds": round(time.perf_counter() - began, 1),
        "processor_seconds": round(time.process_time() - worked, 1),
    }


def differences(case: Any, found: Any) -> list[float]:
    """Return the rms difference of every found rate and the true one, over the latter's rms."""
    import numpy as np

    from jaxsr.discovery.choose import predict

    rng = np.random.default_rng(0)
    points = {}
    for state in case.states:
        x = np.concatenate([r.channels[state] for r in case.recordings])
        drawn = rng.choice(x, POINTS)
        points[state] = np.mean(x) + WIDER * (drawn - np.mean(x))
        if np.min(x) >= 0.0:
            points[state] = np.maximum(points[state], np.min(x))
    t = rng.choice(np.concatenate([r.time for r in case.recordings]), POINTS)
    rates = case.law(t - case.origin, np.array(list(points.values())))
    out = []
    for state, rate in zip(case.states, rates, strict=True):
        terms = found[state].terms
        weights = np.array([term.coefficient for term in terms])
        with np.errstate(all="ignore"):
            own = predict([term.term for term in terms], weights, {"t": t, **points})
            error = np.sqrt(np.mean((own - rate) ** 2)) / np.sqrt(np.mean(np.square(rate)))
        out.append(float(error) if np.isfinite(error) else 1e9)
    return out


def show(row: dict[str, Any]) -> None:
    """Print one case."""
    mark = "right" if row["right"] else "WRONG"
    print(f"{row['kind']} {row['seed']}: {mark}, {row['verdict']} "
          f"({row['processor_seconds']} s) apart {row['apart']}", flush=True)  # fmt: skip
    if not row["right"]:
        print("    " + "\n    ".join(row["found"]), flush=True)


def summary(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, int]]:
    """Count by kind: runs, right ones, wrong ones called a law, and laws that hold time."""
    out = {}
    for kind in dict.fromkeys(r["kind"] for r in rows):
        own = [r for r in rows if r["kind"] == kind]
        out[kind] = {
            "runs": len(own),
            "right": sum(r["right"] for r in own),
            "claimed_wrongly": sum(r["verdict"] == "law" and not r["right"] for r in own),
            "with_time": sum(r["time"] for r in own),
        }
    return out


def main() -> int:
    """Run, print, write; return the exit status."""
    from benchmarks.discovery_reports_cases import KINDS

    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="two short cases, writes nothing")
    parser.add_argument("--kinds", default="", help="comma-separated; all by default")
    parser.add_argument("--seeds", default="", help="comma-separated; 0 to 9 by default")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    given = parser.parse_args()
    kinds = given.kinds.split(",") if given.kinds else list(QUICK if given.quick else KINDS)
    seeds = [int(s) for s in given.seeds.split(",")] if given.seeds else list(SEEDS)
    seconds = QUICK_SECONDS if given.quick else SECONDS
    tasks = [
        (kind, seed, seconds) for seed in (seeds[:1] if given.quick else seeds) for kind in kinds
    ]
    rows: list[dict[str, Any]] = []
    whole = not (given.quick or given.kinds or given.seeds)
    context = multiprocessing.get_context("spawn")
    with context.Pool(given.jobs) as pool:
        for row in pool.imap_unordered(run, tasks):
            rows.append(row)
            show(row)
            if whole:
                ordered = sorted(rows, key=lambda r: (r["kind"], r["seed"]))
                body = {"summary": summary(ordered), "budget_seconds": SECONDS, "runs": ordered}
                provenance.write("discovery_reports", "reports on discovery", seeds, body)
    print(json.dumps(summary(rows)))
    return 0


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sys.exit(main())
