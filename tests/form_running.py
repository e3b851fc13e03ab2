"""Run a form, in a process of its own or in this one, and list what is wrong with the answer.

Budgets and times are of processor time (`jaxsr._clock`): what runs beside changes no answer.
"""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
import tomllib
import traceback
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import diagnosis_schema
import numpy as np
import pandas as pd
from forms import Form

ROOT = Path(__file__).resolve().parents[1]
GRACE = 8.0
"""Budgets after which a job that has not ended is killed."""
LATE = 1.1
"""Budgets within which a command ends."""
PATIENCE = 10.0
"""Seconds more that a job in this process may take: it compiles."""
ASLEEP = 1200.0
"""Seconds of wall time after which a job hangs that takes no processor time."""
SIMULATING = 60.0
"""Seconds that a simulation may take."""
_FRAME = re.compile(r'File "([^"]+)", line (\d+), in (\S+)')


@dataclass(frozen=True)
class Outcome:
    """What a form came to.

    Attributes
    ----------
    label : str
    status : int or None
        Exit status; None where it had to be killed.
    seconds : float
        Processor time, of the process and of those that it began.
    verdict : str
    problems : tuple of str
        Empty where all is right. The part before ``": "`` tells the kind.
    """

    label: str
    status: int | None
    seconds: float
    verdict: str = ""
    problems: tuple[str, ...] = field(default=())


def run_form(form: Form, folder: Path, budget: float) -> Outcome:
    """Run the command on a form in a process of its own."""
    form.write(folder)
    limit = GRACE * budget
    done, seconds = _command([*form.arguments(), "--budget", f"{budget:g}"], folder, limit)
    if done is None:
        return Outcome(form.label, None, seconds, "", (f"hang: no end after {limit:.0f} s",))
    found = _answer(form, done.returncode, done.stderr)
    if seconds > LATE * budget:
        over = "over" if seconds <= LATE * budget + budget else "far over"
        found.append(f"{over} budget: {seconds:.1f} s at a budget of {budget:g} s")
    verdict = ""
    if done.returncode == 0:
        verdict, more = _document(form, folder, (folder / "out" / "diagnosis.json").read_text())
        found += more
        found += _explained(form, folder)
    return Outcome(form.label, done.returncode, seconds, verdict, tuple(found))


class Hang(BaseException):
    """A job in this process has not ended; no handler of exceptions inside it may catch this."""


@contextmanager
def _on_processor_time(seconds: float) -> Iterator[None]:
    """Count budgets in processor time, and raise `Hang` in the main thread after so much of it."""

    def ring(number: int, frame: Any) -> None:
        raise Hang

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        with patch.dict(os.environ, JAXSR_CLOCK="processor"):
            yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def diagnose_here(form: Form, folder: Path, budget: float) -> Outcome:
    """Diagnose a form in this process; its report is not written."""
    import jaxsr
    from jaxsr._files import dump_json
    from jaxsr._result import InputError
    from jaxsr.models import model_text

    form.write(folder)
    began = time.process_time()
    status, verdict, found = 0, "", []
    try:
        with _on_processor_time(GRACE * budget + PATIENCE), warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", category=DeprecationWarning)
            given = folder / form.simulator
            found_here = jaxsr.diagnose(
                jaxsr.Simulator.from_file(str(given)),
                [folder / name for name in form.data],
                held_out=[folder / name for name in form.held_out],
                budget=budget,
            )
            text, explained = dump_json(found_here.document), model_text(found_here.model)
    except InputError as error:
        status, found = 2, _refusal(form, str(error))
    except Hang as error:
        place = crash("".join(traceback.format_exception(error))).removeprefix("traceback: ")
        status, found = 1, [f"hang: no end after {GRACE:g} budgets, at {place}"]
    except Exception as error:
        status, found = 1, [crash("".join(traceback.format_exception(error)))]
    else:
        verdict, found = _document(form, folder, text)
        (folder / "out").mkdir(exist_ok=True)
        (folder / "out" / "explained.toml").write_text(explained, encoding="utf-8")
        found += _explained(form, folder, here=True)
    return Outcome(form.label, status, time.process_time() - began, verdict, tuple(found))


def crash(text: str) -> str:
    """Return the exception and the place of a traceback: the last frame inside jaxsr."""
    last = text.strip().splitlines()
    words = next((x for x in reversed(last) if re.match(r"[\w.]+(:|$)", x)), last[-1])
    frames = [m for m in _FRAME.findall(text) if f"{os.sep}jaxsr{os.sep}" in m[0]]
    if not frames:
        return f"traceback: {words[:120]}"
    path, line, name = frames[-1]
    inside = path.rpartition(f"{os.sep}jaxsr{os.sep}")[2]
    return f"traceback: {words.split(':')[0]} {inside}:{line} {name}: {words[:100]}"


def _command(
    arguments: list[str], folder: Path, limit: float
) -> tuple[subprocess.CompletedProcess[str] | None, float]:
    """Run a command, and return its end and its processor time in s.

    None is returned where it had to be killed.
    """
    environment = {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "JAXSR_CLOCK": "processor"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxsr", *arguments],
        cwd=folder,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    hard = int(limit) + 1
    resource.prlimit(process.pid, resource.RLIMIT_CPU, (hard, hard))
    asleep = threading.Timer(ASLEEP, process.kill)
    asleep.start()
    out, err = process.communicate()
    asleep.cancel()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    if process.returncode in (-signal.SIGKILL, -signal.SIGXCPU):
        return None, seconds
    return subprocess.CompletedProcess(arguments, process.returncode, out, err), seconds


def _answer(form: Form, status: int, stderr: str) -> list[str]:
    """Say what is wrong with exit status and stderr."""
    found = []
    if "Traceback" in stderr:
        found.append(crash(stderr.rpartition("jaxsr: this is a defect")[0] or stderr))
    elif status not in (0, 2):
        found.append(f"status {status}: {stderr.strip().splitlines()[-1:]}")
    warning = re.search(r"^(\S+):(\d+): (\w*Warning): (.*)$", stderr, re.M)
    if warning:
        path, line, kind, words = warning.groups()
        inside = path.rpartition(f"{os.sep}jaxsr{os.sep}")[2]
        found.append(f"warning: {kind} {inside}:{line}: {words[:80]}")
    elif "Warning" in stderr:
        found.append(f"warning: {next(x for x in stderr.splitlines() if 'Warning' in x)[:160]}")
    if status == 2:
        errors = [x for x in stderr.splitlines() if x.startswith("jaxsr: error: ")]
        if len(errors) != 1:
            found.append(f"refusal: {len(errors)} lines of error")
        else:
            found += _refusal(form, errors[0].removeprefix("jaxsr: error: "))
    return found


def _refusal(form: Form, message: str) -> list[str]:
    found = []
    if form.sound:
        found.append(f"refused though sound: {message}")
    if "\n" in message or len(message) > 500:
        found.append(f"refusal: not one line: {message[:200]}")
    if not any(name.rpartition(".")[0] in message for name in form.files) and "form" not in message:
        found.append(f"refusal: names no file: {message[:160]}")
    return found


def _document(form: Form, folder: Path, text: str) -> tuple[str, list[str]]:
    """Return the verdict, and what is wrong with the document."""
    try:
        document = diagnosis_schema.strict_json(text)
    except ValueError as error:
        return "", [f"json: {error}"]
    given = tomllib.loads(form.files["m.toml"])
    head = given["model"]
    names = {key: tuple(head.get(key, ())) for key in ("states", "inputs", "outputs")}
    names |= {"parameters": tuple(given.get("parameters", ())), "files": form.data}
    found = [f"schema: {line}" for line in diagnosis_schema.problems(document, names)]
    for finding in document.get("findings", []):
        found += _edit(finding, given)
    broken = [row["message"] for row in document.get("data_checks", []) if row["check"] == "search"]
    found += [
        f"step of the search: {line}" for line in broken if form.sound and " broke off (" in line
    ]
    held = (document.get("fit") or {}).get("held_out")
    if bool(held) != bool(form.held_out):
        found.append(f"schema: fit.held_out is {held!r} with {len(form.held_out)} held-out files")
    return str(document.get("verdict", "")), found


def _edit(finding: Mapping[str, Any], given: Mapping[str, Any]) -> list[str]:
    """Whether a finding's edit alone, applied to the given file, is a model again."""
    from jaxsr._result import InputError
    from jaxsr.models import parse_model

    label = f"{finding.get('mechanism')}@{finding.get('site')}"
    try:
        parse_model(toml_text(edited(given, finding.get("edit", {}))), "edited.toml")
    except InputError as error:
        return [f"edit: {label} alone is no model: {str(error)[:160]}"]
    except Exception as error:
        return [f"edit: {label} alone: {crash(''.join(traceback.format_exception(error)))}"]
    return []


def edited(given: Mapping[str, Any], edit: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a model file with an edit's keys set."""
    document = json.loads(json.dumps(given))
    for key, value in edit.items():
        *path, last = key.split(".")
        table = document
        for part in path:
            table = table.setdefault(part, {})
        if isinstance(value, dict):
            value = {k: v for k, v in value.items() if v is not None}
        table[last] = value
    return document


def toml_text(document: Mapping[str, Any]) -> str:
    """Write the tables of a model file as TOML."""
    lines = []
    for name, table in document.items():
        rows = table if isinstance(table, list) else [table]
        mark = ("[[", "]]") if isinstance(table, list) else ("[", "]")
        for row in rows:
            lines.append(f"{mark[0]}{name}{mark[1]}")
            lines += [f"{json.dumps(k)} = {_value(v)}" for k, v in row.items()]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {_value(v)}" for k, v in value.items()) + " }"
    return json.dumps(value)


def _explained(form: Form, folder: Path, here: bool = False) -> list[str]:
    """Say what is wrong with explained.toml: it reads, and it runs on the first recording."""
    text = (folder / "out" / "explained.toml").read_text(encoding="utf-8")
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        return [f"explained: no TOML: {error}"]
    run = folder / "explained"
    run.mkdir(exist_ok=True)
    name = "m.toml" if "m.py" in form.files else "explained.toml"
    (run / name).write_text(text, encoding="utf-8")
    if "m.py" in form.files:
        (run / "m.py").write_text(form.files["m.py"], encoding="utf-8")
    simulator = "m.py:f" if "m.py" in form.files else name
    first = form.data[0]
    if here:
        return _runs_here(form, run / simulator, folder / first)
    arguments = ["simulate", str(simulator), str((folder / first).resolve()), "--out", "s.csv"]
    done, _ = _command(arguments, run, SIMULATING)
    if done is None:
        return [f"explained: simulate did not end in {SIMULATING:g} s"]
    if "Traceback" in done.stderr:
        return [f"explained: {crash(done.stderr.rpartition('jaxsr: this is')[0])}"]
    if done.returncode != 0:
        # A law may have no simulation over the whole recording with any values.
        arguments = ["simulate", form.simulator, first, "--out", "given.csv"]
        given, _ = _command(arguments, folder, SIMULATING)
        hopeless = form.wild or (given is not None and given.returncode == 2)
        return [] if hopeless else [f"explained: does not run: {done.stderr.strip()[:160]}"]
    return _finite(pd.read_csv(run / "s.csv"), form)


def _runs_here(form: Form, simulator: Path, recording: Path) -> list[str]:
    from jaxsr._result import InputError

    try:
        return _finite(_simulated(simulator, recording), form)
    except InputError as error:
        problem = f"explained: does not run: {str(error)[:160]}"
    except Exception as error:
        return [f"explained: {crash(''.join(traceback.format_exception(error)))}"]
    try:
        _simulated(recording.parent / form.simulator, recording)
    except InputError:  # a law may have no simulation over the whole recording with any values
        return []
    return [] if form.wild else [problem]


def _simulated(simulator: Path, recording: Path) -> pd.DataFrame:
    """Simulate in this process with the inputs of a recording."""
    import jaxsr
    from jaxsr.models.simulation import simulate_to_csv

    read = jaxsr.Simulator.from_file(str(simulator))
    model = read.model
    record = jaxsr.read_recording(
        recording, time=model.columns.get(model.time), sample_time=model.sample_time
    )
    return simulate_to_csv(read, record)


def _finite(table: pd.DataFrame, form: Form) -> list[str]:
    outputs = tomllib.loads(form.files["m.toml"])["model"]["outputs"]
    numbers = table[[column for column in outputs if column in table]].to_numpy(dtype=float)
    return [] if np.all(np.isfinite(numbers)) else ["explained: the run is not finite"]
