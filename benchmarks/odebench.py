"""ODEBench: 63 ODE systems, two initial conditions each, clean and with 5 % noise.

    python -m benchmarks.odebench [--quick] [--ids 1,2] [--noise 0.05] [--processes 2] [--peers]

512 samples on t in [0, 10] from one initial condition, integrated at rtol 1e-11; noise is
multiplicative, x (1 + sigma n). The equations found are integrated again, from the initial
condition of the data (reconstruction) and from the other one (generalisation), and count as right
where R2 (variance weighted over states, against the noiseless solution) is above 0.9. Exact
structure: the true terms and no others up to algebra, constants within 2 %. The verdict of the
discovery stands in every row: exact ones must not be called undecided. All systems are
autonomous and are searched as such, by jaxsr and by the peers alike. Peers are given derivatives:
differences of clean states, Savitzky-Golay ones of noisy states; pyoperon runs on the 17 mechanical
systems, 3 s an equation.
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

from benchmarks import provenance
from benchmarks.equivalence import equivalent

SYSTEMS = Path(__file__).parents[2] / "shared" / "odebench" / "systems.json"
RESULT = provenance.RESULTS / "odebench.json"
MECHANICAL = (5, 13, 23, 24, 25, 28, 32, 33, 34, 36, 37, 38, 40, 43, 44, 46, 61)
QUICK = (2, 24, 28)
SAMPLES, DURATION = 512, 10.0
SECONDS = 10.0  # of search for an equation
OPERON_SECONDS = 3.0


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


def recorded(number: int, place: int, sigma: float, seed: int) -> tuple[dict[str, Any], Any]:
    """Return a system with its clean solutions, and the recording to search."""
    import jaxsr

    system = load()[number]
    names = system["names"]
    system["clean"] = [integrate(system["equations"], names, start) for start in system["starts"]]
    clean = system["clean"][place]
    rng = np.random.default_rng([number, place, seed])
    x = clean * (1.0 + sigma * rng.normal(size=clean.shape))
    t = np.linspace(0.0, DURATION, SAMPLES)
    return system, jaxsr.Recording("run", t, dict(zip(names, x.T, strict=True)))


def scored(
    task: tuple[int, int, float, int],
    method: str,
    system: dict[str, Any],
    right: list[sympy.Expr],
    seconds: float,
    modes: int = 1,
) -> dict[str, Any]:
    """Simulate and judge what a method found."""
    number, place, sigma, seed = task
    names, clean = system["names"], system["clean"]
    data = dict(zip(names, clean[place].T, strict=True))
    scores = [
        r2(clean[k], integrate(right, names, system["starts"][k])) for k in (place, 1 - place)
    ]
    return {
        "method": method,
        "id": number,
        "title": system["title"],
        "start": place,
        "noise": sigma,
        "seed": seed,
        "seconds": round(seconds, 2),
        "modes": modes,
        "reconstruction": max(scores[0], -1e9),
        "generalisation": max(scores[1], -1e9),
        "exact": [judged(f, g, data) for f, g in zip(right, system["equations"], strict=True)],
        "found": {n: str(e) for n, e in zip(names, right, strict=True)},
    }


def run(task: tuple[int, int, float, int]) -> dict[str, Any]:
    """Search one system from one initial condition."""
    import jaxsr

    number, place, sigma, seed = task
    system, recording = recorded(number, place, sigma, seed)
    names = system["names"]
    began = time.perf_counter()
    found = jaxsr.discover(
        [recording],
        jaxsr.Roles(states=names, autonomous=True),
        run=jaxsr.Run(seed=seed, budget=SECONDS * len(names)),
    )
    seconds = time.perf_counter() - began
    right = [sympy.sympify(e.sympy()) for e in found.equations]
    row = scored(task, "jaxsr", system, right, seconds, max(1, len(found.modes)))
    told = {"verdict": found.verdict, "reason": found.reason, "free_run": found.free_run_nrmse}
    return row | told


def run_peers(task: tuple[int, int, float, int]) -> list[dict[str, Any]]:
    """Run pysindy, and pyoperon on a mechanical system, on the same recording."""
    from benchmarks.peers import missing, operon, sindy
    from jaxsr.views import derivative

    number, place, sigma, seed = task
    system, recording = recorded(number, place, sigma, seed)
    names, t = system["names"], recording.time
    columns = {n: recording.channel(n) for n in names}
    rates = {f"d{n}": derivative(t, columns[n]) for n in names}
    inside = slice(4, -4)  # one-sided stencils
    whole = {n: v[inside] for n, v in (columns | rates | {"t": t}).items()}
    block = np.arange(len(whole["t"])) * 8 // len(whole["t"])
    held = np.isin(block, (3, 7))
    parts = [{n: v[rows] for n, v in whole.items()} for rows in (~held, held)]
    out = []
    if not missing("pysindy"):
        answers = sindy([parts[0]], names, (), [parts[1]])
        seconds = sum(a.seconds for a in answers.values())
        right = [answers[n].expression for n in names]
        out.append(scored(task, "pysindy", system, right, seconds))
    if number in MECHANICAL and not missing("pyoperon"):
        data = {n: whole[n] for n in names}
        found = [operon(data, whole[f"d{n}"], seed, OPERON_SECONDS) for n in names]
        seconds = sum(a.seconds for a in found)
        out.append(scored(task, "pyoperon", system, [a.expression for a in found], seconds))
    return out


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
        return {"runs": 0}
    return {
        "runs": count,
        "reconstruction": sum(r["reconstruction"] > 0.9 for r in runs) / count,
        "generalisation": sum(r["generalisation"] > 0.9 for r in runs) / count,
        "exact": sum(all(r["exact"]) for r in runs) / count,
        "exact_undecided": sorted(
            f"{r['id']}.{r['start']}"
            for r in runs
            if r.get("verdict") == "undecided" and all(r["exact"])
        ),
        "inexact_law": sorted(
            f"{r['id']}.{r['start']}"
            for r in runs
            if r.get("verdict") == "law" and not all(r["exact"])
        ),
        "split": sorted(f"{r['id']}.{r['start']}" for r in runs if r.get("modes", 1) > 1),
        "wrong": sorted({f"{r['id']}.{r['start']}" for r in runs if not all(r["exact"])}),
        "exact_equations": sum(sum(r["exact"]) for r in runs) / sum(len(r["exact"]) for r in runs),
        "median_seconds_an_equation": float(
            np.median([r["seconds"] / len(r["exact"]) for r in runs])
        ),
    }


def show(done: dict[str, Any]) -> None:
    """Print one run in a line."""
    print(
        f"{done['method']:8s} {done['id']:2d}.{done['start']} noise {done['noise']:.2f} "
        f"R2 {done['reconstruction']:8.4f} {done['generalisation']:8.4f} "
        f"exact {''.join('.#'[e] for e in done['exact']):4s} {done['seconds']:5.1f} s  "
        f"{done.get('verdict', ''):9s} "
        f"{'; '.join(done['found'].values())[:90]}",
        flush=True,
    )


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="three systems, nothing written")
    parser.add_argument("--ids", default="", help="comma-separated; all, or the mechanical ones")
    parser.add_argument("--noise", default="0,0.05")
    parser.add_argument("--starts", default="0,1")
    parser.add_argument("--seeds", default="0", help="comma-separated")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--peers", action="store_true", help="pysindy and pyoperon instead")
    parser.add_argument("--add", action="store_true", help="to the runs written before")
    return parser.parse_args()


def main() -> None:
    """Run, print, write the result."""
    given = arguments()
    chosen = {"": [], "mechanical": list(MECHANICAL)}
    ids = chosen.get(given.ids, None)
    ids = [int(k) for k in given.ids.split(",")] if ids is None else ids
    ids = ids or list(QUICK if given.quick else load())
    starts = "0" if given.quick else given.starts
    tasks = [
        (number, int(place), float(sigma), int(seed))
        for sigma in given.noise.split(",")
        for seed in given.seeds.split(",")
        for number in ids
        for place in starts.split(",")
    ]
    runs: list[dict[str, Any]] = []
    if given.peers:
        for task in tasks:
            for done in run_peers(task):
                runs.append(done)
                show(done)
    else:
        context = multiprocessing.get_context("spawn")
        with context.Pool(given.processes, maxtasksperchild=30) as pool:
            for done in pool.imap_unordered(run, tasks):
                runs.append(done)
                show(done)
    if given.add and RESULT.exists():
        before = json.loads(RESULT.read_text(encoding="utf-8"))["runs"]
        new = {_place(r) for r in runs}
        runs = [r for r in before if _place(r) not in new] + runs
    tables = {}
    for method in sorted({r["method"] for r in runs}):
        for sigma in sorted({r["noise"] for r in runs}):
            part = [r for r in runs if r["method"] == method and r["noise"] == sigma]
            mechanical = [r for r in part if r["id"] in MECHANICAL]
            every = [r for r in part if r["seed"] == 0]
            tables[f"{method}, noise {sigma}"] = summary(every)
            tables[f"{method}, noise {sigma}, mechanical, all seeds"] = summary(mechanical)
    for name, table in tables.items():
        print(f"{name}: {json.dumps(table)}")
    if not given.quick:
        runs.sort(key=_place)
        body = {"summary": tables, "budget_seconds_an_equation": SECONDS, "runs": runs}
        title = "ODEBench, 512 samples on [0, 10]"
        provenance.write("odebench", title, sorted({r["seed"] for r in runs}), body)


def _place(done: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(done[k] for k in ("method", "noise", "id", "start", "seed"))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
