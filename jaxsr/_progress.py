"""Progress of long jobs, their time budget, and a stop that keeps the best so far."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import sys
import threading
from collections.abc import Iterator
from typing import Protocol, TextIO

from jaxsr import _clock
from jaxsr._result import InputError, StoppedBy


class Progress(Protocol):
    """What a long job tells while it runs."""

    def stage(self, text: str) -> None:
        """Begin a stage, described in a few words."""
        ...

    def update(self, fraction: float, text: str = "") -> None:
        """Say how far the stage is, from 0 to 1, with a word on what is being done."""
        ...


class Silent:
    """Tell nothing: the default of library calls."""

    def stage(self, text: str) -> None:
        """Do nothing."""

    def update(self, fraction: float, text: str = "") -> None:
        """Do nothing."""


@dataclasses.dataclass(frozen=True)
class Budget:
    """Tell a long job when to stop: out of time, or asked to by Ctrl-C.

    Parameters
    ----------
    seconds : float, optional
        Wall-clock time (`_clock`), positive; unlimited by default.
    _start : float, optional
        When the time began, by ``_clock.now``; now by default.
    _interrupt : threading.Event, optional
        Set by whoever asks for an early end.

    Raises
    ------
    InputError
        If `seconds` is not positive.
    """

    seconds: float = math.inf
    _start: float = dataclasses.field(default_factory=_clock.now)
    _interrupt: threading.Event = dataclasses.field(default_factory=threading.Event)

    def __post_init__(self) -> None:
        if not self.seconds > 0:
            raise InputError(f"budget must be positive seconds, got {self.seconds}")

    @property
    def elapsed(self) -> float:
        """Seconds since the budget began."""
        return _clock.now() - self._start

    @property
    def remaining(self) -> float:
        """Seconds left, never negative; infinite without a limit."""
        return max(self.seconds - self.elapsed, 0.0)

    @property
    def interrupted(self) -> bool:
        """Whether a stop was asked for."""
        return self._interrupt.is_set()

    @property
    def exhausted(self) -> bool:
        """Whether to finish the step at hand and stop."""
        return self.interrupted or self.remaining == 0.0

    @property
    def stopped_by(self) -> StoppedBy:
        """Reason to give for having stopped now."""
        if self.interrupted:
            return StoppedBy.INTERRUPTED
        return StoppedBy.BUDGET if self.remaining == 0.0 else StoppedBy.CONVERGED

    def interrupt(self) -> None:
        """Ask the job to stop after the step at hand."""
        self._interrupt.set()

    def share(self, fraction: float) -> Budget:
        """Return a budget of `fraction` of the time left that hears the same interrupt."""
        left, now = self.remaining * fraction, _clock.now()
        if left == 0.0:  # over at once, whatever the resolution of the clock
            return Budget(sys.float_info.min, now - 1.0, self._interrupt)
        return Budget(left, now, self._interrupt)

    def keeping(self, seconds: float) -> Budget:
        """Return a budget that ends so many seconds earlier and hears the same interrupt."""
        if math.isinf(self.seconds):
            return self
        return Budget(max(self.seconds - seconds, sys.float_info.min), self._start, self._interrupt)


class Lines:
    """Write one plain line per stage, with the time since the start, for a pipe or a log file.

    Parameters
    ----------
    stream : TextIO
        Where to write.
    budget : Budget
        Began with the job.
    """

    def __init__(self, stream: TextIO, budget: Budget) -> None:
        self._stream, self._budget = stream, budget

    def stage(self, text: str) -> None:
        """Write the stage's line."""
        # A closed reader must not end the job.
        with contextlib.suppress(OSError, ValueError):
            line = f"jaxsr: {self._budget.elapsed:.1f} s: {text}"
            print(line, file=self._stream, flush=True)

    def update(self, fraction: float, text: str = "") -> None:
        """Do nothing: updates are for terminals."""


@contextlib.contextmanager
def progress_on(stream: TextIO | None = None, budget: Budget | None = None) -> Iterator[Progress]:
    """Yield a `Progress`: a live bar if `stream` is a terminal, else one line per stage.

    Parameters
    ----------
    stream : TextIO, optional
        Standard error by default.
    budget : Budget, optional
        Of the job, for the time since its start and what is left; unlimited, from now, by default.
    """
    target = sys.stderr if stream is None else stream
    limit = budget or Budget()
    if target is None:  # a program without standard streams
        yield Silent()
        return
    if not target.isatty():
        yield Lines(target, limit)
        return
    from jaxsr._bar import live_bar

    with live_bar(target, limit) as bar:
        yield bar


class Repeated:
    """Tell before each of several like steps whether it would end after a budget.

    It is taken to last as long as the longest before it: the time between two questions.

    Parameters
    ----------
    budget : Budget
    """

    def __init__(self, budget: Budget) -> None:
        self._budget, self._asked, self._longest = budget, budget.elapsed, 0.0

    def too_long(self) -> bool:
        """Whether the next step has no time; an interrupt leaves it its time."""
        now = self._budget.elapsed
        self._longest, self._asked = max(self._longest, now - self._asked), now
        return self._budget.remaining <= self._longest


def as_budget(budget: float | Budget | None) -> Budget:
    """Return `budget` itself, or one of so many seconds, or an unlimited one for ``None``."""
    if isinstance(budget, Budget):
        return budget
    return Budget() if budget is None else Budget(float(budget))
