"""The runner: one ``jaxsr diagnose`` a case, with a time limit; what is done is not done again."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from benchmarks.concealed.sealing import sha256
from jaxsr._files import atomic_write_text, dump_json
from jaxsr._result import InputError

TOOL = "jaxsr"
GRACE = 120.0
"""Seconds beyond the limit after which a case is stopped from outside."""


def sealed(folder: Path) -> dict[str, Any]:
    """Return ``sealed.json``.

    Raises
    ------
    InputError
        The folder holds no sealed cases.
    """
    path = folder / "sealed.json"
    if not path.exists():
        raise InputError("holds no sealed cases", str(folder), "Seal them first")
    return json.loads(path.read_text(encoding="utf-8"))


def wrong_files(folder: Path, document: Mapping[str, Any]) -> list[str]:
    """Return the files of cases that differ from what was sealed."""
    wrong = []
    for name, digest in document["files_sha256"].items():
        path = folder / name
        if not path.exists() or sha256(path) != digest:
            wrong.append(name)
    return wrong


def cases(folder: Path) -> list[str]:
    """Return the names of the cases, checked against what was sealed.

    Raises
    ------
    InputError
        A case was changed after sealing.
    """
    changed = wrong_files(folder, sealed(folder))
    if changed:
        raise InputError("was changed after sealing", changed[0], "Seal the cases again")
    return sorted(p.name for p in (folder / "cases").iterdir() if p.is_dir())


def methods(folder: Path) -> list[str]:
    """Return the methods that have answers, the tool first."""
    found = sorted(p.name for p in (folder / "answers").glob("*") if p.is_dir())
    return sorted(found, key=lambda m: (m != TOOL, m))


def answer_of(folder: Path, method: str, case: str) -> dict[str, Any] | None:
    """Return a method's answer to a case, None where it has none."""
    path = folder / "answers" / method / case / "diagnosis.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def command(folder: Path, case: str, limit: float, padded: bool) -> list[str]:
    """Return the command line of a case."""
    place = folder / "cases" / case
    given = json.loads((place / "case.json").read_text(encoding="utf-8"))
    words = [sys.executable, "-m", TOOL, "diagnose", str(place / given["model"])]
    words += [str(place / f) for f in given["data"]]
    words += ["--held-out", *(str(place / f) for f in given["held_out"])]
    words += ["--out", str(folder / "answers" / TOOL / case), "--seed", str(given["seed"])]
    words += ["--budget", f"{limit:g}"]
    if padded and given["candidates"]:
        words += ["--candidates", str(place / given["candidates"])]
    return words


def takes_candidates() -> bool:
    """Whether the command takes a user's candidates; decoys are passed only then."""
    words = [sys.executable, "-m", TOOL, "diagnose", "--help"]
    wide = {**os.environ, "COLUMNS": "200"}
    out = subprocess.run(words, capture_output=True, text=True, env=wide, check=False)
    return "--candidates" in out.stdout


def run_tool(folder: Path, case: str, limit: float, padded: bool) -> dict[str, Any]:
    """Run the tool on a case; return how it went."""
    began = time.perf_counter()
    try:
        done = subprocess.run(
            command(folder, case, limit, padded),
            capture_output=True,
            text=True,
            timeout=limit + GRACE,
            check=False,
        )
        status, said = done.returncode, done.stderr[-2000:]
    except subprocess.TimeoutExpired:
        status, said = None, f"stopped from outside {GRACE:g} s after its limit"
    return {
        "case": case,
        "status": status,
        "seconds": round(time.perf_counter() - began, 1),
        "limit": limit,
        "decoys": padded,
        "stderr": said if status else "",
    }


def run(
    folder: Path,
    limit: float,
    jobs: int = 1,
    again: bool = False,
    baselines: Mapping[str, Callable[[Path], dict[str, Any]]] | None = None,
    only: Sequence[str] = (),
) -> int:
    """Run a method, or all baselines, on every case not yet done; return how many ran.

    Parameters
    ----------
    again : bool
        Run cases again that failed.
    baselines : mapping, optional
        From a name to a function of a case's folder, in place of the tool.
    only : sequence of str
        Cases to run; all by default.
    """
    names = [n for n in cases(folder) if not only or n in only]
    if baselines is None:
        padded = takes_candidates()
        work = [(TOOL, n, lambda n=n: run_tool(folder, n, limit, padded)) for n in names]
    else:
        work = [
            (b, n, lambda b=b, n=n, f=f: run_baseline(folder, b, n, f))
            for b, f in baselines.items()
            for n in names
        ]
    todo = [(m, n, job) for m, n, job in work if not _done(folder, m, n, again)]

    def perform(item: tuple[str, str, Callable[[], dict[str, Any]]]) -> None:
        method, name, job = item
        report = job()
        path = folder / "answers" / method / f"{name}.run.json"
        atomic_write_text(path, dump_json(report))
        print(f"{method} {name}: status {report['status']}, {report['seconds']} s", flush=True)

    if baselines is not None or jobs == 1:
        for item in todo:
            perform(item)
    else:
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(perform, todo))
    return len(todo)


def _done(folder: Path, method: str, case: str, again: bool) -> bool:
    path = folder / "answers" / method / f"{case}.run.json"
    if not path.exists():
        return False
    return not again or json.loads(path.read_text(encoding="utf-8"))["status"] == 0


def run_baseline(
    folder: Path, method: str, case: str, function: Callable[[Path], dict[str, Any]]
) -> dict[str, Any]:
    """Run a baseline on a case; a failure of its own is an answer that is missing."""
    began = time.perf_counter()
    status, said = 0, ""
    try:
        answer = function(folder / "cases" / case)
        answer["provenance"] = {"seconds": round(time.perf_counter() - began, 1)}
        atomic_write_text(folder / "answers" / method / case / "diagnosis.json", dump_json(answer))
    except (ArithmeticError, ValueError, ImportError) as error:
        status, said = 1, f"{type(error).__name__}: {error}"
    return {
        "case": case,
        "status": status,
        "seconds": round(time.perf_counter() - began, 1),
        "stderr": said,
    }
