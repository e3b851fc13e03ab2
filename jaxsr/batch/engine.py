"""What runs the tasks of a batch: one after another here, or Dask."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from jaxsr.batch.cluster import Futures, connected
from jaxsr.batch.task import Outcome, Task, run_task

Stop = Callable[[], bool]
_LOOK = 0.2  # seconds between looks at what ended, and whether to stop
_COUNT = 1.0  # seconds between questions to the scheduler of how many run
_STOPS: list[Stop] = []  # asked by tasks that run in this process


def never() -> bool:
    """Return False: nobody asks for an end."""
    return False


def ignore(running: int) -> None:
    """Tell nobody how many tasks run."""


@dataclass(frozen=True)
class Engine:
    """Where the tasks of a batch run.

    Parameters
    ----------
    workers : int
        Tasks at a time on this machine.
    scheduler : str or None
        Address of a Dask scheduler.
    stop : callable
        Whether to begin no more, and to ask those that run here for the best so far.
    tell : callable
        Hears how many tasks run.
    """

    workers: int = 1
    scheduler: str | None = None
    stop: Stop = never
    tell: Callable[[int], None] = ignore

    def outcomes(self, tasks: Sequence[Task]) -> Iterator[Outcome]:
        """Run tasks; yield each outcome as it comes, none of what did not begin.

        Raises
        ------
        InputError
            Dask is needed and not installed, no scheduler answers at the address, or it is gone.
        """
        if tasks and (self.workers > 1 or self.scheduler is not None):
            yield from self._on_dask(tasks)
            return
        for task in tasks:
            if self.stop():
                return
            self.tell(1)
            outcome = run_task(task, self.stop)
            if outcome.begun:
                yield outcome

    def _on_dask(self, tasks: Sequence[Task]) -> Iterator[Outcome]:
        """Run tasks on workers; Dask gives those of a worker that is lost to another one."""
        with contextlib.ExitStack() as opened:
            _STOPS.append(self.stop)
            opened.callback(_STOPS.remove, self.stop)
            futures = Futures(opened.enter_context(connected(self.workers, self.scheduler)), _task)
            for task in tasks:
                futures.submit(task)
            counted = -_COUNT
            while futures:
                if self.stop():
                    futures.withdraw()
                if time.monotonic() - counted >= _COUNT:
                    self.tell(futures.running())
                    counted = time.monotonic()
                yield from (outcome for outcome in futures.ended() if outcome.begun)
                time.sleep(_LOOK)


def _task(task: Task) -> Outcome:
    """Run a task on a worker; one in the batch's own process hears when to stop."""
    return run_task(task, lambda: any(stop() for stop in list(_STOPS)))
