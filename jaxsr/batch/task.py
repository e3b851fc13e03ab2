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

from jaxsr._files import atomic_write_text
from jaxsr._process import INTERRUPTED
from jaxsr.batch.cases import Case

DONE, REFUSED = 0, 2  # exit statuses of the command
_POLL = 0.1  # seconds
_LONGEST = 4000  # characters of what a failed process said
_GIB = 2**30


@dataclass(frozen=True)
class Task:
    """A case and where it runs.

    Attributes
    ----------
    name : str
    case : Case
    out : str
        Folder of the batch.
    directory : str
        Current directory of the process; relative paths start there.
    """

    name: str
    case: Case
    out: str
    directory: str

    @property
    def results(self) -> str:
        """Folder of the case's results."""
        return os.path.join(self.out, self.name)

    @property
    def mark(self) -> Path:
        """File that holds the key of the case that is done."""
        return Path(self.out) / f".{self.name}.done"

    def is_done(self) -> bool:
        """Return whether this command on these files is done already."""
        try:
            known = self.mark.read_text(encoding="utf-8").strip()
        except OSError:
            return False
        whole = Path(self.results, "diagnosis.json").is_file()
        return whole and known == self.case.key(self.results)


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
    if stop():
        return Outcome(task.name, INTERRUPTED, "jaxsr: interrupted before it began")
    arguments = task.case.arguments(task.results)
    memory = int((task.case.memory or 0.0) * _GIB)
    command = [sys.executable, "-m", "jaxsr.batch.child", str(os.getpid()), str(memory)]
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen(
            [*command, *arguments],
            cwd=task.directory,
            env=_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=said,
            start_new_session=True,  # a Ctrl-C at the terminal is for the batch to pass on
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
    outcome = Outcome(task.name, int(process.returncode), text)
    if outcome.done:
        atomic_write_text(task.mark, task.case.key(task.results) + "\n")
    return outcome


def _environment() -> dict[str, str]:
    """Return the environment of a process that finds the jaxsr that runs here."""
    home = str(Path(__file__).resolve().parents[2])
    found = os.environ.get("PYTHONPATH", "")
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (home, found)))}
