"""Cost against rows, number of terms and size of terms, beside pyoperon."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

import jaxsr
from benchmarks import cores, peers
from benchmarks.throughput_cases import VARIABLES, Population, random_population, samples
from benchmarks.timing import exponent, seconds, spread

BOUND = 1.05
FEW_TERMS = 60  # whose answer fits in memory at a million rows
NODES, ROWS = 54_000, 1_000


def in_rows(rows: Sequence[int], repeats: int) -> dict[str, Any]:
    """Evaluate the same terms on more and more rows; fit seconds = c rows^p."""
    population = random_population(np.random.default_rng(0), FEW_TERMS)
    points = _measure([(population, n) for n in rows], repeats)
    out: dict[str, Any] = {"terms": FEW_TERMS, "bound": BOUND, "points": points}
    for name in ("ours", "pyoperon"):
        if name in points[0]:
            times = [point[name]["median"] for point in points]
            out[f"exponent_{name}"] = exponent(rows, times)
            steps = zip(rows, rows[1:], times, times[1:], strict=False)
            # a cache that overflows shows in one step before it shows in the whole
            out[f"steepest_step_{name}"] = max(exponent(s[:2], s[2:]) for s in steps)
            print(
                f"rows {rows[0]} ... {rows[-1]}: {name} exponent {out[f'exponent_{name}']:.3f}"
                f" (bound {BOUND}), steepest step {out[f'steepest_step_{name}']:.3f}",
                flush=True,
            )
    return out


def in_population(numbers: Sequence[int], repeats: int) -> dict[str, Any]:
    """Evaluate more and more terms at 1,000 rows."""
    rng = np.random.default_rng(0)
    points = _measure([(random_population(rng, n), ROWS) for n in numbers], repeats)
    _print("terms", zip(numbers, points, strict=True))
    return {"rows": ROWS, "points": points}


def in_term_size(sizes: Sequence[int], repeats: int) -> dict[str, Any]:
    """Evaluate terms of one size, as many as hold about 54,000 nodes, at 1,000 rows."""
    rng = np.random.default_rng(0)
    cases = [(random_population(rng, NODES // size, [size]), ROWS) for size in sizes]
    points = _measure(cases, repeats)
    _print("nodes a term", zip(sizes, points, strict=True))
    return {"rows": ROWS, "points": [{"size": s} | p for s, p in zip(sizes, points, strict=True)]}


def _measure(cases: Iterable[tuple[Population, int]], repeats: int) -> list[dict[str, Any]]:
    """Return seconds for every case; a repeat takes ours, then pyoperon's."""
    points = []
    for population, rows in cases:
        calls = _calls(population, rows)
        for call in calls.values():
            call()
        times = [[seconds(call) for call in calls.values()] for _ in range(repeats)]
        spreads = (asdict(spread(column)) for column in np.array(times).T)
        points.append(
            {"rows": rows, "terms": len(population.terms), "nodes": population.nodes}
            | dict(zip(calls, spreads, strict=True))
        )
    return points


def _calls(population: Population, rows: int) -> dict[str, Callable[[], object]]:
    data = samples(rows)
    batch = jaxsr.compile_terms(population.terms, VARIABLES)
    calls: dict[str, Callable[[], object]] = {"ours": lambda: batch.evaluate(data)}
    if not peers.missing("pyoperon"):
        operon = peers.OperonTrees(population.terms, VARIABLES, data)
        calls["pyoperon"] = lambda: operon.evaluate(cores.CORES)
    return calls


def _print(what: str, points: Iterable[tuple[int, dict[str, Any]]]) -> None:
    for number, point in points:
        rates = (
            f"{name} {point['nodes'] * point['rows'] / point[name]['median'] / 1e9:.3f}"
            for name in ("ours", "pyoperon")
            if name in point
        )
        print(f"{number:6} {what}: {', '.join(rates)} G node-rows/s", flush=True)
