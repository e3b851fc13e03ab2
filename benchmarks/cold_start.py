"""Print as JSON what the first evaluation of a process costs, imports apart.

    python -m benchmarks.cold_start TERMS ROWS SEED

Run by benchmarks.throughput in a process of its own, whose environment says where compiled code
is kept; the terms are made before the clock starts.
"""

from __future__ import annotations

import importlib
import json
import sys
import time

import numpy as np


def main(terms: int, rows: int, seed: int) -> None:
    """Time the imports, the first evaluation and the second."""
    began = time.perf_counter()
    jaxsr = importlib.import_module("jaxsr")
    importlib.import_module("jaxsr.evaluation")  # with JAX
    taken = {"import_seconds": time.perf_counter() - began}
    cases = importlib.import_module("benchmarks.throughput_cases")
    cores = importlib.import_module("benchmarks.cores")
    cores.use(cores.CORES)
    population = cases.random_population(np.random.default_rng(seed), terms)
    data = cases.samples(rows)
    for name in ("first_seconds", "second_seconds"):
        began = time.perf_counter()
        jaxsr.compile_terms(population.terms, cases.VARIABLES).evaluate(data)
        taken[name] = time.perf_counter() - began
    print(json.dumps(taken))


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:4]))
