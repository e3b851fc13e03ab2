"""The job of a command: its budget, its progress, and where its results go."""

from __future__ import annotations

import contextlib
import importlib
import math
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from jaxsr import _clock
from jaxsr._output import print_line, save_results
from jaxsr._process import Run
from jaxsr._progress import Budget, Progress, progress_on

RUN: ContextVar[Run] = ContextVar("run")
"""The run that a command is part of."""
WRITING, MOST_WRITING = 0.5, 0.2
"""Seconds that a report with the first figure of a process takes, and the largest share of a
budget that is kept for it."""


def command_budget(seconds: float | None) -> Budget:
    """Return a budget that began with the command and ends early when a signal asks for it.

    Parameters
    ----------
    seconds : float, optional
        Unlimited by default.
    """
    run = RUN.get()
    began = 0.0 if _clock.processor() else run.began
    return Budget(math.inf if seconds is None else float(seconds), began, run.asked)


def before_writing(budget: Budget) -> Budget:
    """Return the budget of what is found, which ends before that of the command by its report."""
    return budget.keeping(min(WRITING, MOST_WRITING * budget.seconds))


@contextlib.contextmanager
def session(budget: Budget | None = None) -> Iterator[Progress]:
    """Show progress, with what is left of a budget, and keep what is compiled."""
    from jaxsr.evaluation import keep_compiled

    keep_compiled()
    with progress_on(budget=budget or command_budget(None)) as progress:
        yield progress


def loaded(work: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function of the library, now that it is loaded: from here on a signal ends it early.

    Drawing is loaded too, so that its time counts before the search shares out what is left.

    Raises
    ------
    KeyboardInterrupt
        A signal came already.
    """
    importlib.import_module("jaxsr.report.page")
    importlib.import_module("matplotlib.figure")
    run = RUN.get()
    run.keeps = True
    if run.asked.is_set():
        raise KeyboardInterrupt
    return work


def save(found: Any, folder: Path, summary: str, **options: Any) -> None:
    """Save results and print what they are and where.

    Parameters
    ----------
    found : Diagnosis or Discovery
    folder : Path
    summary : str
        The results in words.
    **options
        What `found.save` and `found.write` take besides.
    """
    save_results(found, folder, summary, **options)
    RUN.get().outcome = f"the best so far is in {folder}"
    print_line(summary)
    print_line(f"Report: {folder / 'report.html'}")


def verdict_line(diagnosis: Any) -> str:
    """Return the verdict and its sentence."""
    return f"Verdict: {diagnosis.verdict}. {diagnosis.sentence}"
