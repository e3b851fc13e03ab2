"""Budgets in processor time."""

from __future__ import annotations

import time

import pytest

from jaxsr import _clock
from jaxsr._progress import Budget


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
