"""Methods for the constants inside terms, over seeds: accuracy and cost.

    python -m benchmarks.constants [--quick] [--seeds N]

Each seed perturbs the constants of terms of the right form, and each method is to bring them
back: the two-mass chain's force (paper Eq. 22), the crank-slider's rational term (case ii), and a
sine whose frequency is off by more than the span resolves, as it stands and started anew at the
peak of the residual's spectrum. Success is a relative loss below 1e-12. All seeds of a case are
refined in one batch; the first batch, with its compilations, is not timed.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import jaxsr
from jaxsr.expressions import Term, parse
from jaxsr.regression import Refinement, RegressionProblem

RESULT = Path(__file__).parent / "results" / "constants.json"
SUCCESS = 1e-12
ROWS = 200
METHODS = {
    "levenberg_marquardt": Refinement(iterations=15),
    "lbfgs": Refinement(method="lbfgs", iterations=200),
    "adam": Refinement(method="adam", iterations=500, learning_rate=0.02),
}
QUICK = {
    "levenberg_marquardt": Refinement(iterations=15),
    "lbfgs": Refinement(method="lbfgs", iterations=40),
    "adam": Refinement(method="adam", iterations=40, learning_rate=0.02),
}
Sets = list[list[Term]]


def two_mass(seeds: int) -> tuple[RegressionProblem, Sets]:
    """Return z4' = 20 sin(5 t + pi/3) + 60 z1 - 100 z2 on 10 s of motion, and starts."""
    t = np.linspace(0.0, 10.0, ROWS)
    z1 = 0.6 * np.sin(2.0 * t + 0.3) + 0.4 * np.cos(5.1 * t)
    z2 = 0.5 * np.cos(2.0 * t) - 0.7 * np.sin(11.3 * t + 1.0)
    y = 20.0 * np.sin(5.0 * t + np.pi / 3.0) + 60.0 * z1 - 100.0 * z2
    sets = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        w, phase = 5.0 + 0.1 * rng.normal(), np.pi / 3.0 + 0.3 * rng.normal()
        names = ["t", "z1", "z2"]
        sets.append([parse(s, names) for s in ("z1", "z2", f"sin({w}*t + {phase})")])
    return RegressionProblem(y, {"t": t, "z1": z1, "z2": z2}), sets


def crank_slider(seeds: int) -> tuple[RegressionProblem, Sets]:
    """Return the slider's velocity, L1 = 1, L2 = 1.5, w = 20, over 1 s, and starts."""
    t = np.linspace(0.0, 1.0, ROWS)
    w, l1, l2 = 20.0, 1.0, 1.5
    sine, cosine = np.sin(w * t), np.cos(w * t)
    y = -w * l1 * sine - w * l1**2 * sine * cosine / np.sqrt(l2**2 - l1**2 * sine**2)
    sets = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        a, b, c, d = w * (1.0 + 0.01 * rng.normal(size=4))
        e = l2**2 * (1.0 + 0.2 * abs(rng.normal()))
        rational = f"sin({b}*t)*cos({c}*t)/sqrt({e} - sin({d}*t)**2)"
        sets.append([parse(s, ["t"]) for s in (f"sin({a}*t)", rational)])
    return RegressionProblem(y, {"t": t}), sets


def wrong_frequency(seeds: int) -> tuple[RegressionProblem, Sets]:
    """Return 3 t + sin(7.3 t + 1), and sines at frequencies drawn from [1, 15]."""
    t = np.linspace(0.0, 20.0, ROWS)
    sets = []
    for seed in range(seeds):
        w = np.random.default_rng(seed).uniform(1.0, 15.0)
        sets.append([parse(s, ["t"]) for s in ("t", f"sin({w}*t + 0.8)")])
    return RegressionProblem(3.0 * t + np.sin(7.3 * t + 1.0), {"t": t}), sets


def seeded_frequency(seeds: int) -> tuple[RegressionProblem, Sets]:
    """Return the same with the frequency read from the spectrum of what is left without it."""
    problem, sets = wrong_frequency(seeds)
    (w,) = problem.frequencies(sets[0][:1], "t", 1)
    phases = [np.random.default_rng(seed).uniform(-1.0, 1.0) for seed in range(seeds)]
    return problem, [
        [s[0], parse(f"sin({w}*t + {p})", ["t"])] for s, p in zip(sets, phases, strict=True)
    ]


CASES: dict[str, Callable[[int], tuple[RegressionProblem, Sets]]] = {
    "two-mass force": two_mass,
    "crank-slider term": crank_slider,
    "wrong frequency": wrong_frequency,
    "frequency from the spectrum": seeded_frequency,
}


def run(case: str, method: str, limits: Refinement, seeds: int, repeat: bool) -> dict[str, Any]:
    """Refine all seeds of a case with one method."""
    problem, sets = CASES[case](seeds)
    problem.refinement = limits
    seconds, losses = [], []
    for _ in range(2 if repeat else 1):
        began = time.perf_counter()
        losses = [loss for _, loss in problem.refine_many(sets)]
        seconds.append(time.perf_counter() - began)
    return {
        "case": case,
        "method": method,
        "iterations": limits.iterations,
        "success_rate": sum(loss < SUCCESS for loss in losses) / seeds,
        "median_loss": statistics.median(losses),
        "seconds_per_individual": seconds[-1] / seeds,
        "losses": losses,
    }


def main() -> None:
    """Run, print, write the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="four seeds, nothing written")
    parser.add_argument("--seeds", type=int, default=20)
    arguments = parser.parse_args()
    seeds = 4 if arguments.quick else arguments.seeds
    runs = []
    print(f"{'case':28}{'method':21}{'success':>8}{'median loss':>13}{'s each':>10}{'ratio':>8}")
    for case in CASES:
        fastest = None
        for method, limits in (QUICK if arguments.quick else METHODS).items():
            runs.append(run(case, method, limits, seeds, repeat=not arguments.quick))
            last = runs[-1]
            fastest = fastest or last["seconds_per_individual"]
            last["time_ratio"] = last["seconds_per_individual"] / fastest
            print(
                f"{case:28}{method:21}{last['success_rate']:8.2f}{last['median_loss']:13.1e}"
                f"{last['seconds_per_individual']:10.4f}{last['time_ratio']:8.0f}",
                flush=True,
            )
    if arguments.quick:
        return
    versions = {name: importlib.metadata.version(name) for name in ("jax", "numpy", "optax")}
    document = {
        "case": f"constants inside terms, {seeds} seeds, {ROWS} rows; success: loss < {SUCCESS}",
        "ratio": "seconds over those of levenberg_marquardt in the same case",
        "runs": runs,
        "versions": {"jaxsr": jaxsr.__version__, "python": platform.python_version(), **versions},
        "machine": f"{platform.machine()}, {platform.system()}",
    }
    RESULT.parent.mkdir(exist_ok=True)
    RESULT.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
