"""Constants of a missing force come in the unit of the forces that stand in the model.

    python -m benchmarks.force_units [--quick] [--jobs N] [--only NAME]

Ten plants, each written in the four usual ways: divided by the inertia, with [inertia], with
[definitions], and normalised by the inertia, where nothing tells a force from a rate. Counted are
units (of the finding's constants and of `smallest_detectable`) and 95 % intervals that cover the
truth, converted. A full run writes ``results/force_units.json`` as it goes; --quick (one model
diagnosed, the units of all read) writes nothing. Ends with status 1 where a unit is wrong, or where
fewer intervals cover than one run in a hundred would leave at 95 %.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import Any

from scipy.stats import binom

import jaxsr
from benchmarks.force_plants import PLANTS, WAYS, Plant
from benchmarks.provenance import RESULTS, origin_of
from jaxsr._files import atomic_write_text, dump_json
from jaxsr.models.force_units import force_unit
from jaxsr.models.units import dimension

RESULT = RESULTS / "force_units.json"
SEED, BUDGET = 0, 180.0
QUICK = (("cart", "divided"),)


ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
}


def run(name: str, way: str) -> dict[str, Any]:
    """Diagnose one plant in one way of writing, and judge units and intervals."""
    plant = next(p for p in PLANTS if p.name == name)
    begin = time.perf_counter()
    seed = 100 * PLANTS.index(plant) + WAYS.index(way)
    found = jaxsr.diagnose(
        jaxsr.Simulator(plant.model(way)),
        plant.recordings(way, seed),
        seed=SEED,
        budget=BUDGET,
    )
    return {
        "plant": name,
        "way": way,
        "verdict": found.verdict,
        "seconds": round(time.perf_counter() - begin, 1),
        **judged(plant, way, found.document),
    }


def judged(plant: Plant, way: str, document: dict[str, Any]) -> dict[str, Any]:
    """Return which of mechanism, unit and interval are right."""
    value, unit = plant.truth(way)
    finding = next((f for f in document["findings"] if f["mechanism"] == plant.mechanism), None)
    row = {} if finding is None else finding["parameters"].get(plant.constant, {})
    detectable = document["smallest_detectable"].get(f"{plant.mechanism}@equation:v")
    units = [r["unit"] for r in (row, detectable or {}) if "unit" in r]
    return {
        "finding": None if finding is None else finding["term"],
        "edit": None if finding is None else finding["edit"].get("equations.v"),
        "value": row.get("value"),
        "ci95": row.get("ci95"),
        "unit": row.get("unit"),
        "truth": [value, unit],
        "found": finding is not None,
        "unit_right": bool(row) and all(_same(u, unit) for u in units),
        "covered": bool(row) and row["ci95"][0] <= value <= row["ci95"][1],
    }


def _same(text: str | None, unit: str) -> bool:
    return text is not None and dimension(text) == dimension(unit)


def misread() -> list[str]:
    """Return the models in which a force along v has another unit than it should."""
    wrong = []
    for plant in PLANTS:
        for way in WAYS:
            expected = f"({plant.force_unit})"
            if way == "normalised":
                expected += f"/({plant.mass_unit})"
            if not _same(force_unit(plant.model(way), "v"), expected):
                wrong.append(f"{plant.name}, {way}")
    return wrong


def main() -> int:
    """Run the plants; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one plant, writes nothing")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--only", help="one plant by name, writes nothing")
    args = parser.parse_args()
    os.environ |= ONE_THREAD  # of every process
    cases = [(p.name, way) for p in PLANTS for way in WAYS if args.only in (None, p.name)]
    if wrong := misread():
        print(f"unit of a force misread: {'; '.join(wrong)}")
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        for future in as_completed(
            [pool.submit(run, *c) for c in (QUICK if args.quick else cases)]
        ):
            row = future.result()
            rows.append(row)
            print(
                f"{row['plant']}, {row['way']}: {row['verdict']} {row['finding']} "
                f"{row['value']} {row['ci95']} {row['unit']}, truth {row['truth']} "
                f"({row['seconds']} s)"
            )
            if not (args.quick or args.only):
                RESULT.parent.mkdir(exist_ok=True)
                _write(rows)
    units, covered = (sum(r[key] for r in rows) for key in ("unit_right", "covered"))
    print(f"units right: {units} of {len(rows)}; intervals covering: {covered} of {len(rows)}")
    return int(bool(wrong) or units < len(rows) or covered < binom.ppf(0.01, len(rows), 0.95))


def _write(rows: list[dict[str, Any]]) -> None:
    ordered = sorted(rows, key=lambda r: (r["plant"], WAYS.index(r["way"])))
    total = {k: sum(r[k] for r in rows) for k in ("found", "unit_right", "covered")}
    document = {"provenance": origin_of(SEED), "models": len(rows), **total, "rows": ordered}
    atomic_write_text(RESULT, dump_json(document))


if __name__ == "__main__":
    sys.exit(main())
