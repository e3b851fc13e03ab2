"""Searches from several seeds: each by itself, the best is the case's result."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from batch_stand_in import MODEL
from test_batch import but_for_seconds

import jaxsr
from jaxsr import cli
from jaxsr._files import atomic_directory
from jaxsr.batch import Islands, diagnose_many, engine, read_cases
from jaxsr.batch.islands import best
from jaxsr.batch.task import DONE, Outcome, Task

CASES = """
[defaults]
model = "not/for/searches.toml"
budget = 60

[cases.swing]
command = "discover"
data = "a.csv"
states = ["x"]
derivatives = ["x rate, rad/s"]
columns = { x = "angle, rad" }
seeds = [0, 1, 7]
"""


def document(length: float | None, verdict: str = "law", error: float = 1e-3) -> dict[str, Any]:
    row = {"state": "x", "expression": f"-{error}*x", "terms": [], "operators": 0}
    return {
        **{"schema": "jaxsr.discovery/1", "verdict": verdict, "reason": "", "provenance": {}},
        **{"equations": [{**row, "complexity": 1, "validation_mse": error}]},
        **{"description_length": length, "free_run_nrmse": 0.01},
    }


def test_the_best_holds_and_is_short() -> None:
    assert best([document(-90.0), document(-200.0), document(-100.0)]) == 1
    assert best([document(-90.0), document(-200.0, "undecided")]) == 0
    assert best([document(-90.0), document(-200.0, "several")]) == 1
    assert best([document(None, "undecided", 0.3), document(None, "undecided", 0.1)]) == 1
    assert best([document(None, "undecided"), document(5.0, "undecided")]) == 1
    assert best([document(-90.0), document(-90.0)]) == 0


def test_each_seed_is_a_task_and_the_best_is_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text("t,x\n0,1\n")
    Path("cases.toml").write_text(CASES)
    lengths = {"seed_0": -10.0, "seed_1": -30.0, "seed_7": -20.0}
    ran: list[str] = []

    def run(task: Task, stop: Callable[[], bool]) -> Outcome:
        ran.append(task.name)
        folder = Path(task.results)
        if folder.name == "seed_7":
            return Outcome(task.name, 1, "error: lost its way")
        with atomic_directory(folder) as out:
            (out / "discovery.json").write_text(json.dumps(document(lengths[folder.name])))
            (out / "model.toml").write_text(MODEL)
            (out / "report.html").write_text(folder.name)
        task.mark.write_text(task.key())
        return Outcome(task.name, DONE)

    monkeypatch.setattr(engine, "run_task", run)
    fleet = diagnose_many("cases.toml", "out")
    assert ran == ["swing/seed_0", "swing/seed_1", "swing/seed_7", "swing/seed_7"]
    assert Path("out/swing/report.html").read_text() == "seed_1"
    assert fleet["swing"].to_dict() == document(-30.0)
    assert fleet.failures == {"swing/seed_7": "lost its way"}
    assert pd.read_csv("out/batch.csv").expression.tolist() == ["-0.001*x"]
    page = Path("out/batch.html").read_text()
    assert "Equations found" in page and "d(x)/dt = -0.001*x" in page and "lost its way" in page

    ran.clear()
    before = Path("out/swing/discovery.json").stat().st_mtime_ns
    lengths["seed_7"] = -40.0
    assert list(diagnose_many("cases.toml", "out", resume=True)) == ["swing"]
    assert ran == ["swing/seed_7"] * 2
    assert Path("out/swing/discovery.json").stat().st_mtime_ns == before


def test_a_search_is_the_command_of_the_same_options(tmp_path: Path) -> None:
    path = tmp_path / "cases.toml"
    path.write_text(CASES)
    case = read_cases(path)["swing"]
    parts = dict(case.parts("swing"))
    assert list(parts) == ["swing/seed_0", "swing/seed_1", "swing/seed_7"]
    words = parts["swing/seed_7"].arguments("out/swing/seed_7")
    assert words[:2] == ["discover", str(tmp_path / "a.csv")]
    told = dict(zip(words[2::2], words[3::2], strict=True))
    assert told["--seed"] == "7" and told["--budget"] == "60" and told["--modes"] == "auto"
    assert told["--derivatives"] == '"x rate, rad/s"' and told["--columns"] == 'x="angle, rad"'


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ('command = "simulate"', "command 'simulate'"),
        ('model = "m.toml"', "unknown key 'model'"),
        ("states = []", "no states"),
        ("states = [1]", "must be names"),
        ("seeds = [0, 0]", "one twice"),
        ("seeds = [0.5]", "seed 0.5"),
        ("seeds = 3", "seeds 3"),
        ("order = 3", "order 3"),
        ("known = 3", "must be text"),
    ],
)
def test_searches_are_refused_in_a_line(tmp_path: Path, change: str, said: str) -> None:
    key = change.split(" = ")[0]
    lines = [line for line in CASES.splitlines() if not line.startswith(f"{key} = ")]
    if key == "model":
        lines = CASES.splitlines()
    (tmp_path / "cases.toml").write_text("\n".join([*lines, change]))
    with pytest.raises(jaxsr.InputError, match=re.escape(said)) as caught:
        read_cases(tmp_path / "cases.toml")
    assert "\n" not in str(caught.value) and "cases.toml [cases.swing]" in str(caught.value)


@pytest.mark.slow
def test_islands_are_single_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    t = np.arange(200) * 0.02
    x = 2.0 * np.exp(-0.7 * t) + 0.3
    pd.DataFrame({"t": t, "x": x}).to_csv("a.csv", index=False)
    case = Islands("a.csv", "x", seeds=(0, 1), modes=1, budget=30.0)
    fleet = diagnose_many({"decay": case}, "out", workers=2)
    assert not fleet.failures and fleet["decay"].verdict == "law"
    seeds = [jaxsr.load(f"out/decay/seed_{k}").to_dict() for k in (0, 1)]
    chosen = best(seeds)
    assert math.isfinite(seeds[chosen]["description_length"])
    assert fleet["decay"].to_dict() == seeds[chosen]
    Path("out").rename("kept")
    assert cli.main(dict(case.parts("decay"))["decay/seed_1"].arguments("out/decay/seed_1")) == 0
    for path in Path("out/decay/seed_1").iterdir():
        assert but_for_seconds(path) == but_for_seconds(Path("kept/decay/seed_1", path.name))
