"""Benchmarks of planted machines: diagnoses one by one, and how many are right."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any, TypeVar

import numpy as np

import jaxsr._clock as clock
from benchmarks.unread_machines import Machine
from jaxsr.diagnosis import diagnose
from jaxsr.models import Model, Simulator
from jaxsr.recordings import Recording

OFF = 0.25
"""Largest share by which values are wrong."""
Asked = TypeVar("Asked")
Row = dict[str, Any]


@dataclass(frozen=True)
class Task:
    """One diagnosis of a machine, with a law missing or none."""

    machine: str
    way: str
    lacking: bool
    seed: int


def asked(
    parser: argparse.ArgumentParser, machines: Collection[str], seed: int
) -> argparse.Namespace:
    """Return what a benchmark was asked for."""
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--seed", type=int, default=seed)
    parser.add_argument("--machines", nargs="+", choices=list(machines), help="no file written")
    return parser.parse_args()


def answers(
    tasks: Sequence[Asked], diagnosed: Callable[[Asked], Row], told: Callable[[Row], str], jobs: int
) -> list[Row]:
    """Return and print the rows of all tasks; a process a task, which may leave things switched."""
    rows: list[Row] = []
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        for row in pool.map(diagnosed, tasks):
            rows.append(row)
            print(told(row), flush=True)
    return rows


def counted(rows: Sequence[Row], held_out: Collection[str]) -> dict[str, dict[str, Row]]:
    """Return and print how many answers are right, by way, on machines seen and held out."""

    def part(way: str, held: bool) -> Row:
        own = [r for r in rows if r["way"] == way and (r["machine"] in held_out) is held]
        return {"right": sum(r["right"] for r in own), "of": len(own)}

    ways = dict.fromkeys(r["way"] for r in rows)
    found = {way: {"seen": part(way, False), "held out": part(way, True)} for way in ways}
    for way, parts in found.items():
        text = ", ".join(f"{name}: {c['right']} of {c['of']}" for name, c in parts.items())
        print(f"{way}: {text}")
    return found


def with_values(
    found: dict[str, dict[str, Row]], rows: Sequence[Row], held_out: Collection[str]
) -> dict[str, dict[str, Row]]:
    """Return, and print, counts with how many values are inside their intervals."""
    for way, parts in found.items():
        for part, counts in parts.items():
            held = part == "held out"
            own = [r for r in rows if r["way"] == way and (r["machine"] in held_out) is held]
            inside, of = (sum(r["values"][k] for r in own) for k in (0, 1))
            counts |= {"values inside": inside, "values": of}
            print(f"{way}, {part}: {inside} of {of} values inside their intervals")
    return found


def misjudged(model: Model, rng: np.random.Generator) -> Model:
    """Return a model whose free values are wrong by a tenth of them to `OFF`."""
    parameters = dict(model.parameters)
    for name in model.free_parameters:
        own = parameters[name]
        value = own.value * (1.0 + OFF * rng.uniform(0.4, 1.0) * rng.choice([-1.0, 1.0]))
        parameters[name] = replace(own, value=value)
    return replace(model, parameters=parameters)


def within(truth: Model, calibration: dict[str, Any]) -> tuple[int, int]:
    """Return how many values are inside their intervals of 95 %, and how many there are."""
    ends = {name: row["ci95"] for name, row in calibration.items()}
    inside = [low <= truth.parameters[name].value <= high for name, (low, high) in ends.items()]
    return sum(inside), len(inside)


def answered_with_values(
    machine: Machine, model: Model, recordings: Sequence[Recording], lacking: bool, budget: float
) -> Row:
    """Return what is told of a machine by a model with wrong values, and lacking a law or none."""
    began = clock.now()
    found = diagnose(Simulator(model), list(recordings), budget=budget)
    laws = [f for f in found.findings if f["mechanism"] != "wrong_value"]
    told = [(f["mechanism"], f["site"]) for f in laws]
    wanted = [(machine.mechanism, f"equation:{machine.state}")] if lacking else []
    return {
        "verdict": found.verdict,
        "findings": told,
        "probability": laws[0]["probability"] if laws else None,
        "right": found.verdict == ("structure" if lacking else "parameter") and told == wanted,
        "values": [*within(machine.model, found.document["calibration"])],
        "seconds": round(clock.now() - began, 1),
    }


def told_with_values(row: Row) -> str:
    """Return the row of such an answer as a line."""
    what = ", ".join(f"{mechanism} at {site}" for mechanism, site in row["findings"]) or "-"
    mark = "right" if row["right"] else "WRONG"
    inside, of = row["values"]
    name = f"{row['machine']}, {'a law missing' if row['lacking'] else 'values'}, {row['way']}"
    took = f"{inside} of {of} values, {row['seconds']} s"
    return f"{name:68} {mark} {row['verdict']}: {what} ({took})"
