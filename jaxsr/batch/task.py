"""The task of a case: its process, what it said, and the mark that it is done."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from jaxsr._process import INTERRUPTED
from jaxsr.batch.claim import claimed

DONE, REFUSED = 0, 2  # exit statuses of the command
NOT_BEGUN = "jaxsr: interrupted before it began"
_POLL = 0.1  # seconds
_LONGEST = 4000  # characters of what a failed process said
_GIB = 2**30


class Job(Protocol):
    """What one process of a batch does."""

    @property
    def result(self) -> str:
        """File that is there when it is done."""
        ...

    @property
    def memory(self) -> float | None:
        """Most memory of the process in GiB."""
        ...

    def arguments(self, out: str) -> list[str]:
        """Return the command, without the program's name."""
        ...

    def key(self, out: str, directory: str = "") -> str:
        """Return a checksum of the command and of every file that it reads."""
        ...


@dataclass(frozen=True)
class Task:
    """A case, or a part of one that runs by itself, and where it runs.

    Attributes
    ----------
    name : str
        Path of its results in `out`.
    case : Job
    out : str
        Folder of the batch.
    directory : str
        Current directory of the process; relative paths start there.
    """

    name: str
    case: Job
    out: str
    directory: str

    @property
    def results(self) -> str:
        """Folder of the case's results."""
        return os.path.join(self.out, self.name)

    @property
    def mark(self) -> Path:
        """File that holds the key of the case that is done."""
        return self._beside("done")

    @property
    def claim(self) -> Path:
        """File that is held while the case runs."""
        return self._beside("running")

    def _beside(self, ending: str) -> Path:
        folder, last = os.path.split(self.results)
        return Path(self.directory, folder, f".{last}.{ending}")

    def is_done(self) -> bool:
        """Return whether this command on these files is done already."""
        try:
            known = self.mark.read_text(encoding="utf-8").strip()
        except OSError:
            return False
        whole = Path(self.directory, self.results, self.case.result).is_file()
        return whole and known == self.key()

    def key(self) -> str:
        """Return the key of the case, which another command or other files would change."""
        return self.case.key(self.results, self.directory)


@dataclass(frozen=True)
class Outcome:
    """How a case ended.

    Attributes
    ----------
    name : str
    status : int
        Exit status of its process, negative for the signal that ended it.
    said : str
        The end of what it wrote on standard error.
    """

    name: str
    status: int
    said: str = ""

    @property
    def done(self) -> bool:
        """Whether there is a diagnosis."""
        return self.status == DONE

    @property
    def begun(self) -> bool:
        """Whether it ran at all: the batch was not asked to end before."""
        return self.said != NOT_BEGUN

    @property
    def repeatable(self) -> bool:
        """Whether another try could end otherwise: input that is refused is refused again."""
        return self.status not in (DONE, REFUSED, INTERRUPTED)

    @property
    def message(self) -> str:
        """Return why it failed, in a line."""
        if self.done:
            return ""
        lines = [line.strip() for line in self.said.splitlines() if line.strip()]
        told = [line for line in lines if "error:" in line.lower()] or lines
        if self.status < 0:
            return f"ended by signal {signal.Signals(-self.status).name}"
        if not told:
            return f"ended with status {self.status}"
        return told[-1].removeprefix("jaxsr: ").removeprefix("error: ")[:200]


def run_task(task: Task, stop: Callable[[], bool] = lambda: False) -> Outcome:
    """Run a case in a process of its own.

    Parameters
    ----------
    task : Task
    stop : callable
        Whether the process should end now, with the best so far.
    """
    task.claim.parent.mkdir(parents=True, exist_ok=True)
    with claimed(task.claim, stop) as held:
        if stop():
            return Outcome(task.name, INTERRUPTED, NOT_BEGUN)
        if task.is_done():  # by a worker that a scheduler had given up
            return Outcome(task.name, DONE)
        return _run(task, stop, () if held is None else (held,))


def command(task: Task) -> list[str]:
    """Return the command of a case's process."""
    memory = int((task.case.memory or 0.0) * _GIB)
    told = [str(os.getpid()), str(memory), os.path.abspath(task.mark), task.key()]
    return [sys.executable, "-m", "jaxsr.batch.child", *told, *task.case.arguments(task.results)]


def _run(task: Task, stop: Callable[[], bool], kept: tuple[int, ...]) -> Outcome:
    """Run the process of a case, which keeps descriptors open until it ends."""
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            command(task),
            cwd=task.directory,
            env=_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,  # a Ctrl-C at the terminal is for the batch to pass on
            pass_fds=kept,
        )
        try:
            asked = False
            while process.poll() is None:
                if stop() and not asked:
                    asked = True
                    process.send_signal(signal.SIGINT)
                time.sleep(_POLL)
        finally:
            process.kill()
            process.wait()
        said.seek(max(said.seek(0, os.SEEK_END) - _LONGEST, 0))
        text = said.read().decode("utf-8", errors="replace")
    return Outcome(task.name, int(process.returncode), text)


def _environment() -> dict[str, str]:
    """Return the environment of a process that finds the jaxsr that runs here."""
    home = str(Path(__file__).resolve().parents[2])
    found = os.environ.get("PYTHONPATH", "")
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (home, found)))}
