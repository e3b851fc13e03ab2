"""Crank-slider (paper section 7.2): is the rational law found in a form equal to the truth?

    python -m benchmarks.crank_slider [--quick] [--seeds N]

L1 = 1 m, L2 = 1.5 m, w = 20 rad/s; 1000 clean samples of z1 and z1' over 2 s, terminals t, z1,
constants. A form counts as found if something that varies stands in a denominator, it has at most
three terms, and it equals the truth within 1e-3 of its rms on a fine grid twice as long as the
training data; a Fourier series of as small an error does not count. Then L2/L1 is swept.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np

import jaxsr
from benchmarks import peers, provenance
from benchmarks.judging import form, is_rational, relative_error
from benchmarks.systems import CrankSlider, noisy, variables
from jaxsr import Roles, Run
from jaxsr.expressions import Term, parse, to_sympy
from jaxsr.regression import RegressionProblem, coefficient_ci95, constant_slopes

TRAINING = np.linspace(0.0, 2.0, 1000)
FINE = np.linspace(0.0, 4.0, 40001)
MOST_TERMS = 3
EQUAL = 1e-3
RATIOS = (1.5, 2.0, 3.0, 4.0, 6.0)
DECIBELS = (60.0, 40.0)  # noise of the sweep
PEER_SECONDS = 20.0
PAPER = {"mean_rss": 4.95e-3, "terms": 2, "generations": 233}


def mark(expression: Any, system: CrankSlider) -> dict[str, Any]:
    """Say of a right-hand side whether it is the law."""
    fine = variables(system.record(FINE))
    few = form(expression)
    terms = few.terms if few is not None else -1
    error = relative_error(expression, fine, fine["dz1"])
    rational = is_rational(expression)
    return {
        "found": bool(rational and 0 < terms <= MOST_TERMS and error <= EQUAL),
        "rational": rational,
        "terms": terms,
        "relative_error": error,
        "mean_rss": float((error**2) * np.mean(fine["dz1"] ** 2)),
    }


def run(seed: int, system: CrankSlider, decibels: float | None = None) -> dict[str, Any]:
    """Discover the law with one seed."""
    data = system.record(TRAINING)
    if decibels is not None:
        data = noisy(np.random.default_rng([seed, round(decibels)]), data, decibels)
    began = time.perf_counter()
    found = jaxsr.discover([data], Roles(states=["z1"], derivatives=["dz1"]), run=Run(seed=seed))
    seconds = time.perf_counter() - began
    equation = found.equations[0]
    return {
        "seed": seed,
        "seconds": seconds,
        **mark(to_sympy(equation.term), system),
        "expression": equation.expression,
        "widest_relative_interval": max(
            ((t.ci95[1] - t.ci95[0]) / abs(t.coefficient) for t in equation.terms if t.coefficient),
            default=None,
        ),
    }


def operon(seed: int, system: CrankSlider, seconds: float) -> dict[str, Any]:
    """Run pyoperon on the same data."""
    data = variables(system.record(TRAINING))
    columns = {name: data[name] for name in ("t", "z1")}
    answer = peers.operon(columns, data["dz1"], seed, seconds)
    return {
        "seed": seed,
        "seconds": answer.seconds,
        **mark(answer.expression, system),
        "expression": str(answer.expression),
    }


def interval(system: CrankSlider, decibels: float, seed: int) -> dict[str, float]:
    """Estimate the constants of the true form, a sin(2wt)/sqrt(c + cos(2wt)), with intervals.

    Where the interval of the rational term's coefficient holds more than its own value, the law
    cannot be told from -w L1 sin(wt) + a' sin(2wt) by these data.
    """
    data = noisy(np.random.default_rng([seed, 7]), system.record(TRAINING), decibels)
    w, squared = system.w, 2.0 * (system.rod / system.crank) ** 2 - 1.0
    terms: list[Term] = [
        parse(f"sin({w}*t)"),
        parse(f"sin({2.0 * w}*t)/sqrt({squared} + cos({2.0 * w}*t))"),
    ]
    problem = RegressionProblem(data.channel("dz1"), {"t": data.time})
    terms = list(problem.refine(terms)[0])
    fit = problem.fit(terms)
    theta = problem.projected(fit.terms)
    slopes = constant_slopes(problem, fit.terms, fit.coefficients)
    padded = np.concatenate([fit.coefficients, np.zeros(slopes.shape[1])])
    residual = problem.y - theta @ fit.coefficients
    ends = coefficient_ci95(np.hstack([theta, slopes]), residual, padded)
    place = next(k for k, term in enumerate(fit.terms) if is_rational(term))
    true = -system.w * system.crank / np.sqrt(2.0)
    return {
        "true": float(true),
        "coefficient": float(fit.coefficients[place]),
        "low": float(ends[place][0]),
        "high": float(ends[place][1]),
        "relative_half_width": float((ends[place][1] - ends[place][0]) / 2.0 / abs(true)),
    }


def sweep(seeds: int) -> list[dict[str, Any]]:
    """Return, for every L2/L1, what is found in clean data and what intervals say in noise."""
    rows = []
    for ratio in RATIOS:
        system = CrankSlider(rod=ratio)
        runs = [run(seed, system) for seed in range(seeds)]
        row: dict[str, Any] = {
            "ratio": ratio,
            "clean_found": sum(r["found"] for r in runs),
            "of": seeds,
            "clean_expressions": [r["expression"] for r in runs],
            "noise": [],
        }
        for decibels in DECIBELS:
            rough = [run(seed, system, decibels) for seed in range(seeds)]
            fixed = [interval(system, decibels, seed) for seed in range(20)]
            width = statistics.median(f["relative_half_width"] for f in fixed)
            row["noise"].append(
                {
                    "decibels": decibels,
                    "found": sum(r["found"] for r in rough),
                    "rational": sum(r["rational"] for r in rough),
                    "expressions": [r["expression"] for r in rough],
                    "median_relative_error": statistics.median(r["relative_error"] for r in rough),
                    "true_form_relative_half_width": width,
                    "true_form_covered_of_20": sum(
                        f["low"] <= f["true"] <= f["high"] for f in fixed
                    ),
                }
            )
        rows.append(row)
        noise = "; ".join(
            f"{n['decibels']:.0f} dB: found {n['found']}/{seeds}, coefficient of the rational term "
            f"+-{100 * n['true_form_relative_half_width']:.2g} % "
            f"(covers {n['true_form_covered_of_20']}/20)"
            for n in row["noise"]
        )
        print(f"L2/L1 {ratio}: clean {row['clean_found']}/{seeds}; {noise}", flush=True)
    return rows


def table(name: str, runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Summarise and print one method."""
    summary = {
        "found": sum(r["found"] for r in runs),
        "rational": sum(r["rational"] for r in runs),
        "of": len(runs),
        "mean_rss": statistics.fmean(r["mean_rss"] for r in runs),
        "median_rss": statistics.median(r["mean_rss"] for r in runs),
        "median_terms": statistics.median(r["terms"] for r in runs),
        "median_seconds": statistics.median(r["seconds"] for r in runs),
    }
    print(
        f"{name:8s} found {summary['found']}/{len(runs)}, mean RSS {summary['mean_rss']:.1e}, "
        f"median terms {summary['median_terms']:.0f}, median {summary['median_seconds']:.1f} s",
        flush=True,
    )
    return summary


def main() -> None:
    """Run, print, write the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two seeds, nothing written")
    parser.add_argument("--seeds", type=int, default=20)
    arguments = parser.parse_args()
    seeds = range(2 if arguments.quick else arguments.seeds)
    system = CrankSlider()
    runs = []
    for seed in seeds:
        runs.append(run(seed, system))
        last = runs[-1]
        print(
            f"seed {seed:2d}  found {last['found']!s:5}  terms {last['terms']}  "
            f"mean RSS {last['mean_rss']:.1e}  {last['seconds']:.1f} s  {last['expression']}",
            flush=True,
        )
    body: dict[str, Any] = {"summary": {"jaxsr": table("jaxsr", runs), "paper": PAPER}}
    absent = peers.missing("pyoperon")
    beside: list[dict[str, Any]] = []
    if absent:
        body["summary"]["pyoperon"] = absent
        print(f"pyoperon {absent}")
    else:
        count, limit = (1, 3.0) if arguments.quick else (3, PEER_SECONDS)
        beside = [operon(seed, system, limit) for seed in range(count)]
        body["summary"]["pyoperon"] = table("pyoperon", beside)
    if arguments.quick:
        return
    body |= {"sweep": sweep(3), "runs": runs, "pyoperon_runs": beside}
    title = "crank-slider, 1000 clean samples over 2 s, judged over 4 s"
    provenance.write("crank_slider", title, seeds, body)


if __name__ == "__main__":
    main()
