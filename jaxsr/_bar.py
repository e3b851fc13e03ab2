"""The live bar of a terminal: what is being done, how far it is, and what is left of the time."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator
from typing import Protocol, TextIO

from rich.console import Console, RenderableType
from rich.progress import BarColumn, ProgressColumn, Task
from rich.progress import Progress as Live
from rich.text import Text


class Limit(Protocol):
    """A limit of time: seconds since its start, and seconds that are left of it."""

    @property
    def elapsed(self) -> float: ...
    @property
    def remaining(self) -> float: ...


class _Time(ProgressColumn):
    """The time since the start and, under a limit, what is left of it."""

    def __init__(self, budget: Limit) -> None:
        super().__init__()
        self._budget = budget

    def render(self, task: Task) -> Text:
        """Return the time as it is now."""
        spent, left = self._budget.elapsed, self._budget.remaining
        return Text(f"{spent:.0f} s" if math.isinf(left) else f"{spent:.0f} s, {left:.0f} s left")


class _Display(Live):
    """A line of text above the bar, which keeps its place under a long line."""

    line = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        """Yield the two lines."""
        yield Text(self.line, no_wrap=True, overflow="ellipsis")
        yield self.make_tasks_table(self.tasks)


class Bar:
    """Tell a terminal how far a job is.

    Parameters
    ----------
    display : _Display
    """

    def __init__(self, display: _Display) -> None:
        self._display, self._stage = display, ""
        self._task = display.add_task("", total=1.0)

    def stage(self, text: str) -> None:
        """Begin a stage."""
        self._stage = text
        self.update(0.0)

    def update(self, fraction: float, text: str = "") -> None:
        """Say how far the stage is, with a word on what is being done and on the best so far."""
        self._display.line = f"{self._stage}: {text}" if text else self._stage
        self._display.update(self._task, completed=fraction)


@contextlib.contextmanager
def live_bar(stream: TextIO, budget: Limit) -> Iterator[Bar]:
    """Show a bar until the block ends, and leave nothing of it."""
    columns = BarColumn(), _Time(budget)
    with _Display(*columns, console=Console(file=stream), transient=True) as display:
        yield Bar(display)
