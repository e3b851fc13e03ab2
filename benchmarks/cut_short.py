"""Diagnoses that are cut at a tenth of the time that they need: what they still claim.

    python -m benchmarks.cut_short [--quick] [--jobs N]

Eighteen effects in four plants, and the four bundled demo sets, five seeds each where there are
seeds (noise and excitation), every fourth run cut by an interrupt and not by its budget. The time
that a run needs is that of the same effect at the first seed, uncut. Counted: answers that are
right (verdict, mechanism and place), those that abstain (`undecided`), those that are wrong, and
those that state a probability above 0.9 for what is not so; of the last there must be none.
Results, as they come: ``results/cut_short.json``; --quick (three effects, cut after fixed times)
writes nothing. Ends with status 1 if a wrong answer is stated above 0.9.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.cut_systems import PLANTS
from benchmarks.provenance import write

SEEDS, DEMO_SEEDS = range(5), range(3)
SHARE, SURE = 0.1, 0.9
LONGEST = 600.0
"""Seconds that an uncut run may take."""
QUICK = (("cart", "coulomb", 1.5), ("pendulum", "constant", 1.5), ("tank", "leak", 1.0))
DEMO = Path(__file__).resolve().parents[1] / "jaxsr" / "datasets" / "demo"
TRUTH = Path(__file__).resolve().parent / "demo_truth.json"


@dataclass(frozen=True)
class Run:
    """One diagnosis: of what, which seed, after how many seconds it ends and how."""

    plant: str
    effect: str
    seed: int
    seconds: float
    interrupt: bool = False


def inputs_of(run: Run) -> tuple[Any, list[Any], frozenset[tuple[str, str]]]:
    """Return the simulator, the recordings and what names the cause."""
    import jaxsr
    from jaxsr.models import parse_model

    if run.plant == "demo":
        truth = json.loads(TRUTH.read_text())["sets"][run.effect]
        causes = {(truth["mechanism"], site) for site in truth.get("sites", ())}
        simulator = jaxsr.Simulator.from_file(DEMO / "arm.toml")
        data: list[Any] = [DEMO / f"{run.effect}_train.csv"]
        return simulator, data, frozenset(causes if truth["mechanism"] else ())
    plant = next(p for p in PLANTS if p.name == run.plant)
    effect = next(e for e in plant.effects if e.name == run.effect)
    simulator = jaxsr.Simulator(parse_model(plant.model))
    return simulator, plant.record(effect, run.seed), effect.causes


def judge(
    verdict: str, findings: list[dict[str, Any]], causes: frozenset[tuple[str, str]]
) -> tuple[str, float]:
    """Return "right", "abstains" or "wrong", and the largest probability of what is not so.

    Values that a wrong cause would move are no causes of their own: they count as what is so only
    where the cause is a value.
    """
    false = [f for f in findings if (f["mechanism"], f["site"]) not in causes]
    if causes and all(mechanism == "wrong_value" for mechanism, _ in causes):
        false = [f for f in false if f["mechanism"] != "wrong_value"]
    stated = max((float(f["probability"]) for f in false), default=0.0)
    if verdict == "undecided":
        return "abstains", stated
    if not causes:
        return ("right" if verdict == "nothing" else "wrong"), stated
    named = any((f["mechanism"], f["site"]) in causes for f in findings)
    return ("right" if named and len(false) == 0 else "wrong"), stated


def diagnosed(run: Run) -> dict[str, Any]:
    """Diagnose once, ended as the run says; return its row."""
    import jax

    import jaxsr
    from jaxsr._progress import Budget

    jax.clear_caches()
    simulator, data, causes = inputs_of(run)
    begun, timer = time.monotonic(), None
    budget = Budget() if run.interrupt else Budget(run.seconds)
    if run.interrupt:
        timer = threading.Timer(run.seconds, budget.interrupt)
        timer.start()
    found = jaxsr.diagnose(simulator, data, seed=run.seed, budget=budget)
    took = time.monotonic() - begun
    if timer is not None:
        timer.cancel()
    outcome, stated = judge(found.verdict, found.findings, causes)
    keep = ("mechanism", "site", "probability")
    return {
        "plant": run.plant,
        "effect": run.effect,
        "seed": run.seed,
        "ended": "interrupt" if run.interrupt else "budget",
        "cut_s": round(run.seconds, 2),
        "took_s": round(took, 2),
        "stopped_by": found.document["provenance"]["stopped_by"],
        "verdict": found.verdict,
        "findings": [{k: f[k] for k in keep} for f in found.findings],
        "outcome": outcome,
        "false_probability": stated,
        "sentence": found.sentence,
    }


def series(plant: str, effect: str, seeds: range) -> list[dict[str, Any]]:
    """Measure the time that the first seed needs, and cut every seed at a tenth of it."""
    whole = diagnosed(Run(plant, effect, seeds[0], LONGEST))
    rows = []
    for number in seeds:
        cut = SHARE * whole["took_s"]
        row = diagnosed(Run(plant, effect, number, cut, interrupt=number % 4 == 3))
        rows.append({**row, "needed_s": whole["took_s"], "uncut": whole["outcome"]})
    return rows


def single_threaded() -> None:
    """Give a worker one core: several run side by side."""
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"


def full(jobs: int) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows of every effect as they come."""
    asked = [(p.name, e.name, SEEDS) for p in PLANTS for e in p.effects]
    asked += [("demo", name, DEMO_SEEDS) for name in json.loads(TRUTH.read_text())["sets"]]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, single_threaded) as pool:
        for done in as_completed([pool.submit(series, *item) for item in asked]):
            yield done.result()


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Count the outcomes."""
    sure = [r for r in rows if r["false_probability"] > SURE]
    return {
        "runs": len(rows),
        **{o: sum(r["outcome"] == o for r in rows) for o in ("right", "abstains", "wrong")},
        "false_above_0.9": len(sure),
    }


def tell(row: dict[str, Any]) -> None:
    """Print one row."""
    print(
        f"{row['plant']} {row['effect']} seed {row['seed']}, cut after {row['cut_s']} s: "
        f"{row['verdict']}, {row['outcome']}, false at most {row['false_probability']:.2f}",
        flush=True,
    )


def main() -> int:
    """Run; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="three effects, writes nothing")
    parser.add_argument("--jobs", type=int, default=1, help="processes side by side")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = []
    if asked.quick:
        for plant, effect, seconds in QUICK:
            rows.append(diagnosed(Run(plant, effect, 0, seconds, interrupt=plant == "pendulum")))
            tell(rows[-1])
    else:
        for some in full(asked.jobs):
            rows += some
            for row in some:
                tell(row)
            write("cut_short", "cut at a tenth of the time", list(SEEDS), _body(rows))
    print(", ".join(f"{k} {v}" for k, v in summary(rows).items()))
    return 1 if summary(rows)["false_above_0.9"] else 0


def _body(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {"summary": summary(rows), "rows": rows}


if __name__ == "__main__":
    sys.exit(main())
