"""Progress in a pipe and in a terminal, and time budgets."""

from __future__ import annotations

import io
import math
import threading

import pytest

from jaxsr._progress import Budget, Progress, Repeated, Silent, as_budget, progress_on
from jaxsr._result import InputError, StoppedBy


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def work(progress: Progress) -> None:
    for text in ("reading", "searching"):
        progress.stage(text)
        for step in range(50):
            progress.update(step / 50, f"generation {step}")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the time that budgets read, to be set."""
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    return now


def test_a_pipe_gets_one_plain_line_per_stage_with_the_time_since_the_start(
    clock: list[float],
) -> None:
    stream = io.StringIO()
    with progress_on(stream, Budget(60.0, 99.0)) as progress:
        work(progress)
        clock[0] = 111.34
        progress.stage("writing")
    assert stream.getvalue() == (
        "jaxsr: 1.0 s: reading\njaxsr: 1.0 s: searching\njaxsr: 12.3 s: writing\n"
    )


def test_a_terminal_gets_a_live_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    with progress_on(stream) as progress:
        work(progress)
    assert "searching: generation 49" in stream.getvalue()
    assert "\x1b[" in stream.getvalue() and " left" not in stream.getvalue()


def test_a_terminal_is_told_what_is_left_and_a_long_line_hides_none_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "60")
    stream = Terminal()
    with progress_on(stream, Budget(5000.0)) as progress:
        progress.stage("estimating")
        progress.update(0.5, "a set of mechanisms " * 9)
    shown = stream.getvalue()
    assert "estimating: a set" in shown and "…" in shown
    assert "0 s, 5000 s left" in shown


def test_the_default_is_silent_and_a_closed_stream_ends_no_job(
    capsys: pytest.CaptureFixture[str],
) -> None:
    work(Silent())
    assert capsys.readouterr() == ("", "")
    stream = io.StringIO()
    with progress_on(stream) as progress:
        stream.close()
        work(progress)


def test_budget_runs_out() -> None:
    budget = Budget(0.02)
    assert not budget.exhausted and 0 < budget.remaining <= 0.02
    threading.Event().wait(0.03)
    assert budget.exhausted and budget.remaining == 0.0
    assert budget.stopped_by is StoppedBy.BUDGET
    assert budget.elapsed >= 0.03


def test_an_unlimited_budget_ends_by_interrupt_alone() -> None:
    budget = Budget()
    assert budget.remaining == math.inf and not budget.exhausted
    assert budget.stopped_by is StoppedBy.CONVERGED
    share, kept = budget.share(0.5), budget.keeping(3.0)
    assert share.remaining == kept.remaining == math.inf
    budget.interrupt()
    assert budget.exhausted and share.exhausted and share.interrupted and kept.interrupted
    assert budget.stopped_by is StoppedBy.INTERRUPTED


def test_shares_of_a_budget() -> None:
    budget = Budget(100.0)
    assert budget.share(0.25).remaining == pytest.approx(25.0, rel=1e-3)
    assert budget.keeping(30.0).remaining == pytest.approx(70.0, rel=1e-3)
    assert budget.keeping(200.0).exhausted and not budget.exhausted
    assert not Budget(1e-9).share(0.5).interrupted


@pytest.mark.parametrize("seconds", [0.0, -1.0, math.nan])
def test_a_budget_is_positive(seconds: float) -> None:
    with pytest.raises(InputError, match="budget must be positive"):
        as_budget(seconds)


def test_as_budget() -> None:
    budget = Budget(3.0)
    assert as_budget(budget) is budget
    assert as_budget(None).seconds == math.inf and as_budget(2).seconds == 2.0


def test_a_step_like_those_before_is_not_begun_where_it_would_end_too_late(
    clock: list[float],
) -> None:
    budget = Budget(10.0, 100.0)
    figures, unlimited = Repeated(budget), Repeated(Budget())
    asked = []
    for seconds in (2.0, 1.0, 2.5, 2.0):  # 2.5 s are left in the end: one could take all of it
        clock[0] += seconds
        asked.append(figures.too_long())
        assert not unlimited.too_long()
    assert asked == [False, False, False, True]
    budget.interrupt()
    assert Repeated(budget).too_long() is False
