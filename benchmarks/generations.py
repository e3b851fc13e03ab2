"""Individuals per second of a generation, on three engines, and the memory of a long one.

A generation is what happens to a population after its children are made: evaluation, ridge
regression, hard threshold of the best set, fitness, Pareto front. The sequence of children is
recorded once from a search for the acceleration of the first mass (section 7.1), and every engine
goes through the same sequence:

- "columns": as a search runs, columns and their products kept from generation to generation;
- "columns without cache": each generation begins with nothing kept; inside it each unique subtree
  is still evaluated once, and each product taken once;
- "interpreter": the same, the unique terms evaluated by the vmapped postfix stack machine.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.systems import two_mass, variables
from jaxsr.evaluation import Evaluator, compile_terms
from jaxsr.evolution import SearchConfig, init
from jaxsr.evolution.breed import breed
from jaxsr.evolution.fitness import fitness, next_state
from jaxsr.evolution.loop import step, weigh
from jaxsr.evolution.state import SearchState
from jaxsr.expressions import Term
from jaxsr.expressions.editing import edit
from jaxsr.regression import RegressionProblem, Resources

Engine = Literal["columns", "columns without cache", "interpreter"]
Sets = list[tuple[Term, ...]]
ENGINES: tuple[Engine, ...] = ("columns", "columns without cache", "interpreter")
SETTLING = 5  # generations before the recorded ones
ROOT = Path(__file__).resolve().parents[1]


class Interpreted(Evaluator):
    """Evaluate terms on the vmapped stack machine."""

    def columns(self, terms: Sequence[Term], *, keep: bool = True) -> np.ndarray:
        """Return the columns (samples, terms)."""
        batch = compile_terms(list(terms), list(self.variables))
        return batch.evaluate(np.column_stack(list(self.variables.values())), "interpreter")

    def reduced(
        self, terms: Sequence[Term], use: Callable[[Any, slice], Any], samples: int | None = None
    ) -> list[Any]:
        """Return what ``use`` makes of the columns."""
        columns = np.ascontiguousarray(self.columns(terms).T)
        return [use(columns, slice(0, columns.shape[1]))]


def two_mass_problem(samples: int, engine: Engine) -> RegressionProblem:
    """Return the regression of z3' on time and states."""
    parts = [variables(recording) for recording in two_mass(samples)]
    columns = {n: np.concatenate([p[n] for p in parts]) for n in ("t", "z1", "z2", "z3", "z4")}
    target = np.concatenate([p["dz3"] for p in parts])
    evaluator = Interpreted if engine == "interpreter" else Evaluator
    return RegressionProblem(target, columns, resources=Resources(evaluator))


@dataclass(frozen=True)
class Course:
    """A recorded search: the state before the first generation, and each one's children."""

    start: SearchState
    children: tuple[Sets, ...]


def recorded(population: int, samples: int, generations: int, seed: int) -> Course:
    """Run a search and record the edited children of its later generations.

    Constants are left to mutation, so that the search goes on and a generation holds nothing else.
    """
    rng = np.random.default_rng(seed)
    config = SearchConfig(population=population, refined=0)
    problem = two_mass_problem(samples, "columns")
    state = init(rng, problem, config)
    for _ in range(SETTLING):
        state, _ = step(rng, state, problem)
    start, children = state, []
    for _ in range(generations):
        made = breed(
            rng, state.population, state.front, problem, config, state.generation + 1, state.rule
        )
        children.append([edit(terms) for terms in made][:population])
        state = generation(state, children[-1], problem)
    return Course(start, tuple(children))


def generation(state: SearchState, children: Sets, problem: RegressionProblem) -> SearchState:
    """Evaluate, weigh, threshold and rank one generation."""
    config = state.config
    newborn = weigh(problem, children, config)
    elite = state.population[: max(2, int(config.elite * config.population))]
    pruned = weigh(problem, problem.prune_many([ind.terms for ind in elite]), config)
    pool = list({frozenset(i.terms): i for i in (*elite, *pruned, *newborn)}.values())
    order = np.argsort(fitness(pool, state.rule, config.fitness, problem), kind="stable")
    ranked = [pool[k] for k in order]
    number = state.generation + 1
    return replace(
        state,
        generation=number,
        population=tuple(ranked[: config.population]),
        front=state.front.with_(ranked),
        rule=next_state(state.rule, config.fitness, ranked[: len(elite)], number, problem),
    )


def _seconds(work: Callable[[], Any]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def replayed(course: Course, engine: Engine, samples: int) -> tuple[list[float], list[float]]:
    """Return seconds of each generation, and of each fitness-only pass, in steady state.

    The course is gone through once to compile and, where columns are kept, to settle: then the
    generations before the recorded ones stand in the store, the recorded ones do not.
    """
    problem = two_mass_problem(samples, engine)
    if engine == "interpreter":  # shapes are compiled before the clock runs
        _go_through(course, problem, keeps=False)
    problem.forget()
    problem.solve([individual.terms for individual in course.start.population])
    whole = _go_through(course, problem, keeps=engine == "columns")
    problem.forget()
    problem.solve([individual.terms for individual in course.start.population])
    passes = []
    for children in course.children:
        if engine != "columns":
            problem.forget()
        usable = [terms for terms in children if terms]
        passes.append(_seconds(lambda sets=usable: problem.solve(sets)))
    return whole, passes


def _go_through(course: Course, problem: RegressionProblem, keeps: bool) -> list[float]:
    state, out = course.start, []
    for children in course.children:
        if not keeps:
            problem.forget()
        began = time.perf_counter()
        state = generation(state, children, problem)
        out.append(time.perf_counter() - began)
    return out


def _rates(seconds: Sequence[float], individuals: Sequence[int]) -> dict[str, float]:
    rates = [n / s for n, s in zip(individuals, seconds, strict=True)]
    low, median, high = np.quantile(rates, [0.25, 0.5, 0.75])
    return {"median": float(median), "low": float(low), "high": float(high)}


def generation_rates(
    engine: Engine,
    population: int = 600,
    samples: int = 1000,
    generations: int = 10,
    seed: int = 0,
    course: Course | None = None,
) -> dict[str, Any]:
    """Return individuals per second of one engine: median and quartiles over generations."""
    course = course or recorded(population, samples, generations, seed)
    whole, passes = replayed(course, engine, samples)
    counts = [len(children) for children in course.children]
    return {
        "engine": engine,
        "population": population,
        "samples": samples,
        "generations": len(counts),
        "seed": seed,
        "unique_terms": statistics.median(len(set().union(*c)) for c in course.children),
        "generation": _rates(whole, counts),
        "fitness_only": _rates(passes, counts),
    }


def compare_engines(
    population: int = 600,
    samples: int = 1000,
    generations: int = 10,
    seed: int = 0,
    repeats: int = 3,
) -> dict[str, Any]:
    """Return the rates of all engines, in alternation, and the ratios to the first.

    A ratio is the median over repeats of the ratio of medians; its spread is from the least to
    the largest.
    """
    course = recorded(population, samples, generations, seed)
    runs: dict[str, list[dict[str, Any]]] = {engine: [] for engine in ENGINES}
    for _ in range(repeats):
        for engine in ENGINES:
            run = generation_rates(engine, population, samples, generations, seed, course)
            runs[engine].append(run)
    ratios = {}
    for what in ("generation", "fitness_only"):
        for other in ENGINES[1:]:
            pairs = zip(runs["columns"], runs[other], strict=True)
            found = [a[what]["median"] / b[what]["median"] for a, b in pairs]
            ratios[f"{what}: columns / {other}"] = {
                "median": statistics.median(found),
                "least": min(found),
                "largest": max(found),
            }
    return {"runs": runs, "ratios": ratios}


def memory(
    samples: int = 1_000_000,
    population: int = 1000,
    limit_bytes: int = 512 * 2**20,
    generations: int = 1,
) -> dict[str, Any]:
    """Return peak memory and seconds of a search's generations on long samples of 6 variables.

    Measured in a process of its own: the largest resident set, the interpreter and the data
    included.
    """
    code = (
        "import json; from benchmarks.generations import long_search; "
        f"print(json.dumps(long_search({samples}, {population}, {limit_bytes}, {generations})))"
    )
    command = [sys.executable, "-c", code]
    answer = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    return json.loads(answer.stdout.splitlines()[-1])


def long_search(
    samples: int, population: int, limit_bytes: int, generations: int
) -> dict[str, Any]:
    """Create a population and run generations of the paper's settings, and measure this process."""
    import resource

    rng = np.random.default_rng(0)
    data = {f"x{k}": rng.normal(size=samples) for k in range(6)}
    target = 3.0 * data["x0"] - data["x1"] * data["x2"] + np.sin(2.0 * data["x3"])
    target += 0.1 * rng.normal(size=samples)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    problem = RegressionProblem(target, data, resources=Resources(limit_bytes=limit_bytes))
    began = time.perf_counter()
    state = init(rng, problem, SearchConfig.paper(population))
    created = time.perf_counter() - began
    seconds = []
    for _ in range(generations):
        began = time.perf_counter()
        state, _ = step(rng, state, problem)
        seconds.append(time.perf_counter() - began)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    scale = 1 if sys.platform == "darwin" else 1024  # bytes there, KiB elsewhere
    return {
        "samples": samples,
        "population": len(state.population),
        "limit_bytes": limit_bytes,
        "before_bytes": before * scale,
        "peak_bytes": peak * scale,
        "seconds_to_create": created,
        "seconds_of_a_generation": seconds,
        "best_loss": state.front.best_loss,
    }
