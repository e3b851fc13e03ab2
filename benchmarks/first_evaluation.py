"""What a new population costs before it runs at full speed, and a new process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import jaxsr
from benchmarks.throughput_cases import VARIABLES, Population, random_population, samples
from benchmarks.timing import seconds, spread
from jaxsr.evaluation.machine import compilations
from jaxsr.expressions import to_text
from jaxsr.expressions.postfix import compile_postfix

ROOT = Path(__file__).resolve().parents[1]
STRING_NODES = 15


def new_populations(terms: int, rows: Sequence[int], repeats: int) -> dict[str, Any]:
    """Compile and evaluate populations not seen before, of one shape bucket.

    Each repeat takes a repeated evaluation, then ``compile_terms`` and the first ``evaluate`` of
    one new population from terms, and of another from postfix arrays.
    """
    out: dict[str, Any] = {}
    for number in rows:
        found = _at(number, terms, repeats)
        out[f"{number}_rows"] = found
        print(
            f"{number:6} rows: repeated {found['repeated']['median']:.3f} s; new from terms "
            f"{found['from_terms']['ratio']['median']:.2f} x, from postfix "
            f"{found['from_postfix']['ratio']['median']:.2f} x; compilations meanwhile "
            f"{found['compilations']}",
            flush=True,
        )
    out["strings"] = _strings(terms)
    print(f"{terms} strings of {STRING_NODES} nodes read in {out['strings']['seconds']:.2f} s")
    return out


def _at(rows: int, terms: int, repeats: int) -> dict[str, Any]:
    data = samples(rows)

    def fresh(seed: int) -> Population:
        return random_population(np.random.default_rng(seed), terms)

    known = jaxsr.compile_terms(fresh(0).terms, VARIABLES)
    for _ in range(2):  # the first compiles
        known.evaluate(data)
    before, taken = compilations(), []
    for repeat in range(repeats):
        one = fresh(1 + 2 * repeat).terms
        two = compile_postfix(fresh(2 + 2 * repeat).terms, VARIABLES)
        calls: tuple[Callable[[], object], ...] = (
            lambda: known.evaluate(data),
            lambda one=one: jaxsr.compile_terms(one, VARIABLES).evaluate(data),
            lambda two=two: jaxsr.compile_terms(two).evaluate(data),
        )
        taken.append([seconds(call) for call in calls])
    again, from_terms, from_postfix = np.array(taken).T
    return {
        "repeated": asdict(spread(again)),
        "from_terms": _beside(from_terms, again),
        "from_postfix": _beside(from_postfix, again),
        "compilations": compilations() - before,
    }


def _beside(new: np.ndarray, again: np.ndarray) -> dict[str, Any]:
    return {"seconds": asdict(spread(new)), "ratio": asdict(spread(new / again))}


def _strings(number: int) -> dict[str, Any]:
    """Time reading terms of 15 nodes from text."""
    population = random_population(np.random.default_rng(1), number, [STRING_NODES])
    texts = [to_text(term) for term in population.terms]
    return {
        "strings": number,
        "nodes_each": STRING_NODES,
        "seconds": seconds(lambda: jaxsr.compile_terms(texts, VARIABLES)),
    }


def cold(terms: int, rows: int = 1_000) -> dict[str, Any]:
    """Start processes: with no compiled code on disk, then with what the first one left."""
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in ("empty_cache", "filled_cache"):
            out[name] = _process(terms, rows, folder)
            out[name]["files_kept"] = len(os.listdir(folder))
            print(
                f"{name.replace('_', ' '):13}import {out[name]['import_seconds']:.2f} s, first "
                f"evaluation {out[name]['first_seconds']:.2f} s, second "
                f"{out[name]['second_seconds']:.3f} s",
                flush=True,
            )
    return out


def _process(terms: int, rows: int, folder: str) -> dict[str, Any]:
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": folder,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    command = [sys.executable, "-m", "benchmarks.cold_start", str(terms), str(rows), "0"]
    done = subprocess.run(
        command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])
