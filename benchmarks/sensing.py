"""Sensors that engineers have: encoders, converters, accelerometers, speeds without angles.

    python -m benchmarks.sensing [--quick] [--jobs N] [--cases NAME ...] [--seeds N]

Five cases in 20 seeds each, over plants with drawn parameters, excitation and noise: a motor with
Coulomb friction whose angle is not measured; an accelerometer beside a missing force (no sensor may
be blamed); encoders beside nothing, beside a wrong value, and beside Coulomb friction. In every
other seed the first encoder counts 20 to 50 steps over the whole motion. Writes
``results/sensing.json`` as cases end; --quick (one seed of two cases, no file) fails where a
diagnosis does. Ends with status 1 if a full run has a seed wrong.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.provenance import write
from benchmarks.sensing_plant import STICK, Plant, Sensor, rough
from benchmarks.sensing_plants import ACCELEROMETERS, ENCODERS, MOTORS

SEEDS, BUDGET = 20, 60.0
STRENGTH = (0.15, 0.4)
"""Rms of a missing force over that of the net force without it."""
WRONG = 1.35
"""Factor by which a wrong value is off, up or down."""
VISIBLE = 5.0
"""Rms effect of a wrong value in some sensor, in errors of that sensor, to count as one."""


@dataclass(frozen=True)
class Task:
    """One diagnosis with its truth."""

    case: str
    seed: int
    plant: str
    model: str
    recordings: list[Any]
    truth: dict[str, Any]


Law = Callable[[np.ndarray, np.ndarray], Any]


def _laws(width: float) -> dict[str, tuple[Law, str]]:
    """Missing forces of unit size by mechanism, with the name of their constant."""
    return {
        "coulomb_friction": (lambda q, v: -rough(v, width), "Fc"),
        "cubic_stiffness": (lambda q, v: -(q**3), "k3"),
        "quadratic_drag": (lambda q, v: -v * np.abs(v), "kd"),
    }


def _missing(
    plant: Plant, values: dict[str, float], mechanism: str, rng: np.random.Generator
) -> tuple[Law, dict[str, Any]]:
    """Return a force that is left out and what is to be said of it."""
    probe = np.random.default_rng(int(rng.integers(2**31)))
    moved = plant.exact(probe, values)
    speed = moved.states[plant.speed]
    net = values[plant.mass] * moved.rates[plant.speed]
    law, name = _laws(STICK * float(np.std(speed)))[mechanism]
    position = moved.states[plant.states.index(_position(plant))]
    shape = np.asarray(law(position, speed))
    size = float(np.exp(rng.uniform(*np.log(STRENGTH))) * np.std(net) / np.std(shape))
    truth = {"mechanism": mechanism, "parameter": name, "value": size}
    truth["site"] = f"equation:{plant.states[plant.speed]}"
    # In the unit of the state's rate where no force can be read off the equation.
    truth["or"] = size / values[plant.mass]
    return (lambda q, v: size * law(q, v)), truth


def _position(plant: Plant) -> str:
    speed = plant.states[plant.speed]
    return next(s for s, e in plant.equations.items() if e == speed)


def _sensors(plant: Plant, seed: int, rng: np.random.Generator) -> dict[str, Sensor]:
    """Return the plant's sensors; in every other seed the first encoder is coarse."""
    sensors = dict(plant.sensors)
    if (seed // len(ENCODERS)) % 2:
        first = next(iter(sensors))
        sensors[first] = Sensor(float(rng.uniform(20.0, 50.0)))
    return sensors


def task(case: str, seed: int) -> Task:
    """Draw one task."""
    rng = np.random.default_rng([sorted(CASES).index(case), seed])
    plants = {"motor": MOTORS, "accelerometer": ACCELEROMETERS}.get(case, ENCODERS)
    plant = plants[seed % len(plants)]
    values, sensors, missing = plant.drawn(rng), dict(plant.sensors), None
    given, truth = dict(values), {}
    if case in ("motor", "friction"):
        missing, truth = _missing(plant, values, "coulomb_friction", rng)
    if case == "accelerometer":
        kinds = sorted(_laws(1.0))
        missing, truth = _missing(plant, values, kinds[(seed // len(plants)) % len(kinds)], rng)
    if plants is ENCODERS:
        sensors = _sensors(plant, seed, rng)
    if case == "wrong value":
        name, given = _wrong(plant, values, sensors, rng)
        truth = {"name": name, "value": values[name], "given": given[name]}
    recordings = plant.records(rng, values, missing, sensors)
    return Task(case, seed, plant.name, plant.model(given), recordings, truth)


def _wrong(
    plant: Plant, values: dict[str, float], sensors: dict[str, Sensor], rng: np.random.Generator
) -> tuple[str, dict[str, float]]:
    """Return a parameter whose wrong value the sensors see, and the values given."""
    probe = int(rng.integers(2**31))
    right = plant.exact(np.random.default_rng(probe), values)
    error = plant.errors(right, sensors)
    factor = WRONG if rng.random() < 0.5 else 1.0 / WRONG
    for name in rng.permutation(list(values)):
        given = {**values, name: float(f"{values[name] * factor:.4g}")}
        other = plant.exact(np.random.default_rng(probe), given)
        moved = np.std(other.readings - right.readings, axis=1)
        if np.max(moved / np.maximum(error, 1e-300)) > VISIBLE:
            return str(name), given
    raise RuntimeError(f"no wrong value of {plant.name} shows")


def _structure(found: Any, truth: dict[str, Any]) -> dict[str, bool]:
    first = found.findings[0] if found.findings else {"parameters": {}}
    row = next(iter(first["parameters"].values()), None)
    low, high = row["ci95"] if row else (np.nan, np.nan)
    return {
        "verdict": found.verdict == "structure",
        "mechanism": first.get("mechanism") == truth["mechanism"],
        "site": first.get("site") == truth["site"],
        "no_sensor": all(f["family"] != "measurement" for f in found.findings),
        "interval": any(low <= truth[k] <= high for k in ("value", "or")),
    }


def _nothing(found: Any, truth: dict[str, Any]) -> dict[str, bool]:
    return {"verdict": found.verdict == "nothing", "no_finding": not found.findings}


def _parameter(found: Any, truth: dict[str, Any]) -> dict[str, bool]:
    first = found.findings[0] if found.findings else {}
    return {
        "verdict": found.verdict == "parameter",
        "first": first.get("site") == f"parameter:{truth['name']}",
        "no_sensor": all(f["family"] != "measurement" for f in found.findings),
    }


CASES: dict[str, Callable[[Any, dict[str, Any]], dict[str, bool]]] = {
    "motor": _structure,
    "accelerometer": _structure,
    "nothing": _nothing,
    "wrong value": _parameter,
    "friction": _structure,
}
MUST = ("verdict", "mechanism", "site", "no_sensor", "no_finding", "first")
"""Marks that make a seed right; intervals miss one in twenty by definition, and are counted."""


def run(case: str, seed: int, budget: float) -> dict[str, Any]:
    """Draw, diagnose and judge one task."""
    import jaxsr
    from jaxsr.recordings import write_csv

    job, begin = task(case, seed), time.perf_counter()
    row: dict[str, Any] = {"case": case, "seed": seed, "plant": job.plant, "truth": job.truth}
    with tempfile.TemporaryDirectory() as place:
        model = Path(place) / "model.toml"
        model.write_text(job.model, encoding="utf-8")
        files = [Path(place) / r.name for r in job.recordings]
        for recording, file in zip(job.recordings, files, strict=True):
            write_csv(recording, file)
        try:
            found = jaxsr.diagnose(jaxsr.Simulator.from_file(model), files, budget=budget)
        except Exception:  # a defect is a wrong answer, and its place is told
            return {**row, "right": {"ran": False}, "error": traceback.format_exc(limit=-3)}
    return {
        **row,
        "verdict": found.verdict,
        "findings": [
            {k: f[k] for k in ("mechanism", "site", "probability", "parameters", "share")}
            for f in found.findings
        ],
        "right": CASES[case](found, job.truth),
        "stopped_by": found.document["provenance"]["stopped_by"],
        "seconds": round(time.perf_counter() - begin, 1),
    }


def is_right(row: dict[str, Any]) -> bool:
    """Whether every mark that must be right is."""
    return all(good for mark, good in row["right"].items() if mark in MUST or mark == "ran")


def said(row: dict[str, Any]) -> str:
    """One line of a row."""
    found = " ".join(
        f"{f['mechanism']}@{f['site']}({f['probability']:.2f})" for f in row.get("findings", [])
    )
    wrong = [mark for mark, good in row["right"].items() if not good]
    truth = row["truth"].get("mechanism") or row["truth"].get("name") or "nothing"
    return (
        f"{row['case']:13} {row['seed']:2} {row['plant']:28.28} {truth:16} "
        f"{row.get('verdict', 'failed'):11} {found} ({row.get('seconds', 0)} s)"
        + (f"  WRONG: {', '.join(wrong)}" if wrong else "")
        + ("\n" + row["error"] if "error" in row else "")
    )


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Seeds right by case, and intervals that cover."""
    table = {}
    for case in dict.fromkeys(r["case"] for r in rows):
        own = [r for r in rows if r["case"] == case]
        covered = [r["right"]["interval"] for r in own if "interval" in r["right"]]
        table[case] = {"right": sum(map(is_right, own)), "of": len(own)}
        if covered:
            table[case] |= {"intervals_covering": sum(covered), "intervals": len(covered)}
    return table


def _alone() -> None:
    """One thread a process: several share the cores."""
    flags = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}".strip()
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"


def main() -> int:
    """Run the cases; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--quick", action="store_true", help="two diagnoses, writes nothing")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--cases", nargs="+", choices=sorted(CASES), default=list(CASES))
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(SEEDS)))
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds a diagnosis")
    args = parser.parse_args()
    todo = [(case, seed, args.budget) for case in args.cases for seed in args.seeds]
    if args.quick:
        todo = [("nothing", 0, 10.0), ("wrong value", 0, 10.0)]
    whole = not args.quick and args.cases == list(CASES) and len(args.seeds) == SEEDS
    rows: list[dict[str, Any]] = []

    def took(row: dict[str, Any]) -> None:
        rows.append(row)
        print(said(row), flush=True)
        if whole and len(rows) % 10 == 0:
            done(rows, args.budget)

    if args.jobs > 1:
        _alone()
        with ProcessPoolExecutor(args.jobs, get_context("spawn")) as pool:
            for future in as_completed([pool.submit(run, *item) for item in todo]):
                took(future.result())
    else:
        for item in todo:
            took(run(*item))
    print(summary(rows))
    if whole:
        done(rows, args.budget)
    if args.quick:
        return 1 if any("error" in row for row in rows) else 0
    return 0 if all(map(is_right, rows)) else 1


def done(rows: list[dict[str, Any]], budget: float) -> None:
    """Write what has been run so far."""
    ordered = sorted(rows, key=lambda r: (list(CASES).index(r["case"]), r["seed"]))
    body = {"budget_s": budget, "summary": summary(ordered), "rows": ordered}
    write("sensing", "Sensors that engineers have", range(SEEDS), body)


if __name__ == "__main__":
    sys.exit(main())
