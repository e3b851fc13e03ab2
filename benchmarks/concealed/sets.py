"""All sealed sets together: ``python -m benchmarks.concealed.sets [SCORE --commit C]``.

Keeps of every scored set its seed, the checksum of its truth and jaxsr's counts, and prints their
sums. A set belongs to the commit that was frozen before it was drawn.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.concealed.rates import Rate
from jaxsr._files import atomic_write_text, dump_json

SETS = Path(__file__).resolve().parents[1] / "results" / "concealed" / "sets.json"
COUNTED = (
    "verdict",
    "false_discoveries",
    "site_top1",
    "mechanism_top1",
    "mechanism_top3",
    "interval_coverage",
    "under_60_s",
)


def row_of(score: dict[str, Any], commit: str) -> dict[str, Any]:
    """Return the counts of one score.json."""
    own, sealed = score["methods"]["jaxsr"], score["sealed"]
    counts = {name: {key: own[name][key] for key in ("k", "n")} for name in COUNTED}
    return {
        "commit": commit,
        "seed": sealed["seed"],
        "cases": sealed["cases"],
        "truth_sha256": sealed["truth_sha256"],
        "counts": counts,
        "gap_closed_median": own["gap_closed_median"],
        "seconds_median": own["seconds_median"],
    }


def pooled(rows: Sequence[dict[str, Any]]) -> dict[str, Rate]:
    """Return the rates over all sets."""
    sums = {
        name: [sum(row["counts"][name][key] for row in rows) for key in ("k", "n")]
        for name in COUNTED
    }
    return {name: Rate(k, n) for name, (k, n) in sums.items()}


def main(arguments: list[str] | None = None) -> int:
    """Add a set where one is named, and print all."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.concealed.sets", description=__doc__
    )
    parser.add_argument("score", type=Path, nargs="?", metavar="SCORE", help="a score.json to add")
    parser.add_argument("--commit", help="the frozen commit of the set to add")
    options = parser.parse_args(arguments)
    rows = json.loads(SETS.read_text()) if SETS.exists() else []
    if options.score is not None:
        if not options.commit:
            parser.error("a score needs its --commit")
        row = row_of(json.loads(options.score.read_text()), options.commit)
        rows = [r for r in rows if r["seed"] != row["seed"]] + [row]
        atomic_write_text(SETS, dump_json(rows))
    for row in rows:
        counts = ", ".join(f"{n} {c['k']}/{c['n']}" for n, c in row["counts"].items())
        print(f"{row['commit']} (seed {row['seed']}): {counts}")
    for name, rate in pooled(rows).items():
        print(f"{name}: {rate.text()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
