"""Time to the exact structure, an earlier commit and this one in turns.

``python -m benchmarks.before_after [--commit HASH] [--seeds 5]`` checks the commit out beside,
runs two-mass chain and crank-slider in both, one process a turn, compiled programs warm, and
writes ``results/before_after.json``. pyoperon's times on the same data stand in
``results/two_mass.json`` and ``results/crank_slider.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import write

ROOT = Path(__file__).resolve().parents[1]
BEFORE = "4c8c727"
"""The last commit before the evaluator was rebuilt."""
TURNS = 2
CODE = """
import json, sys
from benchmarks import crank_slider, two_mass
chain, crank = two_mass.Case(False), crank_slider.CrankSlider()
two_mass.run(99, chain), crank_slider.run(99, crank)
rows = []
for seed in range(int(sys.argv[1])):
    for name, case in ((two_mass, chain), (crank_slider, crank)):
        row = name.run(seed, case)
        exact = bool(row.get("exact", row.get("found")))
        rows.append([name.__name__.rpartition(".")[2], row["seconds"], exact])
print("ROWS", json.dumps(rows))
"""


def turn(folder: Path, seeds: int) -> list[tuple[str, float, bool]]:
    """Run both cases in a checkout; rows of case, seconds and whether the law is exact."""
    done = subprocess.run(
        [sys.executable, "-c", CODE, str(seeds)],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        check=False,
    )
    lines = [x for x in done.stdout.splitlines() if x.startswith("ROWS ")]
    if not lines:
        raise RuntimeError(done.stderr[-2000:])
    return [tuple(row) for row in json.loads(lines[0][5:])]


def summary(rows: list[tuple[str, float, bool]], case: str) -> dict[str, Any]:
    """Median and quartiles of the seconds, and how many were exact."""
    seconds = [s for name, s, _ in rows if name == case]
    low, middle, high = np.quantile(seconds, [0.25, 0.5, 0.75])
    exact = sum(ok for name, _, ok in rows if name == case)
    return {"seconds": [low, middle, high], "exact": exact, "of": len(seconds)}


def main() -> None:
    """Run in turns and write the file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.before_after", description=__doc__)
    parser.add_argument("--commit", default=BEFORE)
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        old = Path(place) / "old"
        clone = ["git", "clone", "-q", str(ROOT), str(old)]
        subprocess.run(clone, check=True)
        subprocess.run(["git", "-C", str(old), "checkout", "-q", options.commit], check=True)
        rows: dict[str, list[tuple[str, float, bool]]] = {"before": [], "now": []}
        for _ in range(TURNS):
            rows["before"] += turn(old, options.seeds)
            rows["now"] += turn(ROOT, options.seeds)
    body: dict[str, Any] = {}
    for case in ("two_mass", "crank_slider"):
        before, now = (summary(rows[k], case) for k in ("before", "now"))
        ratio = before["seconds"][1] / now["seconds"][1]
        body[case] = {"before": before, "now": now, "ratio_of_medians": ratio}
        for name, row in (("before", before), ("now", now)):
            print(f"{case}, {name}: {row['seconds'][1]:.2f} s, {row['exact']}/{row['of']} exact")
        print(f"{case}: ratio of medians {ratio:.2f}")
    body["commit_before"] = options.commit
    write("before_after", "Time to the exact structure", range(options.seeds), body)


if __name__ == "__main__":
    main()
