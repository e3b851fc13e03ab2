"""Bad input through the command line: status 2, one clear line, nothing half-written."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxsr.cli import main

ROOT = Path(__file__).resolve().parents[1]
DEMO = ROOT / "jaxsr" / "datasets" / "demo"

MODEL = """
[model]
name = "falling mass"
time = "t"
states = ["y", "v"]
inputs = []
outputs = ["height"]

[equations]
y = "v"
v = "-g"

[readings]
height = "y"

[parameters]
g = { value = 9.8, unit = "m/s^2" }

[initial]
y = "free"
v = "free"

[units]
y = "m"
v = "m/s"
height = "m"

[columns]
t = "time_s"
height = "height_m"
"""


def table(rows: list[str], header: str = "time_s,height_m") -> str:
    return "\n".join([header, *rows]) + "\n"


def drop(seed: int = 0, count: int = 40) -> list[str]:
    """Return a fall in a vacuum, 15 Hz, with a noise of 2 cm."""
    t = np.arange(count) / 15.0
    noise = 0.02 * np.random.default_rng(seed).standard_normal(count)
    return [f"{a:.6f},{b:.6f}" for a, b in zip(t, 40.0 - 4.9 * t**2 + noise, strict=True)]


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("m.toml").write_text(MODEL)
    Path("a.csv").write_text(table(drop()))
    Path("b.csv").write_text(table(drop(1)))
    return tmp_path


def refused(capsys: Any, *words: str, argv: str = "diagnose m.toml a.csv --out d") -> None:
    """Run, and demand status 2, one line that holds `words`, and no results."""
    before = {p: p.read_bytes() for p in Path().rglob("*") if p.is_file()}
    assert main(argv.split()) == 2
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("jaxsr: error: ")
    for word in words:
        assert word in lines[0], f"{word!r} is not in: {lines[0]}"
    assert captured.out == ""
    # Nothing new, nothing changed, no directory of results begun.
    assert {p: p.read_bytes() for p in Path().rglob("*") if p.is_file()} == before
    assert not Path("d").exists() or not any(Path("d").iterdir())


def test_missing_column(work: Path, capsys: Any) -> None:
    Path("a.csv").write_text(table(drop(), "time_s,altitude_m"))
    refused(capsys, "a.csv", "height_m", "altitude_m")


@pytest.mark.parametrize("swap", [(10, 11), (0, 39)])
def test_time_not_increasing(work: Path, capsys: Any, swap: tuple[int, int]) -> None:
    rows = drop()
    i, j = swap
    rows[i], rows[j] = rows[j], rows[i]
    Path("a.csv").write_text(table(rows))
    refused(capsys, "a.csv", "time goes back" if swap == (10, 11) else "time is not increasing")


def test_time_that_stands_still(work: Path, capsys: Any) -> None:
    rows = drop()
    rows[7] = rows[6]
    Path("a.csv").write_text(table(rows))
    refused(capsys, "a.csv", "time")


def test_unknown_symbol(work: Path, capsys: Any) -> None:
    Path("m.toml").write_text(MODEL.replace('v = "-g"', 'v = "-g - drag*v"'))
    refused(capsys, "m.toml", "equations", "drag")


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('touch pwned')",
        "-g + __import__",
        "().__class__",
        "eval('open(1)')",
    ],
)
def test_text_is_never_executed(work: Path, capsys: Any, text: str) -> None:
    Path("m.toml").write_text(MODEL.replace('v = "-g"', f'v = "{text}"'))
    refused(capsys, "m.toml", "equations")
    assert not Path("pwned").exists()


def test_wrong_unit(work: Path, capsys: Any) -> None:
    Path("m.toml").write_text(MODEL.replace("m/s^2", "kg/s"))
    refused(capsys, "m.toml", "equations")


def test_unit_that_is_none(work: Path, capsys: Any) -> None:
    Path("m.toml").write_text(MODEL.replace("m/s^2", "furlongs_per_blink"))
    refused(capsys, "m.toml", "furlongs_per_blink")


@pytest.mark.parametrize("content", ["", "\n", "time_s,height_m\n"])
def test_empty_file(work: Path, capsys: Any, content: str) -> None:
    Path("a.csv").write_text(content)
    refused(capsys, "a.csv")


def test_channel_without_a_value(work: Path, capsys: Any) -> None:
    Path("a.csv").write_text(table([f"{row.partition(',')[0]}," for row in drop()]))
    refused(capsys, "a.csv", "height_m")


def test_file_in_two_roles(work: Path, capsys: Any) -> None:
    refused(
        capsys, "a.csv", "--held-out", argv="diagnose m.toml a.csv --held-out b.csv a.csv --out d"
    )


def test_directory_that_cannot_be_written(work: Path, capsys: Any) -> None:
    refused(capsys, "a.csv", "--out", argv="diagnose m.toml b.csv --out a.csv/d")


def test_a_bad_held_out_file_is_told_and_loses_nothing(work: Path, capsys: Any) -> None:
    Path("b.csv").write_text(table(drop(), "time_s,altitude_m"))
    assert main("diagnose m.toml a.csv --held-out b.csv --out d".split()) == 2
    # It is opened last: the diagnosis that does not need it is written whole.
    *stages, error = capsys.readouterr().err.splitlines()
    assert error.startswith("jaxsr: error: ") and "b.csv" in error and "height_m" in error
    assert not any("error" in line for line in stages)
    document = json.loads(Path("d/diagnosis.json").read_text())
    assert document["fit"]["held_out"] is None and Path("d/report.html").exists()
    assert [c["file"] for c in document["data_checks"] if c["check"] == "held_out"] == ["b.csv"]


def test_refusal_leaves_old_results_alone(work: Path, capsys: Any) -> None:
    Path("d").mkdir()
    Path("d/diagnosis.json").write_text("{}")
    Path("a.csv").write_text("")
    assert main("diagnose m.toml a.csv --out d".split()) == 2
    assert [p.name for p in Path("d").iterdir()] == ["diagnosis.json"]
    assert Path("d/diagnosis.json").read_text() == "{}"


def test_model_without_a_free_parameter_runs(work: Path, capsys: Any) -> None:
    assert main("diagnose m.toml a.csv --held-out b.csv --out d".split()) == 0
    document = json.loads(Path("d/diagnosis.json").read_text())
    for role in ("train", "held_out"):
        assert document["fit"][role]["recalibrated"] == document["fit"][role]["given"]
    assert document["calibration"] == {}
    assert document["verdict"] in ("nothing", "undecided")
    assert tomllib.loads(Path("d/explained.toml").read_text())["equations"]["v"] == "-g"


@pytest.mark.slow
@pytest.mark.parametrize("old", [False, True])
def test_interrupted_run_leaves_whole_files(tmp_path: Path, old: bool) -> None:
    out = tmp_path / "d"
    names = ("diagnosis.json", "explained.toml", "report.html")
    if old:
        out.mkdir()
        for name in names:
            (out / name).write_text("old")
        (out / ".jaxsr-files").write_text("".join(f"{name}\n" for name in names))
    arm, data = DEMO / "arm.toml", DEMO / "set1_train.csv"
    process = subprocess.Popen(
        [sys.executable, "-m", "jaxsr", "diagnose", str(arm), str(data), "--out", str(out)],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        cwd=ROOT,
        env={**os.environ, "MPLBACKEND": "Agg"},
    )
    assert process.stderr is not None
    assert any("trying every mechanism" in line for line in process.stderr)
    time.sleep(2.0)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=240)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    present = [name for name in names if (out / name).exists()]
    assert present in ([], list(names))
    if not present:
        return
    texts = {name: (out / name).read_text() for name in names}
    if all(text == "old" for text in texts.values()):
        return
    document = json.loads(texts["diagnosis.json"])
    assert document["provenance"]["stopped_by"] == "interrupted"
    tomllib.loads(texts["explained.toml"])
    assert texts["report.html"].rstrip().endswith("</html>")
    assert not [p.name for p in tmp_path.iterdir() if p.name != "d"], "leftovers beside --out"
