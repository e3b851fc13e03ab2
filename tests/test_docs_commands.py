"""The commands of the pages, and the blocks that read what they write, run on small recordings."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from docs_blocks import PAGES, ROOT, Block, blocks

import jaxsr
from jaxsr import cli
from jaxsr.models import Edit, Parameter, apply_edit, model_text, parse_model

DOCS = ROOT / "docs"
TITLED = {b.title: b for page in PAGES for b in blocks(page) if b.title}
OSCILLATOR = """
[model]
states = ["z1", "z2"]
outputs = ["z1", "z2"]
[equations]
z1 = "z2"
z2 = "-k*z1"
[readings]
z1 = "z1"
z2 = "z2"
[parameters]
k = { value = 3.0, bounds = [1.0, 10.0] }
"""


def lines(page: Path, *beginnings: str) -> list[str]:
    """Return the commands of a page that begin as asked."""
    texts = [b.text for b in blocks(page) if b.language in ("", "console")]
    every = [line.strip() for text in texts for line in text.split("\n")]
    return [line for line in every if line.startswith(beginnings)]


def command(line: str, *more: str) -> str:
    """Run a command in a process of its own, as a reader does, and return its output."""
    environment = {"PYTHONPATH": str(ROOT), "PATH": "", "OMP_NUM_THREADS": "1"}
    environment["JAXSR_CLOCK"] = "processor"  # what runs beside changes no answer
    words = [sys.executable, "-m", *shlex.split(line), *more]
    done = subprocess.run(words, capture_output=True, text=True, env=environment, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Work in an empty folder."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path


def motor_results() -> None:
    """Write the files that the reader of "Start here" has after the diagnosis."""
    given = parse_model(TITLED["motor.toml"].text)
    law = f"{given.equations['w']} - Fc*sign(w)"
    friction = Parameter(0.03, unit="N*m", bounds=(0.0, 1.0))
    explained = apply_edit(given, Edit({"equations.w": law, "parameters.Fc": friction}))
    for name in ("motor.toml", "model.toml"):
        Path(name).write_text(TITLED["motor.toml"].text, encoding="utf-8")
    Path("results").mkdir()
    Path("results/explained.toml").write_text(model_text(explained), encoding="utf-8")
    finding = {
        "mechanism": "coulomb_friction",
        "site": "equation:w",
        "probability": 0.99,
        "parameters": {"Fc": {"value": 0.03, "ci95": [0.0299, 0.0301], "unit": "N*m"}},
    }
    document = {
        "schema": "jaxsr.diagnosis/1",
        "verdict": "structure",
        "findings": [finding],
        "fit": {},
        "provenance": {},
    }
    Path("results/diagnosis.json").write_text(json.dumps(document), encoding="utf-8")
    time = 0.01 * np.arange(20)
    still = {"time_s": time, "volts": 5.0 + 0.0 * time, "angle_rad": 0.0 * time}
    pd.DataFrame(still).to_csv("run3.csv", index=False)


def test_what_needs_results_and_no_search_runs(here: Path, capsys: Any) -> None:
    """Commands that export, and Python blocks that read a folder of results."""
    motor_results()
    typed = lines(DOCS / "exports.md", "jaxsr")
    assert len(typed) == 3
    for line in typed:
        assert cli.main(shlex.split(line)[1:]) == 0, line
    assert r"\begin{align*}" in capsys.readouterr().out
    for page in (DOCS / "start-here.md", DOCS / "exports.md"):
        (block,) = (b for b in blocks(page) if "jaxsr.load(" in b.text)
        exec(compile(block.text, str(block), "exec"), {})
    shown = capsys.readouterr().out
    assert "The model leaves out Coulomb friction in the equation of w." in shown
    assert "Fc 0.03 [0.0299, 0.0301] N*m" in shown and "model my_motor" in shown


@pytest.mark.slow
@pytest.mark.parametrize("page", [ROOT / "README.md", DOCS / "discover.md"], ids=lambda p: p.name)
def test_the_two_commands_run(page: Path, here: Path) -> None:
    """A damped oscillator, whose model lacks the damping."""
    damped = OSCILLATOR.replace('"-k*z1"', '"-4.0*z1 - 0.5*z2"')
    model = jaxsr.Simulator(parse_model(damped + "[initial]\nz1 = 1.0\nz2 = 0.0\n"))
    rng, time = np.random.default_rng(0), 0.02 * np.arange(300)
    for name, start in (("a.csv", 1.0), ("b.csv", -2.0), ("c.csv", 0.7)):
        run = model.simulate(duration=float(time[-1]), dt=0.02)
        columns = {n: start * run.channels[n] + 1e-4 * rng.normal(size=300) for n in ("z1", "z2")}
        pd.DataFrame({"t": time, **columns}).to_csv(name, index=False)
    Path("MODEL.toml").write_text(OSCILLATOR)
    for line in lines(page, "jaxsr diagnose", "jaxsr discover"):
        command(line, "--budget", "20")
        found: Any = jaxsr.load("results")
        if "diagnose" in line:
            assert [f.mechanism for f in found.findings] == ["viscous_damping"]
        else:
            assert set(found.model.equations) == {"z1", "z2"}
        for path in Path("results").iterdir():
            path.unlink()


@pytest.mark.slow
def test_the_cases_of_the_batch_run(here: Path) -> None:
    """All three lines, the last one at a scheduler that is there; budgets are cut."""
    distributed = pytest.importorskip("distributed")
    exec(compile(TITLED["make_motor.py"].text, "make_motor.py", "exec"), {})
    for folder in ("01", "02"):
        Path(folder).mkdir()
        for name in ("run1.csv", "run2.csv", "run3.csv"):
            Path(folder, name).write_bytes(Path(name).read_bytes())
    for name in ("motor.toml", "motor_with_gear.toml"):
        Path(name).write_text(TITLED["motor.toml"].text, encoding="utf-8")
    Path("pendulum").mkdir()
    t = 0.05 * np.arange(400)
    swing = pd.DataFrame({"t": t, "angle": 0.3 * np.exp(-0.05 * t) * np.cos(3.0 * t)})
    swing.to_csv("pendulum/run1.csv", index=False)
    text = re.sub(r"budget = \d+", "budget = 8", TITLED["cases.toml"].text)
    Path("cases.toml").write_text(text, encoding="utf-8")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1) as cluster:
        for line in lines(DOCS / "batch.md", "jaxsr batch"):
            command(line.replace("tcp://10.0.0.1:8786", cluster.scheduler_address))
            table = pd.read_csv("fleet/batch.csv")
            assert set(table["case"]) == {"motor_01", "motor_02", "pendulum"}
            assert Path("fleet/batch.html").is_file()


@pytest.mark.slow
def test_the_monitor_watches_the_recordings_of_its_page(here: Path) -> None:
    """The mount of the page; the line that follows a folder has no end, and is parsed only."""
    (block,) = (b for b in blocks(DOCS / "monitor.md") if b.language == "python")
    space: dict[str, Any] = {}
    exec(compile(block.text, str(block), "exec"), space)
    run: Callable[..., jaxsr.Recording] = space["run"]
    Path("explained.toml").write_bytes(Path("mount.toml").read_bytes())
    for k in range(1, 5):
        run(k, lost=0.3 * (k == 4)).to_pandas().to_csv(f"run{k}.csv", index_label="t")
    (line,) = (x for x in lines(DOCS / "monitor.md", "jaxsr monitor") if "--follow" not in x)
    command(line)
    alarms = json.loads(Path("watch/monitor.json").read_text())["alarms"]
    assert alarms and all("run4" in str(alarm) for alarm in alarms)


def plant_file(name: str) -> list[Block]:
    """Return the blocks that a reader saves for a plant: its code and the table beside it."""
    return [TITLED[f"{name}.py"], TITLED[f"{name}.toml"]]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plant.py", "plant.fmu", "cart.py"])
def test_simulators_of_the_page_are_diagnosed_and_run(name: str, here: Path) -> None:
    """The plants have a cubic spring beside what their programs say."""
    from fmu_plants import recorded, slave_fmu

    law = "(F - 0.5*v - 8.0*q - 20.0*q**3)/2.0"
    if name == "plant.fmu":
        pytest.importorskip("pythonfmu")
        slave_fmu(here).rename(name)
    else:
        for block in plant_file(name.removesuffix(".py")):
            Path(block.title).write_text(block.text, encoding="utf-8")
        law = "(F - v - 5.0*q - 20.0*q**3)/2.0"
    for k in (1, 2):
        path = recorded(here, law, f"run{k}.csv", k)
        if name != "plant.fmu":
            table = pd.read_csv(path).rename(columns={"q": "y", "F": "force"})
            table.to_csv(path, index=False)
    (diagnose,) = lines(DOCS / "model-file.md", f"jaxsr diagnose {name}")
    command(diagnose, "--budget", "30")
    assert jaxsr.load("results").verdict in ("structure", "undecided")
    for line in lines(DOCS / "model-file.md", f"jaxsr simulate {name}"):
        command(line)
        assert len(pd.read_csv("explained.csv")) == 500
