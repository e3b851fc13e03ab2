"""Time of a generation and time to the exact structure, against NumPy and an earlier commit.

``python -m benchmarks.generation [--commit HASH] [--rows 200 1000 10000 100000] [--turns N]``
checks the commit out beside and searches for the acceleration of the first mass (section 7.1) on
that many rows, in turns and a process each: the commit, this code with every column by NumPy,
this code. A generation is all of ``evolution.loop.step`` at the default settings, on a target with
40 dB of noise, so that no search is over. Seconds are the process' own processor time, all threads
together: two cores halve what they share of it, and nothing that runs beside changes it. Wall
time is printed beside them. Writes ``results/generation.json``; ``--quick`` writes nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import write
from jaxsr.evaluation import Evaluator, Reference, keep_compiled
from jaxsr.evolution import SearchConfig
from jaxsr.evolution.library import small_terms
from jaxsr.expressions import parse
from jaxsr.regression import RegressionProblem, Resources

ROOT = Path(__file__).resolve().parents[1]
BEFORE = "48e8622"
"""The last commit whose search evaluated term by term in NumPy."""
TURNS = {200: 3, 1_000: 3, 10_000: 2, 100_000: 1}
"""Searches of each engine, by rows."""
GENERATIONS, EXACT = {100_000: 2}, 12  # timed of a search, 4 by default; at most until the law
NEW, SETS = (30, 100, 400), 60  # terms in a batch; sets in a search over constants
CODE = """
import json, sys, time
import numpy as np
from benchmarks.systems import two_mass, variables
from jaxsr.evaluation import keep_compiled
from jaxsr.evolution import SearchConfig, init
from jaxsr.evolution.loop import step
from jaxsr.regression import RegressionProblem

rows, seed, count, most, population, engine, folder = sys.argv[1:]
keep_compiled(folder)
options = {}
if engine == "numpy":
    from jaxsr.evaluation import Reference
    try:
        from jaxsr.regression.settings import Resources
        options["resources"] = Resources(evaluator=Reference)
    except ImportError:  # a commit that is compared with may come before these settings
        options["evaluator"] = Reference
parts = [variables(recording) for recording in two_mass(int(rows))]
columns = {n: np.concatenate([p[n] for p in parts]) for n in ("t", "z1", "z2", "z3", "z4")}
clean = np.concatenate([p["dz3"] for p in parts])
noise = 0.01 * np.std(clean) * np.random.default_rng(int(seed)).normal(size=len(clean))
config = SearchConfig(population=int(population))

def clocks():
    return np.array([time.process_time(), time.perf_counter()])

def found(state):
    law = [m for m in state.front.members if m.loss < 1e-20 and len(m.terms) == 3]
    return bool(law) and {n for t in law[0].terms for n in t.variables} == {"t", "z1", "z2"}

rng = np.random.default_rng(int(seed))
problem = RegressionProblem(clean + noise, columns, **options)
began = clocks()
state = init(rng, problem, config)
first = clocks() - began
each = []
for _ in range(int(count)):
    began = clocks()
    state, _ = step(rng, state, problem)
    each.append((clocks() - began).tolist())
rng = np.random.default_rng(int(seed))
problem = RegressionProblem(clean, columns, **options)
began = clocks()
state = init(rng, problem, config)
while not found(state) and state.generation < int(most):
    state, _ = step(rng, state, problem)
exact = (clocks() - began).tolist()
row = {"first": first.tolist(), "each": each, "exact": exact, "found": found(state)}
print("ROW", json.dumps(row | {"loss": state.front.best_loss}))
"""


def turn(folder: Path, cache: str, engine: str, rows: int, seed: int, sizes: Sequence[int]) -> Any:
    """Run one search in a checkout, in a process of its own."""
    numbers = [str(k) for k in (rows, seed, *sizes)]
    done = subprocess.run(
        [sys.executable, "-c", CODE, *numbers, engine, cache],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        check=False,
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("ROW ")]
    if not lines:
        raise RuntimeError(done.stderr[-2000:])
    return json.loads(lines[0][4:])


def summary(turns: Sequence[Any], clock: int) -> dict[str, Any]:
    """Return medians over turns: the first population, later generations, to the exact law."""
    return {
        "first_population": statistics.median(t["first"][clock] for t in turns),
        "first_generation": statistics.median(t["each"][0][clock] for t in turns),
        "generation": statistics.median(s[clock] for t in turns for s in t["each"][1:]),
        "exact": statistics.median(t["exact"][clock] for t in turns),
        "found": sum(t["found"] for t in turns),
        "of": len(turns),
    }


def evaluation(rows: int, repeats: int) -> list[dict[str, float]]:
    """Return milliseconds of new terms on ``rows`` samples, by the machine and by NumPy."""
    rng = np.random.default_rng(0)
    names = ("t", "x", "y", "z")
    data = {name: rng.normal(size=rows) for name in names}
    library = [t for t in small_terms(names, SearchConfig().primitives) if t.args]
    out = []
    for count in NEW:
        batches = [
            [library[k] for k in rng.choice(len(library), count, replace=False)]
            for _ in range(repeats)
        ]
        row: dict[str, float] = {"terms": count}
        for name, kind in (("machine", _Machine), ("numpy", Reference)):
            kind(data).columns(batches[0], keep=False)  # compiled, and its memory at hand
            spent = [_spent(lambda b=b, k=kind: k(data).columns(b, keep=False)) for b in batches]
            row[name] = 1e3 * statistics.median(spent)
        out.append(row)
    return out


def constants(rows: int, repeats: int) -> dict[str, float]:
    """Return milliseconds of a search over the constants of many sets, by both, in turns.

    Sets hold a shape or two with constants up to a third off, beside terms that do not move; the
    largest relative difference of their losses stands beside the times.
    """
    rng = np.random.default_rng(0)
    names = ("t", "x", "z")
    x, z = rng.normal(size=(2, rows))
    data = {"t": np.linspace(0.0, 10.0, rows), "x": x, "z": z}
    y = 3.0 * x + 5.0 * np.sin(2.5 * data["t"] + 0.4) - 2.0 / (x**2 + 1.5) + np.exp(0.3 * z)
    y += 0.3 * rng.normal(size=rows)
    shapes = ("sin({}*t + {})", "1/(x**2 + {})", "exp({}*z)", "sin({}*t)*exp({}*z)")
    still = ("x", "z", "t", "x*z", "x**2", "z**2")
    sets = []
    for k in range(SETS):
        own = [shapes[j % len(shapes)] for j in range(k, k + 1 + k % 2)]
        texts = [shape.format(*rng.uniform(0.3, 3.0, shape.count("{}"))) for shape in own]
        sets.append([parse(text, names) for text in (*still[: k % 7], *texts)])
    spent: dict[str, list[float]] = {"machine": [], "numpy": []}
    losses: dict[str, np.ndarray] = {}
    for turn in range(repeats + 1):
        for name, kind in (("machine", _Machine), ("numpy", Reference)):
            problem = RegressionProblem(y, data, resources=Resources(kind))
            found: list[Any] = []
            seconds = _spent(lambda p=problem, f=found: f.extend(p.refine_many(sets)))
            losses[name] = np.array([loss for _, loss in found])
            if turn:  # the first compiles
                spent[name].append(seconds)
    apart = np.abs(losses["machine"] / losses["numpy"] - 1.0)
    row = {name: 1e3 * statistics.median(own) for name, own in spent.items()}
    return {"sets": SETS, **row, "apart": float(np.max(apart))}


class _Machine(Evaluator):
    """By the compiled machine at any number of samples."""

    def serves(self, terms: int) -> bool:
        return True

    def differentiates(self, sets: int) -> bool:
        return True


def _spent(work: Callable[[], Any]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def _processor(body: dict[str, Any]) -> list[dict[str, Any]]:
    return [clocks["processor"] for clocks in body["rows"].values()]


def _told(rows: int, results: dict[str, dict[str, Any]]) -> None:
    for engine, row in results.items():
        print(
            f"{rows:8d} rows, {engine:6s}: first population {row['first_population']:7.2f} s, "
            f"first generation {row['first_generation']:7.2f} s, a generation "
            f"{row['generation']:7.3f} s, to the exact law {row['exact']:7.2f} s "
            f"({row['found']}/{row['of']})"
        )
    now = results["now"]
    for other in [name for name in results if name != "now"]:
        ratios = {
            k: results[other][k] / now[k] for k in ("first_generation", "generation", "exact")
        }
        text = ", ".join(f"{k.replace('_', ' ')} {v:.2f}" for k, v in ratios.items())
        print(f"{rows:8d} rows, {other} / now: {text}")


def main() -> None:
    """Run in turns, print, and write the file."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.generation", description=__doc__)
    parser.add_argument("--commit", default=BEFORE)
    parser.add_argument("--rows", type=int, nargs="+", default=list(TURNS))
    parser.add_argument("--turns", type=int, help="searches of each engine; fewer of long ones")
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args()
    rows = options.rows
    if options.quick:
        rows, options.turns = [200], 1
    body: dict[str, Any] = {
        "commit_before": options.commit,
        "new_terms": {},
        "constants": {},
        "rows": {},
    }
    with tempfile.TemporaryDirectory() as place:
        keep_compiled(Path(place) / "programs")
        folders = {"numpy": ROOT, "now": ROOT}
        if not options.quick:  # a checkout may lack its history
            old = Path(place) / "old"
            subprocess.run(["git", "clone", "-q", str(ROOT), str(old)], check=True)
            subprocess.run(["git", "-C", str(old), "checkout", "-q", options.commit], check=True)
            folders = {"before": old, **folders}
            turn(old, str(Path(place) / "programs"), "before", 200, 0, (1, 1, 20))  # compiles
        for count in rows:
            body["new_terms"][count] = evaluation(count, 2 if options.quick else 5)
            for row in body["new_terms"][count]:
                print(
                    f"{count:8d} rows, {row['terms']:3d} new terms: machine "
                    f"{row['machine']:8.2f} ms, NumPy {row['numpy']:8.2f} ms"
                )
            row = constants(count, 1 if options.quick else 3)
            body["constants"][count] = row
            print(
                f"{count:8d} rows, constants of {row['sets']} sets: machine {row['machine']:8.1f} "
                f"ms, NumPy {row['numpy']:8.1f} ms, losses {row['apart']:.1e} apart"
            )
            runs: dict[str, list[Any]] = {engine: [] for engine in folders}
            turns = options.turns or TURNS.get(count, 1)
            sizes = (2, 4, 40) if options.quick else (GENERATIONS.get(count, 4), EXACT, 200)
            for seed in range(turns):
                for engine, folder in folders.items():
                    cache = str(Path(place) / "programs")
                    runs[engine].append(turn(folder, cache, engine, count, seed, sizes))
            body["rows"][count] = {
                clock: {engine: summary(done, k) for engine, done in runs.items()}
                for k, clock in enumerate(("processor", "wall"))
            }
            _told(count, body["rows"][count]["processor"])
            if not options.quick:
                seeds = range(max(row["now"]["of"] for row in _processor(body)))
                write("generation", "Time of a generation", seeds, body)


if __name__ == "__main__":
    main()
