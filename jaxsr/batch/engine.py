"""What runs the tasks of a batch: one after another here, or Dask."""

from __future__ import annotations

import contextlib
import logging
import uuid
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from jaxsr._result import InputError
from jaxsr.batch.task import Outcome, Task, run_task

Stop = Callable[[], bool]
_LOOK = 0.5  # seconds between looks at whether to stop
_PATIENCE = 20.0  # seconds to reach a scheduler
_STOPS: list[Stop] = []  # asked by tasks that run in this process


def never() -> bool:
    """Return False: nobody asks for an end."""
    return False


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
    """

    workers: int = 1
    scheduler: str | None = None
    stop: Stop = never

    def outcomes(self, tasks: Sequence[Task]) -> Iterator[Outcome]:
        """Run tasks; yield each outcome as it comes.

        Raises
        ------
        InputError
            Dask is needed and not installed, or no scheduler answers at the address.
        """
        if tasks and (self.workers > 1 or self.scheduler is not None):
            yield from self._on_dask(tasks)
            return
        for task in tasks:
            if self.stop():
                return
            yield run_task(task, self.stop)

    def _on_dask(self, tasks: Sequence[Task]) -> Iterator[Outcome]:
        """Run tasks on workers; Dask gives those of a worker that is lost to another one.

        Local workers are threads: every case is a process already.
        """
        distributed = _distributed()
        with contextlib.ExitStack() as opened:
            _STOPS.append(self.stop)
            opened.callback(_STOPS.remove, self.stop)
            client = opened.enter_context(_client(distributed, self.workers, self.scheduler))
            opened.enter_context(client.as_current())
            names: dict[Any, str] = {}
            for task in tasks:
                key = f"jaxsr-{task.name}-{uuid.uuid4().hex}"
                names[client.submit(_task, task, key=key, pure=False)] = task.name
            while names:
                if self.stop():
                    _cancel_waiting(client, names)
                with contextlib.suppress(TimeoutError):
                    distributed.wait(list(names), timeout=_LOOK, return_when="FIRST_COMPLETED")
                for future in [f for f in names if f.done()]:
                    name = names.pop(future)
                    if future.status == "finished":
                        yield future.result()
                    elif future.status == "error":  # its worker was lost too often
                        yield Outcome(name, 1, f"error: {future.exception()}")


def _cancel_waiting(client: Any, names: dict[Any, str]) -> None:
    """Cancel what no worker has taken yet; what one runs is waited for."""
    taken = {key for keys in client.processing().values() for key in keys}
    client.cancel([f for f in names if f.key not in taken and not f.done()])


def _task(task: Task) -> Outcome:
    """Run a task on a worker; one in the batch's own process hears when to stop."""
    return run_task(task, lambda: any(stop() for stop in list(_STOPS)))


def _is_running(client: Any, future: Any) -> bool:
    return any(future.key in keys for keys in client.processing().values())


def _client(distributed: Any, workers: int, scheduler: str | None) -> Any:
    if scheduler is not None:
        try:
            return distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            what = f"no scheduler answers: {' '.join(str(error).split())[:80]}"
            remedy = "Give the address that dask scheduler prints, such as tcp://10.0.0.1:8786"
            raise InputError(what, f"--scheduler {scheduler[:80]}", remedy) from None
    return distributed.Client(
        n_workers=workers,
        threads_per_worker=1,
        processes=False,
        memory_limit=None,
        dashboard_address=None,
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
