"""Budgets in processor time."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from jaxsr import _clock
from jaxsr._progress import Budget
from jaxsr.models.native import process
from jaxsr.models.native.process import Native
from jaxsr.recordings.isolated import Reader

BACKEND = Path(process.__file__).parent / "backends" / "python_steps.py"
BUSY = """
import time


def step(x, u):
    begun = time.process_time()
    while time.process_time() - begun < 0.1:
        pass
    return [0.5 * x[0]]
"""


def test_a_share_of_nothing_is_over_on_a_clock_that_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_clock, "now", lambda: 7.0)
    assert Budget(2.0, 4.0).share(0.5).exhausted
    assert not Budget(4.0, 4.0).share(0.5).exhausted


def test_a_budget_of_processor_time_does_not_run_while_the_process_sleeps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("JAXSR_CLOCK", "processor")
    budget = Budget(10.0)
    time.sleep(0.2)
    asleep = budget.elapsed
    begun = time.process_time()
    while time.process_time() - begun < 0.1:
        pass
    assert asleep < 0.1 <= budget.elapsed


def test_a_budget_of_processor_time_counts_what_another_process_computes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("JAXSR_CLOCK", "processor")
    monkeypatch.setattr(_clock, "_elsewhere", [])
    (tmp_path / "m.py").write_text(BUSY)
    options = {"function": "step", "step": 0.1, "arguments": 2, "states": ["a"], "inputs": []}
    budget = Budget(10.0)
    native = Native(BACKEND, tmp_path / "m.py", {**options, "parameters": [], "start": [1.0]})
    native.choose(1, np.ones(2), states=["a"], inputs=[], outputs=[], parameters=[], degree=1)
    begun, here = budget.elapsed, time.process_time()
    native.rates(np.array([[0.0, 1.0], [0.0, 2.0]]))
    native.close()
    assert budget.elapsed - begun >= 0.2 + 0.9 * (time.process_time() - here)


def test_what_reading_a_binary_file_takes_elsewhere_counts(tmp_path, monkeypatch):
    monkeypatch.setenv("JAXSR_CLOCK", "processor")
    np.savez(tmp_path / "a.npz", t=np.arange(5.0), q=np.arange(5.0))
    Reader().read(".npz", (tmp_path / "a.npz").read_bytes(), "a.npz")
    before = sum(_clock._elsewhere)
    reader = Reader()
    for _ in range(2):
        reader.read(".npz", (tmp_path / "a.npz").read_bytes(), "a.npz")
    reader.close()
    counted = sum(_clock._elsewhere) - before
    assert counted > 0.01  # an interpreter and NumPy were started
    assert counted == pytest.approx(reader._used)
