"""Hostile and damaged model files and recordings, twenty thousand of each: none may end a program.

    python -m benchmarks.hostile [--quick] [--kinds models,recordings] [--last N]

Files are seeded by their number (`tests/fuzz_models.py`, `tests/fuzz_recordings.py`) and read in
blocks of 500, each block in a process of its own. Every file must end in what it holds or in one
`InputError` of one line, within 2 s of processor time and 500 MB, and no file may end the process.
Results, as they come: ``results/hostile.json``, in which blocks that were read are not read again.
--quick: forty of each, no file. Ends with status 1 if a file was not read as it should be.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.provenance import RESULTS, ROOT, engine, write

KINDS = ("models", "recordings")
LAST, BLOCK, QUICK = 20_000, 500, 40
MEGABYTES = 500.0


def read(kind: str, first: int, last: int) -> dict[str, Any]:
    """Read the files of these numbers; return what was wrong, and the worst costs.

    Returns
    -------
    dict
        kind, first, last, engine; ``wrong``, a list of lines; ``seconds`` of processor time of the
        slowest file and ``megabytes`` of the largest process.
    """
    script = ROOT / "tests" / f"fuzz_{kind}.py"
    with tempfile.TemporaryDirectory() as folder:
        words = [sys.executable, str(script), str(first), str(last)]
        done = subprocess.run(
            words + [folder] * (kind == "recordings"),
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    wrong = [f"{row['case']}: {row['wrong']}" for row in rows if "case" in row]
    totals = rows[-1] if rows and "case" not in rows[-1] else {}
    if done.returncode or not totals:
        wrong.append(f"ended by {done.returncode}: {done.stderr.strip()[-300:]}")
    most = max(totals.get("megabytes", 0.0), totals.get("worker", 0.0))
    if kind == "models" and most > MEGABYTES:  # the other script counts every file
        wrong.append(f"{most:.0f} MB")
    costs = {"seconds": round(totals.get("seconds", 0.0), 2), "megabytes": round(most)}
    return {"kind": kind, "first": first, "last": last, "wrong": wrong, **costs, "engine": engine()}


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return how many files of each kind were read, how many not as they should be, and costs."""
    out = {}
    for kind in KINDS:
        own = [row for row in rows if row["kind"] == kind]
        if own:
            out[kind] = {
                "files": sum(row["last"] - row["first"] for row in own),
                "wrong": sum(len(row["wrong"]) for row in own),
                "seconds": max(row["seconds"] for row in own),
                "megabytes": max(row["megabytes"] for row in own),
            }
    return out


def kept() -> list[dict[str, Any]]:
    """Return the blocks that the result holds."""
    path = RESULTS / "hostile.json"
    return json.loads(path.read_text(encoding="utf-8"))["blocks"] if path.is_file() else []


def main() -> int:
    """Read, print, write; 1 where a file was not read as it should be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="forty of each, no file")
    parser.add_argument("--kinds", default=",".join(KINDS), help="with commas between")
    parser.add_argument("--last", type=int, default=LAST, help="number to end before")
    given = parser.parse_args()
    rows = [] if given.quick else kept()
    there = {(row["kind"], row["first"]) for row in rows}
    last, block = (QUICK, QUICK) if given.quick else (given.last, BLOCK)
    for kind in given.kinds.split(","):
        for first in range(0, last, block):
            if (kind, first) in there:
                continue
            row = read(kind, first, min(first + block, last))
            rows = sorted([*rows, row], key=lambda r: (r["kind"], r["first"]))
            print(f"{kind} {first} to {row['last']}: {row['wrong'] or 'right'}", flush=True)
            if not given.quick:
                body = {"summary": summary(rows), "blocks": rows}
                write("hostile", "hostile model files and recordings", [0], body)
    found = summary(rows)
    for kind, told in found.items():
        print(kind, told)
    return int(any(told["wrong"] for told in found.values()))


if __name__ == "__main__":
    sys.exit(main())
