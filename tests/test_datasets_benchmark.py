"""The benchmark of the real recordings: no answer is a row; laws to compare with are fitted."""

from __future__ import annotations

import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

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


def test_runs_of_a_friction_law_are_those_of_its_equation() -> None:
    steps = 200
    half = 0.5 * bam_laws.STEP * np.arange(2 * steps + 1)
    drive = np.array([4.0 * np.sin(9.0 * half), 3.0 - 40.0 * half])
    on = np.array([np.ones_like(half), np.ones_like(half)])
    blank = bam_laws.Runs(drive, on, np.full((2, steps + 1), 0.3))
    law = {"R": 4.0, "J": 0.002, "Fv": 0.008, "Fc": 0.02, "mu_motor": 0.2, "mu_pendulum": 0.3}
    found = bam_laws.simulate(blank, law)

    def rate(t: float, x: np.ndarray, row: int) -> list[float]:
        motor = 0.3232 / 4.0 * (np.interp(t, half, drive[row]) - 0.3232 * x[1])
        pendulum = 0.49 * 9.81 * 0.1 * np.sin(x[0])
        dry = 0.02 + 0.2 * abs(motor) + 0.3 * abs(pendulum)
        force = motor - pendulum - 0.008 * x[1] - dry * np.tanh(x[1] / bam_laws.STILL)
        return [x[1], force / (0.002 + 0.49 * 0.1**2)]

    for row in range(2):
        options = {"t_eval": half[::2], "args": (row,), "rtol": 1e-8, "atol": 1e-10}
        exact = solve_ivp(rate, (0.0, half[-1]), [0.3, 0.0], method="LSODA", **options)
        np.testing.assert_allclose(found[row], exact.y[0], atol=2e-4)
    runs = bam_laws.Runs(drive, on, found + 0.01)
    assert bam_laws.errors(bam_laws.Runs(drive, on, found), law) == pytest.approx([0.0, 0.0])
    assert max(bam_laws.errors(runs, law)) > 1e-3
