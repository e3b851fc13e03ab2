"""A chain of 25 masses, 50 states, a harmonic force on each: the structure of every equation.

    python -m benchmarks.chain [--quick] [--seeds N] [--masses N]

Four clean experiments of 500 samples over 10 s from random starts; states and derivatives given.
The force on every mass has its own frequency and phase, so every acceleration has three or four
terms, two inner constants, and 51 variables to choose from.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np

import jaxsr
from benchmarks import provenance
from benchmarks.judging import judge
from benchmarks.systems import chain, variables
from jaxsr import Recording, Roles, Run

LIMIT = 600.0  # seconds for all equations of one seed
MASSES = 25


def experiments(masses: int, seed: int) -> list[Recording]:
    """Return four experiments from random displacements and velocities."""
    rng = np.random.default_rng([seed, masses])
    system, t = chain(masses), np.linspace(0.0, 10.0, 500)
    return [system.record(rng.normal(size=2 * masses).tolist(), t, f"start {k}") for k in range(4)]


def run(seed: int, masses: int) -> dict[str, Any]:
    """Discover all equations with one seed."""
    system, data = chain(masses), experiments(masses, seed)
    began, used = time.perf_counter(), time.process_time()
    found = jaxsr.discover(
        data,
        Roles(states=system.states, derivatives=system.derivatives),
        run=Run(seed=seed, budget=LIMIT),
    )
    seconds, cpu = time.perf_counter() - began, time.process_time() - used
    clean = variables(data[0])
    marks = {e.state: judge(e.term, system.laws[e.state], clean) for e in found.equations}
    forces = {s: m for s, m in marks.items() if s.startswith("v")}
    wrong = [s for s, m in marks.items() if not m.exact]
    return {
        "seed": seed,
        "seconds": seconds,
        "cpu_seconds": cpu,
        "exact": len(marks) - len(wrong),
        "of": len(marks),
        "exact_accelerations": sum(m.exact for m in forces.values()),
        "largest_constant_error": max((m.error for m in marks.values() if m.exact), default=None),
        "wrong": {e.state: e.expression for e in found.equations if e.state in wrong},
    }


def main() -> None:
    """Run, print, write the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="five masses, nothing written")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--masses", type=int, default=MASSES)
    arguments = parser.parse_args()
    masses = 5 if arguments.quick else arguments.masses
    runs = []
    for seed in range(1 if arguments.quick else arguments.seeds):
        runs.append(run(seed, masses))
        last = runs[-1]
        error = last["largest_constant_error"]
        print(
            f"seed {seed}  {masses} masses: exact {last['exact']}/{last['of']} equations"
            f" ({last['exact_accelerations']}/{masses} accelerations)"
            f"  constants within {'-' if error is None else format(error, '.1e')}"
            f"  {last['seconds']:.0f} s ({last['cpu_seconds']:.0f} s of processor)",
            flush=True,
        )
        for state, text in list(last["wrong"].items())[:5]:
            print(f"    {state}: {text[:200]}")
    if arguments.quick or masses != MASSES:
        return
    summary = {
        "masses": masses,
        "median_exact": statistics.median(r["exact"] for r in runs),
        "of": runs[0]["of"],
        "median_seconds": statistics.median(r["seconds"] for r in runs),
        "within_ten_minutes": all(r["seconds"] < LIMIT for r in runs),
    }
    title = "chain of 25 masses with a harmonic force on each, 2000 clean samples, 50 equations"
    body = {"summary": summary, "runs": runs}
    provenance.write("chain", title, range(arguments.seeds), body)


if __name__ == "__main__":
    main()
