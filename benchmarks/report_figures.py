"""Figures of a diagnosis' report against their exact values, on plants with closed forms.

    python -m benchmarks.report_figures [--quick] [--jobs N]

Ten plants, each with every figure that it has a closed form for. A full run draws the motion and
the noise of each from 20 seeds and writes ``results/report_figures.json`` as it goes; --quick takes
the first seed and writes nothing. Ends with status 1 if a figure is wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.figure_plants import PLANTS
from benchmarks.provenance import origin_of
from jaxsr._files import atomic_write_text, dump_json

RESULT = Path(__file__).resolve().parent / "results" / "report_figures.json"
SEEDS = 20


def rows_of(seed: int, name: str) -> list[dict[str, Any]]:
    """Return the figures of one plant."""
    return [
        {
            "plant": name,
            "seed": seed,
            "figure": row.name,
            "found": row.found,
            "exact": row.exact,
            "tolerance": row.tolerance,
            "right": row.right,
        }
        for row in PLANTS[name](seed)
    ]


def shown(value: float | str | None) -> str:
    """Print a figure in a column."""
    if value is None:
        return "left out"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def main() -> int:
    """Run the plants; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="one seed, writes nothing")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default 1)")
    arguments = parser.parse_args()
    origin = origin_of(0)
    print(", ".join(f"{k} {v}" for k, v in origin.items()))
    seeds = range(1 if arguments.quick else SEEDS)
    tasks = [(seed, name) for seed in seeds for name in PLANTS]
    every: list[dict[str, Any]] = []

    def take(rows: list[dict[str, Any]]) -> None:
        every.extend(rows)
        for row in rows:
            if arguments.quick or not row["right"]:
                mark = "" if row["right"] else "  WRONG"
                found, exact = shown(row["found"]), shown(row["exact"])
                place = f"{row['plant']} ({row['seed']})"
                print(f"{place:24} {row['figure']:50} {found:>12} {exact:>12}{mark}")
        if not arguments.quick:
            RESULT.parent.mkdir(exist_ok=True)
            atomic_write_text(RESULT, dump_json({"provenance": origin, "rows": every}))

    if arguments.jobs > 1:
        os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("spawn")) as pool:
            for rows in pool.map(rows_of, *zip(*tasks, strict=True)):
                take(rows)
    else:
        for task in tasks:
            take(rows_of(*task))
    wrong = sum(not row["right"] for row in every)
    print(f"{len(every) - wrong} of {len(every)} figures right")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
