"""Exact structure of the two-mass chain over seeds (paper section 7.1).

    python -m benchmarks.two_mass [--quick] [--seeds N]

Two masses on three springs with two harmonic forces, in the form that the paper's Eq. 22 shows:
z3' = 20 sin 2t + 30 z2 - 50 z1, z4' = 20 sin(5t + pi/3) + 60 z1 - 100 z2. Exact structure means
the right terms and no others, in every equation.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import platform
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr.discovery import Equation
from jaxsr.expressions import Term, to_text

RESULT = Path(__file__).parent / "results" / "two_mass.json"
STATES = ("z1", "z2", "z3", "z4")
# state -> (skeleton -> coefficient), inner constants in the order they stand in the term
TRUTH = {
    "z1": {"z3": 1.0},
    "z2": {"z4": 1.0},
    "z3": {"z1": -50.0, "z2": 30.0, "sin(c*t)": 20.0},
    "z4": {"z1": 60.0, "z2": -100.0, "sin(c*t + c)": 20.0},
}
CONSTANTS = {"z3": [2.0], "z4": [5.0, np.pi / 3]}


def rates(t: float | np.ndarray, z: Any) -> list[Any]:
    """Return dz/dt."""
    return [
        z[2],
        z[3],
        20.0 * np.sin(2.0 * t) + 30.0 * z[1] - 50.0 * z[0],
        20.0 * np.sin(5.0 * t + np.pi / 3.0) + 60.0 * z[0] - 100.0 * z[1],
    ]


def recording(start: list[float], seconds: float, count: int, name: str) -> jaxsr.Recording:
    """Return an experiment from ``start``, states and derivatives, without noise."""
    t = np.linspace(0.0, seconds, count)
    solution = solve_ivp(
        rates, (0.0, seconds), start, method="DOP853", rtol=1e-12, atol=1e-12, t_eval=t
    )
    channels = dict(zip(STATES, solution.y, strict=True))
    derivatives = zip(STATES, rates(t, solution.y), strict=True)
    return jaxsr.Recording(name, t, channels | {f"d{s}": v for s, v in derivatives})


def skeleton(term: Term) -> str:
    """Return the term's text with every inner constant written as c."""

    def marked(node: Term) -> Term:
        if node.is_constant:
            return Term.variable("c")
        return Term.apply(node.op, *map(marked, node.args)) if node.args else node

    return to_text(marked(term))


def judge(equation: Equation) -> tuple[bool, float]:
    """Return whether the structure is exact, and the largest relative error of a constant."""
    truth = TRUTH[equation.state]
    found = {skeleton(t.term): t.coefficient for t in equation.terms}
    if set(found) != set(truth) or len(equation.terms) != len(truth):
        return False, float("nan")
    errors = [abs(found[k] / truth[k] - 1.0) for k in truth]
    inner = [n.value for t in equation.terms for n in t.term.walk() if n.is_constant]
    # sin(w t + phi) is the same for phi and phi + 2 pi
    wanted = CONSTANTS.get(equation.state, [])
    for place, (value, right) in enumerate(zip(inner, wanted, strict=True)):
        shifted = (value - right + np.pi) % (2.0 * np.pi) - np.pi if place else value - right
        errors.append(abs(shifted / right))
    return True, float(max(errors))


def run(seed: int, samples: int) -> dict[str, Any]:
    """Discover all four equations with one seed."""
    half = samples // 2
    data = [
        recording([0.0, 0.0, 0.0, 0.0], 10.0, half, "rest"),
        recording([1.0, -0.2, 0.0, 0.0], 10.0, half, "released"),
    ]
    began = time.perf_counter()
    found = jaxsr.discover(data, states=STATES, derivatives=[f"d{s}" for s in STATES], seed=seed)
    seconds = time.perf_counter() - began
    marks = {e.state: judge(e) for e in found.equations}
    return {
        "seed": seed,
        "seconds": seconds,
        "exact": all(right for right, _ in marks.values()),
        "largest_constant_error": max(error for _, error in marks.values()),
        "expressions": {e.state: e.expression for e in found.equations},
    }


def main() -> None:
    """Run, print, write the result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two seeds, nothing written")
    parser.add_argument("--seeds", type=int, default=20)
    arguments = parser.parse_args()
    runs = []
    for seed in range(2 if arguments.quick else arguments.seeds):
        runs.append(run(seed, 1000))
        last = runs[-1]
        print(
            f"seed {seed:2d}  exact {last['exact']!s:5}  "
            f"largest constant error {last['largest_constant_error']:.1e}  "
            f"{last['seconds']:.1f} s",
            flush=True,
        )
    exact = [r for r in runs if r["exact"]]
    summary = {
        "exact": len(exact),
        "of": len(runs),
        "largest_constant_error": max((r["largest_constant_error"] for r in exact), default=None),
        "median_seconds": statistics.median(r["seconds"] for r in runs),
        "slowest_seconds": max(r["seconds"] for r in runs),
    }
    print(
        f"exact structure in {summary['exact']} of {summary['of']} seeds, "
        f"median {summary['median_seconds']:.1f} s"
    )
    if arguments.quick:
        return
    names = ("jax", "numpy", "scipy")
    versions = {name: importlib.metadata.version(name) for name in names}
    document = {
        "case": "two-mass chain, 1000 clean samples, four equations",
        "summary": summary,
        "runs": runs,
        "versions": {"jaxsr": jaxsr.__version__, "python": platform.python_version(), **versions},
        "machine": f"{platform.machine()}, {platform.system()}",
    }
    RESULT.parent.mkdir(exist_ok=True)
    RESULT.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
