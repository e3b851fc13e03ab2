"""Inputs that once failed (``../shared/cases``): an answer, or one line and exit status 2."""

from __future__ import annotations

import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import diagnosis_schema
import numpy as np
import pytest
import shared_cases
from form_running import crash

import jaxsr
from jaxsr import cli

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("JAXSR_SHARED", ROOT.parent / "shared"))
FORMS, REPORTS = SHARED / "cases" / "forms", SHARED / "cases" / "reports"
pytestmark = pytest.mark.skipif(
    not FORMS.is_dir(), reason="the shared cases (../shared/cases) are absent"
)
FOLDERS = sorted(p for p in FORMS.iterdir() if p.is_dir()) if FORMS.is_dir() else []


def _is_diagnosis(folder: Path) -> bool:
    command = folder / "cmd.sh"
    return command.exists() and command.read_text().strip().startswith("jaxsr diagnose")


DIAGNOSED = [folder for folder in FOLDERS if _is_diagnosis(folder)]
HOSTILE = [folder for folder in FOLDERS if not _is_diagnosis(folder)]
MAY_REFUSE = {
    **{"06-law-nan-on-data-sqrt": "equation v, on a.csv", "07-inertia-0": "m.toml"},
    **{"09-inertia-off-diagonal": "m.toml", "10-output-all-zero": "a.csv"},
    **{"12-20-samples": "a.csv", "15-held-out-too-short-no-file-name": "h.csv"},
    "16-one-short-recording-no-file-name": "b.csv",
}
"""Forms that may be refused, and the place that the message must name."""
LENGTH = 500
"""Characters of a message: file, what and remedy, with values cut at 80."""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, shared_cases.Result]:
    copies = tmp_path_factory.mktemp("hostile")
    for folder in HOSTILE:
        shutil.copytree(folder, copies / folder.name)
    return shared_cases.run_all([copies / folder.name for folder in HOSTILE])


@pytest.mark.parametrize("folder", HOSTILE, ids=lambda f: f.name)
def test_a_hostile_file_is_read_or_refused_in_one_line(
    folder: Path, results: dict[str, shared_cases.Result]
) -> None:
    result = results[folder.name]
    assert result.end in ("ok", "InputError"), f"{result.end}: {result.message}"
    assert "\n" not in result.message and len(result.message) <= LENGTH
    assert result.seconds < shared_cases.SLOW * max(1.0, os.getloadavg()[0])
    if result.end == "InputError":
        named = [f.name for f in folder.iterdir() if f.suffix not in (".sh", "")]
        assert any(name in result.message for name in named), result.message


def test_hostile_files_write_nothing(tmp_path: Path) -> None:
    folder = shutil.copytree(HOSTILE[0], tmp_path / "case")
    before = sorted(p.name for p in folder.iterdir())
    shared_cases.run_all([folder])
    assert sorted(p.name for p in folder.iterdir()) == before


@pytest.mark.slow
@pytest.mark.parametrize("folder", DIAGNOSED, ids=lambda f: f.name)
def test_a_form_is_diagnosed_or_refused_in_one_line(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    line = next(x for x in (folder / "cmd.sh").read_text().splitlines() if x.startswith("jaxsr "))
    start = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", *shlex.split(line)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        timeout=120,
    )
    seconds = time.monotonic() - start
    assert "Traceback" not in done.stderr, crash(done.stderr.rpartition("jaxsr: this is")[0])
    assert "Warning" not in done.stderr, done.stderr
    if done.returncode == 2:
        (error,) = [x for x in done.stderr.splitlines() if x.startswith("jaxsr: error: ")]
        assert folder.name in MAY_REFUSE, error
        assert MAY_REFUSE[folder.name] in error
    else:
        assert done.returncode == 0, done.stderr
        text = (tmp_path / "out" / "diagnosis.json").read_text()
        document = diagnosis_schema.strict_json(text)
        assert document["schema"] == "jaxsr.diagnosis/1"
        assert document["verdict"] in diagnosis_schema.VERDICTS
    assert seconds <= 1.1 * 5.0 * max(1.0, os.getloadavg()[0]) + 2.0


def _command(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    status = cli.main(arguments)
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err, crash(captured.err)
    assert "Warning" not in captured.err
    return status, captured.out + captured.err


@pytest.mark.parametrize("path", sorted(REPORTS.glob("*/*.csv")), ids=lambda p: p.name)
def test_recordings_of_public_reports_are_read(path: Path) -> None:
    record = jaxsr.read_recording(path)
    assert len(record) > 20 and np.all(np.diff(record.time) > 0)


@pytest.mark.parametrize("name", ["wrap.csv", "gaps.csv"])
def test_an_angle_that_wraps_is_said(name: str) -> None:
    """An encoder's angle jumps by 360 between neighbours: a check of the data names it."""
    from jaxsr.recordings import check_recording, unwrap

    record = unwrap(jaxsr.read_recording(REPORTS / "encoder-wrap" / name))
    checks = check_recording(record, inputs=("u",))
    said = [c for c in checks if "wrap" in c.check or "wrap" in c.message]
    assert said and said[0].channel == "angle" and "360" in said[0].message


def test_files_in_seconds_and_in_milliseconds_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Steps that differ a thousandfold under one name are an error, or are said."""
    files = [str(REPORTS / "mixed-time-units" / name) for name in ("a_s.csv", "b_ms.csv")]
    options = ["--states", "v", "--inputs", "u", "--budget", "2", "--out", str(tmp_path / "out")]
    status, text = _command(["discover", *files, *options], capsys)
    assert status in (0, 2)
    told = text
    if status == 0:
        told += (tmp_path / "out" / "discovery.json").read_text()
    assert re.search(
        r"thousand|1,?000 times|factor of 1,?000|\bms\b|millisecond", told.replace("b_ms", "b")
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["walk.csv", "walk_1900.csv"])
def test_a_random_walk_has_no_law(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(REPORTS / "random-walk" / name)
    options = ["--states", "a,b", "--budget", "20", "--out", str(tmp_path / "out")]
    status, _ = _command(["discover", path, *options], capsys)
    assert status == 0
    document = diagnosis_schema.strict_json((tmp_path / "out" / "discovery.json").read_text())
    assert document["verdict"] == "undecided"
    assert document["reason"].strip()


def _diagnosed(
    case: str, files: list[str], tmp_path: Path, capsys: Any, budget: float = 60.0
) -> dict[str, Any]:
    folder = REPORTS / case
    data = [str(folder / name) for name in files]
    out = tmp_path / "out"
    arguments = ["diagnose", str(folder / "model.toml"), *data, "--budget", f"{budget:g}"]
    status, text = _command([*arguments, "--out", str(out)], capsys)
    assert status == 0, text
    return diagnosis_schema.strict_json((out / "diagnosis.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uniform.csv", "uniform_rest.csv"])
def test_a_row_after_a_pause_changes_nothing(name: str, tmp_path: Path, capsys: Any) -> None:
    document = _diagnosed("row-after-a-pause", [name], tmp_path, capsys)
    assert [f["mechanism"] for f in document["findings"]] == ["coulomb_friction"]
    (value,) = [row["value"] for row in document["findings"][0]["parameters"].values()]
    assert math.isclose(value, 0.27, rel_tol=0.1)


@pytest.mark.slow
def test_recalibration_leaves_a_wrong_valley(tmp_path: Path, capsys: Any) -> None:
    document = _diagnosed("wrong-valley", ["motor.csv"], tmp_path, capsys)
    assert document["verdict"] in ("nothing", "parameter")
    assert min(document["fit"]["train"]["explained"]) < 0.0093


@pytest.mark.slow
def test_an_oversampled_level_has_a_bias_and_an_offset(tmp_path: Path, capsys: Any) -> None:
    """A level sensor that reads 2 too little, a pump that starts at 2.4 V."""
    names = [f"{name}_1hz.csv" for name in "abc"]
    document = _diagnosed("oversampled", names, tmp_path, capsys)
    found = {f["mechanism"] for f in document["findings"]}
    assert "sensor_bias" in found


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wrap.csv", "gaps.csv"])
def test_a_wrapped_angle_is_diagnosed(name: str, tmp_path: Path, capsys: Any) -> None:
    document = _diagnosed("encoder-wrap", [name], tmp_path, capsys, budget=30.0)
    assert any("wrap" in row["message"] for row in document["data_checks"])
