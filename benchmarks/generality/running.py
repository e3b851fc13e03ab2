"""Cases made, answered and kept: one JSON line an answer, so that nothing done is done again."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.generality.engines import answered
from benchmarks.generality.plan import Ticket
from benchmarks.generality.plant import Escaped
from benchmarks.generality.planting import SAMPLES, planted
from benchmarks.generality.systems import SYSTEMS
from benchmarks.generality.writing import written
from jaxsr._files import atomic_write_text, dump_json
from jaxsr._result import InputError

ANSWERS = "answers.jsonl"


def made(ticket: Ticket, seed: int, out: Path, samples: int = SAMPLES) -> str:
    """Make a case; return its name, or nothing where no motion stays within bounds."""
    folder = out / "cases" / ticket.name
    if not (folder / "truth.json").exists():
        try:
            case = planted(ticket, seed, SYSTEMS[ticket.system], samples)
        except Escaped:
            return ""
        written(case, folder, seed)
    return ticket.name


def begun(out: Path, seed: int) -> None:
    """Mark a folder as that of a seed.

    Raises
    ------
    InputError
        The folder holds cases of another seed.
    """
    mark = out / "sealed.json"
    if mark.exists() and json.loads(mark.read_text(encoding="utf-8"))["seed"] != seed:
        raise InputError("holds cases of another seed", str(out), "Name another place with --out")
    atomic_write_text(mark, dump_json({"schema": "jaxsr.generality/1", "seed": seed}))


def seed_of(out: Path) -> int:
    """Return the seed of the cases in a folder."""
    return int(json.loads((out / "sealed.json").read_text(encoding="utf-8"))["seed"])


def truth_of(out: Path, name: str) -> dict[str, Any]:
    """Return the truth of a case."""
    return json.loads((out / "cases" / name / "truth.json").read_text(encoding="utf-8"))


def answers(out: Path) -> list[dict[str, Any]]:
    """Return the answers that are there, the last one of every case and engine."""
    path = out / ANSWERS
    if not path.exists():
        return []
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return list({(r["engine"], r["case"]): r for r in rows}.values())


def run(
    out: Path,
    seed: int,
    tickets: Sequence[Ticket],
    engines: Sequence[str],
    budget: float,
    jobs: int = 1,
) -> None:
    """Make and answer what was not yet, case by case, and print each answer."""
    done = {(r["engine"], r["case"]) for r in answers(out)}
    todo = []
    for ticket in tickets:
        left = tuple(e for e in engines if (e, ticket.name) not in done)
        if left:
            todo.append((ticket, seed, out, left, budget))
    with (out / ANSWERS).open("a", encoding="utf-8") as file:
        for rows in _mapped(worked, todo, jobs):
            for row in rows:
                # dump_json writes no NaN
                file.write(json.dumps(json.loads(dump_json(row))) + "\n")
                file.flush()
                said = (row["answer"] or {}).get("verdict", "")
                print(
                    f"{row['engine']} {row['case']}: {said or row['broke']}, "
                    f"{row['cpu_seconds']} s of the processor",
                    flush=True,
                )


def worked(
    ticket: Ticket, seed: int, out: Path, engines: Sequence[str], budget: float
) -> list[dict[str, Any]]:
    """Make a case and answer it; no answers where no motion stays within bounds."""
    name = made(ticket, seed, out)
    return [answered(engine, out, name, budget) for engine in engines] if name else []


def gathered(out: Path) -> dict[str, Any]:
    """Write the truths of all cases to one file, as the sealed sets have it; return them."""
    truths = {p.name: truth_of(out, p.name) for p in sorted((out / "cases").iterdir())}
    atomic_write_text(out / "truth" / "truth.json", dump_json({"cases": truths}))
    return truths


def _mapped(function: Any, todo: Sequence[tuple], jobs: int) -> Iterable[Any]:
    if jobs == 1:
        yield from (function(*item) for item in todo)
        return
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        yield from pool.map(function, *zip(*todo, strict=True)) if todo else ()
