"""Forms of models and recordings (`tests/forms.py`): each ends in an answer, within its budget.

    python -m benchmarks.answered_forms [--quick] [--numbers A-B,C,..] [--budget S] [--whole]

A form is right where `jaxsr diagnose` ends with status 0 within 1.1 times its budget of processor
time, its document holds no NaN and its explained model runs, or with status 2 and one line that
names a file, where its kind may be refused; no traceback and no warning. Commands run in copies of
a process that has loaded the libraries, so that a form takes half the time; --whole: in processes
of their own, as a user starts them, with loading in the budget.
Results, as they come: ``results/answered_forms.json``, a row a form, and a summary by kinds of
what went wrong; the rows of forms that are not asked for stay. --quick: four small forms, no file,
and their time is not judged. Ends with status 1 if a form that was asked for is not right.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any
from unittest.mock import patch

from benchmarks.provenance import RESULTS, ROOT, engine, write

sys.path.insert(0, str(ROOT / "tests"))

import form_running  # pyright: ignore[reportMissingImports]
from form_summary import kind_of  # pyright: ignore[reportMissingImports]
from forms import form  # pyright: ignore[reportMissingImports]

BUDGET, QUICK_BUDGET = 2.5, 1.0
"""Seconds of processor time, loaded libraries aside."""
QUICK = (0, 13, 26, 39)
LIBRARIES = (
    "jaxsr.cli",
    "jaxsr.evaluation",
    "jaxsr.diagnosis.diagnose",
    "jaxsr.models.simulation",
    "jaxsr.report.page",
    "jaxsr.report.diagnosis_report",
    "matplotlib.figure",
    "pandas",
)


def forked(
    arguments: Sequence[str], folder: Path, limit: float
) -> tuple[subprocess.CompletedProcess[str] | None, float]:
    """Run a command in a copy of this process; return its end, and its processor time in s.

    Takes the place of what `form_running` starts anew. None stands for a command that had to be
    ended.
    """
    out, err = folder / ".stdout", folder / ".stderr"
    pid = os.fork()
    if pid == 0:
        _command(arguments, folder, out, err, int(limit) + 1)
    asleep = threading.Timer(form_running.ASLEEP, os.kill, (pid, signal.SIGKILL))
    asleep.start()
    _, status, usage = os.wait4(pid, 0)
    asleep.cancel()
    code, seconds = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
    if code in (-signal.SIGKILL, -signal.SIGXCPU):
        return None, seconds
    texts = out.read_text(encoding="utf-8"), err.read_text(encoding="utf-8")
    return subprocess.CompletedProcess(arguments, code, *texts), seconds


def _command(arguments: Sequence[str], folder: Path, out: Path, err: Path, limit: int) -> None:
    """Be the command, and end with its status."""
    status = 1
    try:
        os.chdir(folder)
        sys.stdout, sys.stderr = (open(p, "w", encoding="utf-8") for p in (out, err))
        os.dup2(sys.stdout.fileno(), 1)
        os.dup2(sys.stderr.fileno(), 2)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        sys.argv = ["jaxsr", *arguments]
        status = importlib.import_module("jaxsr.__main__").main()
    except BaseException as error:
        traceback.print_exception(error)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def kept() -> dict[int, dict[str, Any]]:
    """Return the rows of the result by the forms' numbers."""
    path = RESULTS / "answered_forms.json"
    rows = json.loads(path.read_text(encoding="utf-8"))["forms"] if path.is_file() else []
    return {row["number"]: row for row in rows}


def summary(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return how many forms are right, how they ended, and the kinds of what was wrong."""
    wrong: dict[str, list[int]] = {}
    for row in rows:
        for kind in dict.fromkeys(map(kind_of, row["problems"])):
            wrong.setdefault(kind, []).append(row["number"])
    return {
        "forms": len(rows),
        "right": sum(not row["problems"] for row in rows),
        "answered": sum(row["status"] == 0 for row in rows),
        "refused": sum(row["status"] == 2 for row in rows),
        "wrong": wrong,
    }


def numbers(text: str) -> list[int]:
    """Read ``76-80,391`` as numbers."""
    found = []
    for word in text.split(","):
        first, _, last = word.partition("-")
        found += range(int(first), int(last or first) + 1)
    return found


def main() -> int:
    """Run, print, write; 1 where a form is not right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="four small forms, no file")
    parser.add_argument("--numbers", type=numbers, default=numbers("0-499"), help="of the forms")
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds of processor time")
    parser.add_argument("--whole", action="store_true", help="loading is in the budget")
    given = parser.parse_args()
    asked = QUICK if given.quick else given.numbers
    budget = QUICK_BUDGET if given.quick else given.budget
    own = {"JAXSR_CLOCK": "processor", "MPLBACKEND": "Agg"}
    rows, commit = ({} if given.quick else kept()), engine()
    runs = form_running._command if given.whole else forked
    with patch.dict(os.environ, own), patch.object(form_running, "_command", runs):
        for name in () if given.whole else LIBRARIES:
            importlib.import_module(name)
        for number in asked:
            with tempfile.TemporaryDirectory() as folder:
                found = form_running.run_form(form(number, given.quick), Path(folder), budget)
            told = {**asdict(found), "seconds": round(found.seconds, 2)}
            settings = {"budget": budget, "whole": given.whole, "engine": commit}
            rows[number] = {"number": number, **told, **settings}
            print(f"{found.label}: {'; '.join(found.problems) or found.verdict or 'refused'}")
            if not given.quick:
                every = [rows[n] for n in sorted(rows)]
                body = {"summary": summary(every), "forms": every}
                write("answered_forms", "forms of models and recordings", [0], body)
    told = summary([rows[number] for number in asked])
    print(told)
    late = "over budget" if given.quick else "\0"  # a matter of the machine
    return int(any(late not in p for n in asked for p in rows[n]["problems"]))


if __name__ == "__main__":
    sys.exit(main())
