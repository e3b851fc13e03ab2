"""ODEBench: 63 ODE systems, two initial conditions each, clean and with 5 % noise.

    python -m benchmarks.odebench [--quick] [--ids 1,2] [--noise 0.05] [--processes 2]

512 samples on t in [0, 10] from one initial condition, integrated at rtol 1e-11; noise is
multiplicative, x (1 + sigma n). The equations found are integrated again, from the initial
condition of the data (reconstruction) and from the other one (generalisation), and count as right
where R2 (variance weighted over states, against the noiseless solution) is above 0.9. Exact
structure: the true terms and no others up to algebra, constants within 2 %. All systems are
autonomous and are searched as such, by jaxsr and by the peers alike.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import sympy
from scipy.integrate import solve_ivp

from benchmarks.equivalence import equivalent

SYSTEMS = Path(__file__).parents[2] / "shared" / "odebench" / "systems.json"
RESULT = Path(__file__).parent / "results" / "odebench.json"
MECHANICAL = (5, 13, 23, 24, 25, 28, 32, 33, 34, 36, 37, 38, 40, 43, 44, 46, 61)
QUICK = (2, 24, 28)
SAMPLES, DURATION = 512, 10.0
SECONDS = 10.0  # of search for an equation


def load() -> dict[int, dict[str, Any]]:
    """Return the systems by id: dimension, right-hand sides as SymPy, initial conditions."""
    out = {}
    for row in json.loads(SYSTEMS.read_text(encoding="utf-8")):
        names = [f"x_{k}" for k in range(row["dim"])]
        known: dict[str, Any] = {n: sympy.Symbol(n, real=True) for n in names}
        known |= {f"c_{k}": sympy.Float(c, 17) for k, c in enumerate(row["consts"][0])}
        parts = [re.sub(r"\babs\b", "Abs", p.replace("^", "**")) for p in row["eq"].split("|")]
        out[row["id"]] = {
            "names": names,
            "equations": [sympy.sympify(p, locals=known) for p in parts],
            "starts": row["init"],
            "title": row["eq_description"],
        }
    return out


def integrate(equations: list[sympy.Expr], names: list[str], start: Any) -> np.ndarray | None:
    """Return the solution (samples, states), or None where it cannot be continued."""
    rates = sympy.lambdify(names, equations, "numpy", cse=True)
    t = np.linspace(0.0, DURATION, SAMPLES)

    def f(_: float, x: np.ndarray) -> np.ndarray:
        return np.array([np.real_if_close(r) for r in rates(*x)], dtype=float)

    def lost(_: float, x: np.ndarray) -> float:
        return 1e6 - float(np.max(np.abs(x)))

    lost.terminal = True  # type: ignore[attr-defined]  # the protocol of solve_ivp's events
    began = time.monotonic()

    def checked(s: float, x: np.ndarray) -> np.ndarray:
        if time.monotonic() - began > 20.0:
            raise TimeoutError
        return f(s, x)

    try:
        with np.errstate(all="ignore"):
            for method in ("DOP853", "Radau"):
                solution = solve_ivp(
                    checked,
                    (0.0, DURATION),
                    start,
                    method=method,
                    rtol=1e-11,
                    atol=1e-12,
                    t_eval=t,
                    events=lost,
                )
                good = solution.success and solution.y.shape[1] == SAMPLES
                if good and np.all(np.isfinite(solution.y)):
                    return solution.y.T
    except (TimeoutError, TypeError, ValueError, ArithmeticError):
        return None
    return None


def r2(truth: np.ndarray, simulated: np.ndarray | None) -> float:
    """Return the variance-weighted R2 over states."""
    if simulated is None:
        return -np.inf
    error = np.sum((truth - simulated) ** 2)
    return float(1.0 - error / np.sum((truth - truth.mean(axis=0)) ** 2))


def run(task: tuple[int, int, float, int]) -> dict[str, Any]:
    """Search one system from one initial condition."""
    import jaxsr

    number, place, sigma, seed = task
    system = load()[number]
    names, truth = system["names"], system["equations"]
    clean = [integrate(truth, names, start) for start in system["starts"]]
    rng = np.random.default_rng([number, place, seed])
    x = clean[place] * (1.0 + sigma * rng.normal(size=clean[place].shape))
    t = np.linspace(0.0, DURATION, SAMPLES)
    recording = jaxsr.Recording("run", t, dict(zip(names, x.T, strict=True)))
    began = time.perf_counter()
    found = jaxsr.discover(
        [recording], states=names, autonomous=True, seed=seed, budget=SECONDS * len(names)
    )
    seconds = time.perf_counter() - began
    right = [e.sympy() for e in found.equations]
    data = dict(zip(names, clean[place].T, strict=True))
    scores = [
        r2(clean[k], integrate(right, names, system["starts"][k])) for k in (place, 1 - place)
    ]
    return {
        "id": number,
        "start": place,
        "noise": sigma,
        "seed": seed,
        "seconds": seconds,
        "reconstruction": scores[0],
        "generalisation": scores[1],
        "exact": [judged(f, g, data) for f, g in zip(right, truth, strict=True)],
        "found": {n: e.expression for n, e in zip(names, found.equations, strict=True)},
    }


def judged(found: sympy.Expr, truth: sympy.Expr, data: dict[str, np.ndarray]) -> bool:
    """Compare, a form that SymPy cannot handle counting as wrong."""
    try:
        return equivalent(found, truth, data)
    except (TypeError, ValueError, ArithmeticError, KeyError, AttributeError):
        return False


def summary(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the shares of right runs."""
    count = len(runs)
    if not count:
        return {}
    return {
        "runs": count,
        "reconstruction": sum(r["reconstruction"] > 0.9 for r in runs) / count,
        "generalisation": sum(r["generalisation"] > 0.9 for r in runs) / count,
        "exact": sum(all(r["exact"]) for r in runs) / count,
        "exact_equations": sum(sum(r["exact"]) for r in runs) / sum(len(r["exact"]) for r in runs),
        "median_seconds_an_equation": float(
            np.median([r["seconds"] / len(r["exact"]) for r in runs])
        ),
    }


def main() -> None:
    """Run, print, write the result."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="three systems, nothing written")
    parser.add_argument("--ids", default="")
    parser.add_argument("--noise", default="0,0.05")
    parser.add_argument("--starts", default="0,1")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=None)
    arguments = parser.parse_args()
    ids = [int(k) for k in arguments.ids.split(",") if k]
    ids = ids or list(QUICK if arguments.quick else load())
    tasks = [
        (number, int(place), float(sigma), seed)
        for sigma in arguments.noise.split(",")
        for seed in range(arguments.seeds)
        for number in ids
        for place in arguments.starts.split(",")
    ]
    runs = []
    context = multiprocessing.get_context("spawn")
    with context.Pool(arguments.processes, maxtasksperchild=20) as pool:
        for done in pool.imap_unordered(run, tasks):
            runs.append(done)
            print(
                f"{done['id']:2d}.{done['start']} noise {done['noise']:.2f} "
                f"R2 {done['reconstruction']:8.4f} {done['generalisation']:8.4f} "
                f"exact {''.join('.#'[e] for e in done['exact']):4s} "
                f"{done['seconds']:5.1f} s  {done['found']}",
                flush=True,
            )
    for sigma in sorted({r["noise"] for r in runs}):
        print(f"noise {sigma}:", json.dumps(summary([r for r in runs if r["noise"] == sigma])))
    if arguments.out:
        arguments.out.write_text(json.dumps(runs, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
