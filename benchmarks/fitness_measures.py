"""The three fitness measures of the paper (adaptive Eq. 9, AIC, BIC) drive the same search.

    python -m benchmarks.fitness_measures [--quick] [--seeds N]

Both accelerations of the two-mass chain, clean and at 30 dB. The answer is the fittest individual
of the last population, as in the paper, not the later choice among the front. Two settings: those
of this package, and those of the paper's section 6 (population 600, constants by mutation alone).
"""

from __future__ import annotations

import argparse
import dataclasses
import statistics
import time
from typing import Any

import numpy as np

from benchmarks import provenance
from benchmarks.judging import judge, relative_error
from benchmarks.systems import TWO_MASS, noisy, two_mass, two_mass_unseen, variables
from jaxsr.discovery.equation import weighted_sum
from jaxsr.evolution import FitnessRule, SearchConfig, search
from jaxsr.expressions import to_text
from jaxsr.regression import RegressionProblem

MEASURES = ("adaptive", "aic", "bic")
SECONDS = 30.0  # for one equation
ACCELERATIONS = ("z3", "z4")


def with_measure(config: SearchConfig, measure: str) -> SearchConfig:
    """Return the settings with another measure."""
    rule = dataclasses.replace(config.fitness, measure=measure)
    return dataclasses.replace(config, fitness=rule)


def settings() -> dict[str, SearchConfig]:
    """Return the two settings by name; the paper runs 100 generations."""
    paper = dataclasses.replace(SearchConfig.paper(), generations=100)
    return {"this package": SearchConfig(), "paper, section 6": paper}


def run(
    seed: int,
    config: SearchConfig,
    decibels: float | None,
    seconds: float,
    states: tuple[str, ...] = ACCELERATIONS,
) -> dict[str, Any]:
    """Search the accelerations; return what the fittest individuals are worth."""
    data = two_mass()
    if decibels is not None:
        rng = np.random.default_rng([seed, 11])
        data = [noisy(rng, recording, decibels) for recording in data]
    parts = [variables(recording) for recording in data]
    columns = {n: np.concatenate([p[n] for p in parts]) for n in ("t", *TWO_MASS)}
    clean = variables(two_mass_unseen())
    began = time.perf_counter()
    marks, errors, texts, generations = [], [], {}, 0
    for place, state in enumerate(states):
        y = np.concatenate([p[f"d{state}"] for p in parts])
        problem = RegressionProblem(y, columns)
        rng = np.random.default_rng([seed, place])
        found, _ = search(rng, problem, config, budget=seconds)
        fit = problem.fit(found.population[0].terms)
        law = weighted_sum(fit.terms, fit.coefficients.tolist())
        marks.append(judge(law, TWO_MASS[state], clean))
        errors.append(relative_error(law, clean, clean[f"d{state}"]))
        texts[state] = to_text(law)
        generations += found.generation
    return {
        "seed": seed,
        "exact": all(m.exact for m in marks),
        "terms": sum(m.terms for m in marks),
        "unseen_error": max(errors),
        "generations": generations,
        "seconds": time.perf_counter() - began,
        "fittest": texts,
    }


def quick() -> None:
    """Search one clean equation with each measure for a few seconds."""
    for measure in MEASURES:
        row = run(0, with_measure(SearchConfig(), measure), None, 5.0, ("z3",))
        print(
            f"{measure:8s} exact {row['exact']}  {row['generations']} generations  {row['fittest']}"
        )


def table(seeds: int, seconds: float, names: list[str]) -> list[dict[str, Any]]:
    """Run and print every combination."""
    rows = []
    print("settings          noise  measure   exact  terms  error on unseen  generations  seconds")
    for name in names:
        for decibels in (None, 30.0):
            for measure in MEASURES:
                config = with_measure(settings()[name], measure)
                runs = [run(seed, config, decibels, seconds) for seed in range(seeds)]
                keys = ("terms", "unseen_error", "generations", "seconds")
                row = {
                    "settings": name,
                    "decibels": decibels,
                    "measure": measure,
                    "exact": sum(r["exact"] for r in runs),
                    "of": seeds,
                } | {f"median_{key}": statistics.median(r[key] for r in runs) for key in keys}
                noise = "clean" if decibels is None else f"{decibels:.0f} dB"
                print(
                    f"{name:17s} {noise:5s}  {measure:8s}  {row['exact']:2d}/{seeds:<2d}"
                    f"  {row['median_terms']:5.0f}  {row['median_unseen_error']:15.1e}"
                    f"  {row['median_generations']:11.0f}  {row['median_seconds']:7.1f}",
                    flush=True,
                )
                rows.append(row | {"runs": runs})
    return rows


def main() -> None:
    """Run, print, write the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one equation, nothing written")
    parser.add_argument("--seeds", type=int, default=5)
    arguments = parser.parse_args()
    if "measure" not in {f.name for f in dataclasses.fields(FitnessRule)}:
        print("this version has one fitness measure")
        return
    if arguments.quick:
        quick()
        return
    rows = table(arguments.seeds, SECONDS, list(settings()))
    title = "fitness measures: adaptive (Eq. 9), AIC, BIC on the two-mass chain"
    body = {"seconds_an_equation": SECONDS, "table": rows}
    provenance.write("fitness_measures", title, range(arguments.seeds), body)


if __name__ == "__main__":
    main()
