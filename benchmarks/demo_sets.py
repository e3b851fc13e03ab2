"""Diagnoses of the four bundled demo sets against what was concealed in them.

    python -m benchmarks.demo_sets [--quick]

The truth stands in ``demo_truth.json``; the diagnosis is not told. A full run writes
``results/demo_sets.json``; --quick (sets 1 and 4) writes nothing. Ends with status 1 if a set is
wrong, in a quick run only if the committed results had it right.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import jax

import jaxsr
from benchmarks.provenance import origin_of
from jaxsr._files import atomic_write_text, dump_json
from jaxsr.diagnosis.result import Diagnosis

HERE = Path(__file__).resolve().parent
DEMO = HERE.parent / "jaxsr" / "datasets" / "demo"
RESULT = HERE / "results" / "demo_sets.json"
SEED = 0
BUDGET = 120.0
"""Seconds; answers are judged here, and a busy machine must not change them."""
QUICK = ("set1", "set4")


def judge(found: Diagnosis, truth: dict[str, Any]) -> dict[str, bool]:
    """Return which of verdict, mechanism, site and interval are right."""
    if truth["mechanism"] is None:
        return {"verdict": found.verdict == truth["verdict"], "mechanism": not found.findings}
    first: dict[str, Any] = {"mechanism": None, "site": None, **(found.findings or [{}])[0]}
    covered = all(
        _inside(first.get("parameters", {}).get(name), wanted["value"])
        for name, wanted in truth["parameters"].items()
    )
    return {
        "verdict": found.verdict == truth["verdict"],
        "mechanism": first["mechanism"] == truth["mechanism"],
        "alone": len(found.findings) == 1,
        "site": first["site"] in truth["sites"],
        "interval": covered,
    }


def _inside(row: dict[str, Any] | None, value: float) -> bool:
    return row is not None and row["ci95"][0] <= value <= row["ci95"][1]


def run(name: str, truth: dict[str, Any]) -> dict[str, Any]:
    """Diagnose one set, print and return its row."""
    begin = time.perf_counter()
    found = jaxsr.diagnose(
        jaxsr.Simulator.from_file(DEMO / "arm.toml"),
        [DEMO / f"{name}_train.csv"],
        held_out=[DEMO / f"{name}_validation.csv"],
        seed=SEED,
        budget=BUDGET,
    )
    seconds = time.perf_counter() - begin
    right = judge(found, truth)
    wrong = [what for what, good in right.items() if not good]
    print(
        f"{name}: {found.verdict} ({seconds:.0f} s): {'wrong: ' + str(wrong) if wrong else 'right'}"
    )
    for row in found.findings:
        for parameter, value in row["parameters"].items():
            true = truth["parameters"].get(parameter, {}).get("value", "none")
            low, high = value["ci95"]
            print(f"  {row['mechanism']}@{row['site']}: {parameter} {value['value']:.4g} "
                  f"[{low:.4g}, {high:.4g}] {value['unit']}, truth {true}")  # fmt: skip
    kept = ("site", "mechanism", "probability", "alternatives", "term", "parameters", "share")
    return {
        "verdict": found.verdict,
        "findings": [{key: row.get(key) for key in kept} for row in found.findings],
        "truth": truth,
        "right": right,
        "fit": found.fit,
        "stopped_by": found.document["provenance"]["stopped_by"],
        "seconds": round(seconds, 1),
    }


def main() -> int:
    """Run the sets; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="sets 1 and 4, writes nothing")
    quick = parser.parse_args().quick
    truths = json.loads((HERE / "demo_truth.json").read_text())["sets"]
    committed = json.loads(RESULT.read_text())["sets"] if RESULT.exists() else {}
    origin = origin_of(SEED)
    print(", ".join(f"{k} {v}" for k, v in origin.items()))
    rows: dict[str, Any] = {}
    for name in QUICK if quick else truths:
        rows[name] = run(name, truths[name])
        jax.clear_caches()  # each diagnosis compiles its own simulators
    wrong = {name for name, row in rows.items() if not all(row["right"].values())}
    if quick:
        wrong = {name for name in wrong if all(committed.get(name, {}).get("right", {}).values())}
    else:
        RESULT.parent.mkdir(exist_ok=True)
        atomic_write_text(RESULT, dump_json({"provenance": origin, "sets": rows}))
    print(f"wrong: {', '.join(sorted(wrong))}" if wrong else "no set is wrong that must be right")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
