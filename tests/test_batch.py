"""Many diagnoses: the same files as one by one, failures tried again, nothing done twice."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import jaxsr
from jaxsr import cli
from jaxsr.batch import Case, Fleet, cluster, diagnose_many, engine, many, read_cases
from jaxsr.batch.task import DONE, Outcome, Task

DECAY = """
[model]
states = ["x"]
inputs = ["u"]
outputs = ["x"]
[equations]
x = "u - k*x"
[readings]
x = "x"
[parameters]
k = { value = 1.0, bounds = [0.1, 5.0] }
"""
CASES = """
[defaults]
model = "decay.toml"
[cases.slow]
data = "a.csv"
[cases.fast]
data = ["b.csv"]
held_out = ["a.csv"]
seed = 1
memory = 8.0
"""


def record(name: str, k: float, seed: int) -> None:
    """Sixty samples of x' = u - k x under a sine, by small Euler steps, with noise of 1e-3."""
    t = np.arange(60) * 0.05
    u, x, fine = np.sin(2.0 * t), np.zeros(60), 50
    for i in range(59):
        x[i + 1] = x[i]
        for j in range(fine):
            x[i + 1] += 0.05 / fine * (u[i] + (u[i + 1] - u[i]) * (j + 0.5) / fine - k * x[i + 1])
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(60)
    pd.DataFrame({"t": t, "u": u, "x": x + noise}).to_csv(name, index=False)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    record("a.csv", 0.8, 1)
    record("b.csv", 1.2, 2)
    Path("decay.toml").write_text(DECAY)
    Path("cases.toml").write_text(CASES)
    return tmp_path


def but_for_seconds(path: Path) -> bytes:
    """Return a file's bytes, the seconds that a run took left out."""
    text = path.read_bytes()
    if path.suffix == ".json":
        return re.sub(rb'"seconds": [0-9.]+', b"", text)
    return re.sub(rb"<dt>Time taken</dt>\s*<dd>.*?</dd>", b"", text)


@pytest.mark.long
def test_files_are_those_of_single_runs_and_are_not_made_twice(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["batch", "cases.toml", "--out", "many", "--workers", "2"]) == 0
    said = capsys.readouterr()
    assert "2 of 2" in said.err and "Page: many/batch.html" in said.out
    # The same command by itself, to the same place.
    os.rename("many/fast", "kept")
    command = "diagnose ./decay.toml b.csv --held-out a.csv --out many/fast --seed 1".split()
    command[1] = "decay.toml"
    assert cli.main(command) == 0
    names = sorted(path.name for path in Path("kept").iterdir())
    assert names == sorted(path.name for path in Path("many/fast").iterdir())
    assert {"diagnosis.json", "explained.toml", "report.html"} < set(names)
    for name in names:
        alone, together = Path("many/fast", name), Path("kept", name)
        assert but_for_seconds(alone) == but_for_seconds(together), name

    before = {path: path.stat().st_mtime_ns for path in Path("many").rglob("diagnosis.json")}
    assert cli.main(["batch", "cases.toml", "--out", "many", "--resume"]) == 0
    assert "2 of 2 cases are done already" in capsys.readouterr().err
    assert before == {path: path.stat().st_mtime_ns for path in before}
    table = pd.read_csv("many/batch.csv")
    assert table.case.tolist() == ["slow", "fast"] and set(table.verdict) == {"parameter"}
    for value, low, high, k in zip(table.value, table.low, table.high, (0.8, 1.2), strict=True):
        assert low < value < high and value == pytest.approx(k, abs=0.02)
    page = Path("many/batch.html").read_text()
    assert 'href="fast/report.html"' in page and "median" in page


@pytest.mark.parametrize("workers", [1, 2])
def test_failures_are_tried_once_more_and_listed(
    folder: Path, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[str] = []

    def run(task: Task, stop: Callable[[], bool]) -> Outcome:
        tried.append(task.name)
        if task.name == "refused":
            return Outcome(task.name, 2, "jaxsr: error: a.csv: no column 'x'")
        if task.name == "crash" or tried.count(task.name) == 1:
            return Outcome(task.name, -int(signal.SIGSEGV))
        return finished(task)

    monkeypatch.setattr(engine, "run_task", run)
    case = Case("decay.toml", ("a.csv",))
    names = ("crash", "flaky", "refused")
    fleet = diagnose_many(dict.fromkeys(names, case), "out", workers=workers)
    assert sorted(tried) == ["crash", "crash", "flaky", "flaky", "refused"]
    assert fleet.failures == {
        "crash": "ended by signal SIGSEGV",
        "refused": "a.csv: no column 'x'",
    }
    assert list(fleet) == ["flaky"] and fleet["flaky"].verdict == "nothing"
    with pytest.raises(jaxsr.InputError, match="no diagnosis of 'crash': ended by signal"):
        fleet["crash"]
    assert pd.read_csv("out/batch.csv").status.tolist() == ["failed", "done", "failed"]
    assert "ended by signal SIGSEGV" in Path("out/batch.html").read_text()


def finished(task: Task) -> Outcome:
    """Write what a case without any finding writes."""
    results = Path(task.results)
    results.mkdir(parents=True, exist_ok=True)
    document = {
        **{"schema": "jaxsr.diagnosis/1", "verdict": "nothing", "findings": []},
        **{"fit": {}, "provenance": {}},
    }
    (results / "diagnosis.json").write_text(json.dumps(document))
    (results / "explained.toml").write_text(DECAY)
    task.mark.write_text(task.case.key(task.results))
    return Outcome(task.name, DONE)


def test_what_changed_is_done_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []

    def run(task: Task, stop: Callable[[], bool]) -> Outcome:
        ran.append(task.name)
        return finished(task)

    monkeypatch.setattr(engine, "run_task", run)
    for change in (None, "decay.toml", "a.csv", "option", "results"):
        ran.clear()
        if change == "option":
            text = Path("cases.toml").read_text()
            Path("cases.toml").write_text(text.replace("seed = 1", "seed = 2"))
        elif change == "results":
            Path("out/slow/diagnosis.json").unlink()
        elif change is not None:
            Path(change).write_text(Path(change).read_text() + "\n")
        diagnose_many("cases.toml", "out", resume=True)
        first = {"option": ["fast"], "results": ["slow"]}.get(str(change), ["slow", "fast"])
        assert ran == first, change
        diagnose_many("cases.toml", "out", resume=True)
        assert ran == first


def test_a_batch_that_is_asked_to_end_begins_no_more(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []

    def run(task: Task, stop: Callable[[], bool]) -> Outcome:
        ran.append(task.name)
        return finished(task)

    monkeypatch.setattr(engine, "run_task", run)
    fleet = diagnose_many("cases.toml", "out", stop=lambda: bool(ran))
    assert ran == ["slow"] and fleet.waiting == ("fast",)
    assert pd.read_csv("out/batch.csv").status.tolist() == ["done", "waiting"]


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_killed_in_the_middle_nothing_is_lost_and_nothing_goes_on(
    folder: Path, workers: int
) -> None:
    """The batch is killed outright: its processes end, results stay, --resume does the rest."""
    command = [sys.executable, "-m", "jaxsr", "batch", "cases.toml", "--out", "out"]
    environment = {**os.environ, "PYTHONPATH": str(Path(jaxsr.__file__).parents[1])}
    batch = subprocess.Popen([*command, "--workers", str(workers)], env=environment)
    children: list[int] = []
    end = time.monotonic() + 120.0
    while not children and time.monotonic() < end and batch.poll() is None:
        time.sleep(0.1)
        found = subprocess.run(["ps", "-o", "pid=", "--ppid", str(batch.pid)], capture_output=True)
        children = [int(word) for word in found.stdout.split()]
    batch.kill()
    batch.wait()
    assert children
    end = time.monotonic() + 60.0
    while any(Path(f"/proc/{pid}").exists() for pid in children) and time.monotonic() < end:
        time.sleep(0.2)
    assert not any(Path(f"/proc/{pid}").exists() for pid in children)
    done = subprocess.run([*command, "--resume"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert len(list(Path("out").glob("*/diagnosis.json"))) == 2


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = 1", "unknown table 'x'"),
        ("[defaults]\nseed = 1", "no case"),
        ("[cases]\na = 1", "must be a table"),
        ("[cases.a]\ndata = 'a.csv'", "no model"),
        ("[cases.a]\nmodel = 'decay.toml'", "no data"),
        ("[cases.a]\nmodel = 'decay.toml'\ndata = 3", "must name files"),
        ("[cases.a]\nmodel = 'decay.toml'\ndata = 'a.csv'\nbudgets = 3", "unknown key 'budgets'"),
        ("[cases.a]\nmodel = 'decay.toml'\ndata = 'a.csv'\nbudget = -3", "budget -3"),
        ("[cases.a]\nmodel = 'decay.toml'\ndata = 'a.csv'\nseed = 1.5", "seed 1.5"),
        ("[cases.'../a']\nmodel = 'decay.toml'\ndata = 'a.csv'", "cannot name a case"),
        ("[cases.a]\nmodel = 'm.py:f'\ndata = 'a.csv'", "Python, which runs only where a call"),
        ("[cases.a]\nmodel = 'decay.toml'\ndata = 'no.csv'", "data no.csv: cannot be read"),
        ("[cases.a]\nmodel = 'decay.toml'\ndata = 'a.csv'\nheld_out = 'a.csv'", "two places"),
    ],
)
def test_cases_are_refused_in_a_line(folder: Path, text: str, said: str) -> None:
    Path("cases.toml").write_text(text.replace("'", '"'))
    with pytest.raises(jaxsr.InputError, match=re.escape(said)) as caught:
        many.diagnose_many("cases.toml", "out")
    assert "\n" not in str(caught.value)
    assert not Path("out").exists()


def test_paths_start_at_the_file_of_the_cases(folder: Path) -> None:
    Path("sub").mkdir()
    Path("cases.toml").rename("sub/cases.toml")
    cases = read_cases("sub/cases.toml")
    assert cases["fast"].data == ("sub/b.csv",) and cases["slow"].model == "sub/decay.toml"
    assert cases["fast"].arguments("out/fast")[-4:] == ["--out", "out/fast", "--seed", "1"]


def test_dask_is_asked_for_in_a_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(jaxsr.InputError, match="no scheduler answers"):
        monkeypatch.setattr(cluster, "PATIENCE", 0.2)
        diagnose_many("cases.toml", "out", scheduler="tcp://127.0.0.1:9")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(jaxsr.InputError, match=r"needs Dask.*jaxsr-dynamics\[batch\]"):
        diagnose_many("cases.toml", "out", workers=2)
    assert (
        cli.main(["batch", "cases.toml", "--out", "o", "--workers", "2", "--scheduler", "x"]) == 2
    )


def test_an_empty_fleet_says_so(tmp_path: Path) -> None:
    fleet: Any = Fleet(tmp_path, ("a",), {}, {})
    assert str(fleet).splitlines()[1].split() == ["a", "-", "did", "not", "run"]


def test_counts_are_told_as_cases_end(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    shares: list[float] = []

    class Heard:
        def stage(self, text: str) -> None:
            lines.append(text)

        def update(self, fraction: float, text: str = "") -> None:
            shares.append(fraction)

    def run(task: Task, stop: Callable[[], bool]) -> Outcome:
        if task.name == "bad" and not any("bad" in line for line in lines):
            return Outcome(task.name, 1, "error: by chance")
        return finished(task)

    monkeypatch.setattr(engine, "run_task", run)
    cases = dict.fromkeys(("bad", "good", "late"), Case("decay.toml", ("a.csv",)))
    diagnose_many(cases, "out", progress=Heard())
    assert lines == [
        "3 cases",
        "0 of 3 done, 1 failed, 1 run, 1 wait: bad: by chance",
        "1 of 3 done, 1 failed, 1 run, 0 wait: good: done",
        "2 of 3 done, 1 failed, 0 run, 0 wait: late: done",
        "3 of 3 done, 0 failed, 0 run, 0 wait: tried again: bad: done",
    ]
    assert shares[0] == 0.0 and shares[-1] == 1.0
