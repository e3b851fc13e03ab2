"""Node-rows per second of raw evaluation, beside pyoperon, gplearn and a naive stack machine.

    python -m benchmarks.throughput [--quick] [--only SECTION ...]

6,000 random terms of 3 to 15 nodes (benchmarks.throughput_cases says how they are drawn; a second
population has no common subexpressions), float32, two cores, the whole library matrix kept. One
node-row is one node of one term at one row: all nodes count, leaves and duplicates too, whatever a
machine saves by sharing them. pyoperon gets the same trees, data and threads; both write into an
array that stays allocated, and are timed in turns; new populations allocate theirs anew. From
100,000 rows on the answer of 6,000 terms would not fit in memory: the first terms are taken, as
many as keep terms x rows below 6e7. The naive machine is vmap(scan(switch)) over postfix arrays;
it and gplearn (our terms as its programs, one thread) are timed on fewer terms where 6,000 would
take minutes. Written: results/throughput.json and throughput.png.
"""

from __future__ import annotations

import argparse
import gc
import importlib.metadata
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import jaxsr
from benchmarks import (
    accuracy,
    cores,
    first_evaluation,
    generations,
    peers,
    provenance,
    scaling,
    throughput_gpu,
)
from benchmarks.naive_stack import NaiveStack
from benchmarks.rounding import reference
from benchmarks.throughput_cases import (
    MIX,
    VARIABLES,
    Population,
    distinct_population,
    random_population,
    samples,
)
from benchmarks.throughput_plots import plot
from benchmarks.timing import alternated, repeated, spread

LARGEST_ANSWER = 60_000_000  # terms x rows: 240 MB in float32
SEED = 0


@dataclass(frozen=True)
class Plan:
    """How much is measured.

    Attributes
    ----------
    terms, repeats, slow_repeats : int
        Repeats are pairs of ours and pyoperon; slow ones are those of the other two peers.
    rows, new_rows, scaling_rows, populations, term_sizes : tuple of int
        `new_rows` are those at which new populations are timed.
    agreement_rows : int
    slow_answer : int
        Terms x rows that gplearn and the naive machine evaluate at most.
    population, generations : int
        Of the search whose generations are timed, on 1,000 samples.
    memory_samples : int
        Length of the recording whose memory is measured; zero for none.
    """

    terms: int = 6000
    repeats: int = 15
    slow_repeats: int = 5
    rows: tuple[int, ...] = (250, 1_000, 10_000, 100_000, 1_000_000)
    new_rows: tuple[int, ...] = (1_000, 10_000)
    scaling_rows: tuple[int, ...] = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
    populations: tuple[int, ...] = (100, 300, 1_000, 3_000, 6_000, 20_000)
    term_sizes: tuple[int, ...] = (3, 5, 7, 11, 15, 23, 31)
    agreement_rows: int = 1_000
    slow_answer: int = 6_000_000
    population: int = 600
    generations: int = 10
    memory_samples: int = 1_000_000


QUICK = Plan(
    repeats=7,
    slow_repeats=3,
    rows=(250, 1_000, 10_000),
    new_rows=(1_000,),
    scaling_rows=(1_000, 10_000, 100_000),
    populations=(300, 3_000),
    term_sizes=(3, 15),
    agreement_rows=100,
    slow_answer=600_000,
    population=60,
    generations=2,
    memory_samples=0,
)


def populations(plan: Plan) -> list[Population]:
    """Return the random population and the one without common subtrees."""
    rng = np.random.default_rng(SEED)
    return [random_population(rng, plan.terms), distinct_population(rng, plan.terms)]


def raw(plan: Plan) -> dict[str, Any]:
    """Evaluate both populations at every number of rows, by every machine."""
    runs = []
    for population in populations(plan):
        for rows in plan.rows:
            repeats = plan.repeats if rows < 1_000_000 else max(5, plan.repeats // 2)
            runs.append(_beside_operon(population, rows, repeats))
            if population.name == "random":
                runs[-1] |= _beside_slow_peers(population, rows, plan)
            _print_run(runs[-1])
            gc.collect()
    return {"runs": runs}


def _beside_operon(population: Population, rows: int, repeats: int) -> dict[str, Any]:
    part = population.first(LARGEST_ANSWER // rows)
    data = samples(rows)
    batch = jaxsr.compile_terms(part.terms, VARIABLES)
    head = {"population": part.name, "rows": rows, "terms": len(part.terms), "nodes": part.nodes}
    work = part.nodes * rows
    theta = np.zeros(
        (len(part.terms), rows), np.float32
    ).T  # pyoperon keeps its answer's memory too
    if absent := peers.missing("pyoperon"):
        times = np.array(repeated(lambda: batch.evaluate(data, out=theta), repeats))
        return head | {"ours": asdict(spread(work / times)), "pyoperon": absent}
    operon = peers.OperonTrees(part.terms, VARIABLES, data)
    return head | alternated(
        lambda: batch.evaluate(data, out=theta), lambda: operon.evaluate(cores.CORES), repeats
    ).document(work, "pyoperon")


def _beside_slow_peers(population: Population, rows: int, plan: Plan) -> dict[str, Any]:
    """Time the naive machine and gplearn on as many terms as a moment allows."""
    data, out = samples(rows), {}
    answer, repeats = plan.slow_answer, plan.slow_repeats
    naive = population.first(max(12, answer // rows))
    machine = NaiveStack(naive.terms, VARIABLES)
    out["naive"] = _rate(naive, rows, lambda: machine.evaluate(data), repeats)
    if absent := peers.missing("gplearn"):
        return out | {"gplearn": absent}
    part = population.first(max(12, answer // rows))
    programs = peers.GplearnPrograms(part.terms, VARIABLES)
    return out | {"gplearn": _rate(part, rows, lambda: programs.evaluate(data), repeats)}


def _rate(
    part: Population, rows: int, call: Callable[[], object], repeats: int
) -> dict[str, float | int]:
    rates = part.nodes * rows / np.array(repeated(call, repeats))
    return {"terms": len(part.terms), **asdict(spread(rates))}


def _print_run(run: dict[str, Any]) -> None:
    rates = [
        f"{name} {run[name]['median'] / 1e9:6.3f}"
        for name in ("ours", "pyoperon", "gplearn", "naive")
        if isinstance(run.get(name), dict)
    ]
    times, ratio = "", run.get("paired_ratio")
    if ratio is not None:
        middle, low, high = (ratio[k] for k in ("median", "quartile_1", "quartile_3"))
        times = f"  x pyoperon {middle:.2f} [{low:.2f}, {high:.2f}]"
    print(
        f"{run['population']:9}{run['rows']:8} rows {run['terms']:5} terms  G node-rows/s: "
        f"{', '.join(rates)}{times}",
        flush=True,
    )


def agreement(plan: Plan) -> dict[str, Any]:
    """Compare ours with pyoperon and with float64, value by value."""
    out: dict[str, Any] = {"rows": plan.agreement_rows}
    data = samples(plan.agreement_rows, SEED + 1)
    for population in populations(plan):
        truth = reference(population.terms, VARIABLES, data)
        ours = jaxsr.compile_terms(population.terms, VARIABLES).evaluate(data).T
        found = {"ours_to_float64": truth.compare(ours)}
        if not peers.missing("pyoperon"):
            theirs = peers.OperonTrees(population.terms, VARIABLES, data).evaluate()
            found["pyoperon_to_float64"] = truth.compare(theirs)
            found["ours_to_pyoperon"] = truth.compare_two(ours, theirs)
        for name, facts in found.items():
            print(
                f"{population.name:9}{name:20} within 1e-5: {facts['share_within_tolerance']:.4%};"
                f" largest where float32 can be {facts['largest_relative_where_float32_can']:.1e};"
                f" beyond rounding {facts['beyond_the_rounding_bound']}; finite in one only"
                f" {facts['finite_in_one_only']},"
                f" {facts['finite_in_one_only_where_float32_decides']} unexplained",
                flush=True,
            )
        out[population.name] = found
    return out


def sharing(plan: Plan) -> dict[str, Any]:
    """State the share of unique inner nodes of both populations."""
    out = {}
    for population in populations(plan):
        fraction = population.unique_fraction
        mean = population.nodes / len(population.terms)
        print(
            f"{population.name:9}{len(population.terms)} terms, {population.nodes} nodes "
            f"({mean:.1f} a term), {fraction:.1%} of the inner nodes are unique"
        )
        out[population.name] = {
            "terms": len(population.terms),
            "nodes": population.nodes,
            "unique_inner_nodes": fraction,
        }
    return out


def generation(plan: Plan) -> dict[str, Any]:
    """Time fitness passes and whole generations on three engines; measure a long one's memory."""
    repeats = min(3, plan.slow_repeats)
    out = generations.compare_engines(plan.population, 1_000, plan.generations, SEED, repeats)
    for name, ratio in out["ratios"].items():
        print(f"{name}: {ratio['median']:.1f} [{ratio['least']:.1f}, {ratio['largest']:.1f}]")
    if plan.memory_samples:
        out["memory"] = generations.memory(plan.memory_samples)
        print(
            f"{plan.memory_samples} samples: {out['memory']['peak_bytes'] / 2**30:.2f} GiB at most"
        )
    return out


SECTIONS: dict[str, Callable[[Plan], dict[str, Any]]] = {
    "sharing": sharing,
    "raw": raw,
    "agreement": agreement,
    "accuracy": lambda plan: accuracy.measure(SEED),
    "new_population": lambda plan: first_evaluation.new_populations(
        plan.terms, plan.new_rows, plan.repeats
    ),
    "cold": lambda plan: first_evaluation.cold(plan.terms),
    "scaling": lambda plan: {
        "rows": scaling.in_rows(plan.scaling_rows, plan.slow_repeats),
        "population": scaling.in_population(plan.populations, plan.slow_repeats),
        "term_size": scaling.in_term_size(plan.term_sizes, plan.slow_repeats),
    },
    "generation": generation,
    "gpu": lambda plan: throughput_gpu.measure(plan.terms, plan.rows[-3:], plan.slow_repeats),
}


def main() -> None:
    """Run, print, write the result and the figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="within a minute, nothing written")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, help="sections; nothing written")
    arguments = parser.parse_args()
    threads = cores.use(cores.CORES)
    plan, body = QUICK if arguments.quick else Plan(), {}
    for name in arguments.only or SECTIONS:
        print(f"- {name.replace('_', ' ')}", flush=True)
        body[name] = SECTIONS[name](plan)
    if arguments.quick or arguments.only:
        return
    title = "throughput of raw evaluation, float32, the library matrix kept"
    setting = {"threads": threads, "unit": "node-rows/s, duplicates counted", "terms": MIX}
    if not peers.missing("gplearn"):
        setting["gplearn"] = importlib.metadata.version("gplearn")
    provenance.write("throughput", title, [SEED], {"setting": setting, **body})
    plot(body, provenance.RESULTS / "throughput.png")


if __name__ == "__main__":
    main()
