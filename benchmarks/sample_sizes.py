"""Table 2 of the paper: how few clean samples of the two-mass chain still give its law.

    python -m benchmarks.sample_sizes [--quick] [--seeds N]

N samples of states and derivatives, half of them from each of two experiments over 10 s, drawn at
random from 1000: of 20 evenly spaced samples nobody could tell sin(5t) from its alias. e_T and e_V
are RSS/N over the four equations, e_V on another clean experiment of 15 s.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np

import jaxsr
from benchmarks import provenance
from benchmarks.judging import judge, values
from benchmarks.systems import STARTS, TWO_MASS, System, two_mass_unseen, variables
from jaxsr import Recording, Roles, Run

SIZES = (1000, 500, 250, 100, 50, 20)
PAPER = {  # samples: e_T, e_V
    1000: (5.0e-6, 1.1e-4),
    500: (1.6e-6, 9.4e-6),
    250: (6.8e-6, 4.1e-4),
    100: (1.5e-4, 3.8e-4),
    20: (0.0370, 0.0069),
}
SECONDS = 10.0
SYSTEM = System(TWO_MASS)


def experiments(rng: np.random.Generator, samples: int) -> list[Recording]:
    """Return two experiments of ``samples / 2`` samples drawn from 500."""
    every = np.linspace(0.0, SECONDS, 500)
    out = []
    for k, start in enumerate(STARTS):
        t = every[np.sort(rng.choice(len(every), samples // 2, replace=False))]
        out.append(SYSTEM.record(start, t, f"start {k}"))
    return out


def mean_square(laws: dict[str, Any], data: list[Recording]) -> float:
    """Return RSS/N, N samples times equations."""
    squares = []
    for recording in data:
        columns = variables(recording)
        squares += [(columns[f"d{s}"] - values(law, columns)) ** 2 for s, law in laws.items()]
    return float(np.mean(np.concatenate(squares)))


def run(seed: int, samples: int, unseen: Recording) -> dict[str, Any]:
    """Discover the four equations from few samples."""
    data = experiments(np.random.default_rng([seed, samples]), samples)
    began = time.perf_counter()
    found = jaxsr.discover(
        data, Roles(states=SYSTEM.states, derivatives=SYSTEM.derivatives), run=Run(seed=seed)
    )
    seconds = time.perf_counter() - began
    laws = {e.state: e.term for e in found.equations}
    clean = variables(unseen)
    marks = {s: judge(laws[s], TWO_MASS[s], clean) for s in TWO_MASS}
    exact = all(m.exact for m in marks.values())
    return {
        "seed": seed,
        "seconds": seconds,
        "exact": exact,
        "terms": marks["z3"].terms + marks["z4"].terms,
        "constant_error": max(m.error for m in marks.values()) if exact else None,
        "e_T": mean_square(laws, data),
        "e_V": mean_square(laws, [unseen]),
        "expressions": {s: e.expression for s, e in zip(laws, found.equations, strict=True)},
    }


def table(sizes: tuple[int, ...], seeds: int) -> list[dict[str, Any]]:
    """Run and print the table."""
    unseen = two_mass_unseen()
    print("samples  e_T: paper     ours   e_V: paper     ours   exact  constants' error  seconds")
    rows = []
    for samples in sizes:
        runs = [run(seed, samples, unseen) for seed in range(seeds)]
        errors = [r["constant_error"] for r in runs if r["exact"]]
        row = {
            "samples": samples,
            "exact": sum(r["exact"] for r in runs),
            "of": seeds,
            "median_terms": statistics.median(r["terms"] for r in runs),
            "median_e_T": statistics.median(r["e_T"] for r in runs),
            "median_e_V": statistics.median(r["e_V"] for r in runs),
            "median_constant_error": statistics.median(errors) if errors else None,
            "largest_constant_error": max(errors, default=None),
            "median_seconds": statistics.median(r["seconds"] for r in runs),
            "paper": dict(zip(("e_T", "e_V"), PAPER.get(samples, (None, None)), strict=True)),
        }
        paper = [f"{x:8.1e}" if x is not None else "       -" for x in row["paper"].values()]
        largest = row["largest_constant_error"]
        print(
            f"{samples:7d}    {paper[0]} {row['median_e_T']:8.1e}     {paper[1]}"
            f" {row['median_e_V']:8.1e}   {row['exact']:2d}/{seeds:<2d}"
            f"  {'-' if largest is None else format(largest, '.1e'):>15s}"
            f"  {row['median_seconds']:7.1f}",
            flush=True,
        )
        rows.append(row | {"runs": runs})
    return rows


def main() -> None:
    """Run, print, write the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two sizes, one seed, no file")
    parser.add_argument("--seeds", type=int, default=20)
    arguments = parser.parse_args()
    if arguments.quick:
        table((100, 20), 1)
        return
    rows = table(SIZES, arguments.seeds)
    met = all(row["exact"] >= 0.8 * row["of"] for row in rows)
    print("required, the law at every size in 16 of 20: " + ("met" if met else "NOT MET"))
    title = "two-mass chain, clean, few samples (Table 2)"
    body = {"required_met": met, "table": rows}
    provenance.write("sample_sizes", title, range(arguments.seeds), body)


if __name__ == "__main__":
    main()
