"""The tasks of a batch on Dask: given out, lost, given out once more."""

from __future__ import annotations

import contextlib
import logging
import uuid
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import CancelledError
from typing import Any

from jaxsr._result import InputError
from jaxsr.batch.task import DONE, Outcome, Task

PATIENCE = 20.0
"""Seconds to reach a scheduler, and to wait for one that went away."""
_NO_ANSWER = (OSError, TimeoutError, CancelledError)  # of a scheduler or a worker that is gone


class Futures:
    """Tasks that a client of Dask gave out.

    Parameters
    ----------
    client : distributed.Client
    work : callable
        Runs a task, on a worker.
    """

    def __init__(self, client: Any, work: Callable[[Task], Outcome]) -> None:
        self._client, self._work = client, work
        self._tasks: dict[Any, Task] = {}  # by future
        self._lost: set[str] = set()
        self._withdrawn: set[str] = set()

    def __len__(self) -> int:
        return len(self._tasks)

    def submit(self, task: Task) -> None:
        """Give a task out."""
        key = f"jaxsr-{task.name}-{uuid.uuid4().hex}"
        self._tasks[self._client.submit(self._work, task, key=key, pure=False)] = task

    def ended(self) -> Iterator[Outcome]:
        """Yield what ended since the last look; give out once more what Dask lost.

        Raises
        ------
        InputError
            The scheduler is gone.
        """
        for future, task in list(self._tasks.items()):
            if future.status == "pending":
                continue
            if future.status == "error":  # its worker was lost too often
                del self._tasks[future]
                yield Outcome(task.name, 1, f"error: {future.exception()}")
                continue
            outcome = self._outcome(future, task)
            if outcome is not None or task.name in self._withdrawn:
                del self._tasks[future]
                if outcome is not None:
                    yield outcome
            elif self._client.status in ("closing", "closed"):
                what = "the scheduler is gone; what is done is kept"
                raise InputError(what, "batch", "Start a scheduler; --resume goes on")
            elif self._client.status == "running":  # neither is it looking for its scheduler
                del self._tasks[future]
                if task.name in self._lost:
                    yield Outcome(task.name, 1, "error: lost twice by Dask")
                else:
                    self._lost.add(task.name)
                    self.submit(task)

    def _outcome(self, future: Any, task: Task) -> Outcome | None:
        """Return how a task ended; None where that is lost, and the case is not done.

        The mark of this run is as good as the word of a worker, which may be gone.
        """
        if task.mark.exists():
            return Outcome(task.name, DONE)
        if future.status == "finished":
            with contextlib.suppress(*_NO_ANSWER):
                return future.result(timeout=PATIENCE)
        return None

    def withdraw(self) -> None:
        """Cancel what no worker has taken yet; what one runs is waited for."""
        with contextlib.suppress(*_NO_ANSWER):
            taken = {key for keys in self._processing().values() for key in keys}
            waiting = [
                (future, task)
                for future, task in self._tasks.items()
                if future.key not in taken and not future.done()
            ]
            self._withdrawn |= {task.name for _, task in waiting}
            self._client.cancel([future for future, _ in waiting])

    def running(self) -> int:
        """Return how many tasks run now."""
        own = {future.key for future in self._tasks}
        count = 0
        with contextlib.suppress(*_NO_ANSWER):
            threads = self._client.nthreads()
            for worker, keys in self._processing().items():
                count += min(len(own.intersection(keys)), threads.get(worker, 0))
        return count

    def _processing(self) -> dict[str, Any]:
        """Return the keys that each worker runs or is about to run."""
        return self._client.processing() if self._client.status == "running" else {}


@contextlib.contextmanager
def connected(workers: int, scheduler: str | None) -> Generator[Any]:
    """Yield a client of Dask: of the scheduler at an address, or of local workers.

    Local workers are threads: every case is a process already, with its own limits of time and
    memory, and a thread that waits for it needs no interpreter of its own.

    Raises
    ------
    InputError
        Dask is not installed, or no scheduler answers.
    """
    distributed = _distributed()
    with _quiet(), _client(distributed, workers, scheduler) as client, client.as_current():
        yield client


@contextlib.contextmanager
def _quiet() -> Generator[None]:
    """Say nothing of lost connections: whoever meets the loss says it in a line."""
    loggers = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


def _client(distributed: Any, workers: int, scheduler: str | None) -> Any:
    if scheduler is not None:
        try:
            return distributed.Client(scheduler, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            what = f"no scheduler answers: {' '.join(str(error).split())[:80]}"
            remedy = "Give the address that dask scheduler prints, such as tcp://10.0.0.1:8786"
            raise InputError(what, f"--scheduler {scheduler[:80]}", remedy) from None
    return distributed.Client(
        n_workers=workers,
        threads_per_worker=1,
        processes=False,
        memory_limit=None,
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.ERROR,
        set_as_default=False,
    )


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        remedy = 'Install it: python -m pip install "jaxsr-dynamics[batch]"'
        raise InputError("more than one worker needs Dask", "batch", remedy) from None
    return distributed
