"""The benchmark of the real recordings: no answer is a row, and the laws to compare with are fit."""

from __future__ import annotations

import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import bam_laws, real_rigs
from benchmarks.real_recordings import answered
from benchmarks.recording_case import Case


def _ended(command: list[str], **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.CompletedProcess(command, -11, "", "warm up\nFatal: segmentation fault\n")


def _endless(command: list[str], **options: object) -> subprocess.CompletedProcess[str]:
    raise subprocess.TimeoutExpired(command, 180.0)


@pytest.mark.parametrize(
    ("run", "row"),
    [(_ended, "exit -11: Fatal: segmentation fault"), (_endless, "no end after 180 s")],
)
def test_a_diagnosis_without_an_answer_is_a_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: object, row: str
) -> None:
    model = tmp_path / "ced.toml"
    text = (files("jaxsr.datasets") / "models" / "ced.toml").read_text(encoding="utf-8")
    model.write_text(text, encoding="utf-8")
    monkeypatch.setattr(real_rigs.subprocess, "run", run)
    case = Case()
    answer = real_rigs.ask(case, "ced", model, [tmp_path / "a.csv"], [])
    assert answer.model is None and answer.findings == [] and answer.verdict == row
    assert case.diagnoses["ced"]["failure"] == row
    assert [check.met for check in case.checks] == [False]


def test_a_case_that_raises_is_a_row() -> None:
    def broken(folder: Path, quick: bool) -> Case:
        raise np.linalg.LinAlgError("SVD did not converge")

    case = answered(broken, Path(), False)
    assert [(check.what, check.met) for check in case.checks] == [("an answer", False)]
    assert "LinAlgError: SVD" in case.checks[0].value


def test_a_friction_law_is_found_again() -> None:
    """Runs are made with a law of known constants, then the law is fitted to them."""
    rng, steps = np.random.default_rng(1), 240
    time = 0.5 * bam_laws.STEP * np.arange(2 * steps + 1)
    waves = [
        np.sin(w * time + p) for w, p in zip((5.0, 9.0, 14.0), rng.uniform(0, 6, 3), strict=True)
    ]
    drive = np.array([4.0 * waves[0] + 2.0 * waves[1], 6.0 * waves[2]])
    blank = bam_laws.Runs(drive, np.ones_like(drive), np.zeros((2, steps + 1)))
    truth = {"R": 4.0, "J": 0.002, "Fv": 0.008, "Fc": 0.02, "mu": 0.25}
    runs = bam_laws.Runs(drive, blank.on, bam_laws.simulate(blank, truth))
    found = bam_laws.fit(runs, ("mu",))
    assert found == pytest.approx(truth, rel=0.02)
    assert max(bam_laws.errors(runs, found)) < 1e-3
