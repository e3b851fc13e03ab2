"""The process of a command: when it began, and the signals that ask it to end."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

INTERRUPTED = 130
"""Exit status of a command that was asked to end."""

_ECHO = 0.1
"""Seconds after a first request in which a second one is the same: what the terminal sends to a
group of processes, `timeout` and other wrappers pass on once more."""

_SLOWEST_START = 2.0
"""Seconds that an interpreter may take to begin. A process that says more waited for something
else before it became this program (``sleep 30; exec jaxsr ...``)."""

_SIGNALS = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]


class Run:
    """One run of a command: when it began, and whether it was asked to end.

    The first Ctrl-C, hang-up or termination drops the work while there is nothing to keep, and
    later sets a flag alone, for the job to end with what it has. Then a second Ctrl-C drops the
    work; a second hang-up or termination is the first one repeated.

    Parameters
    ----------
    began : float
        On the clock of ``time.monotonic``, in seconds.
    drop : callable
        Drops the work. It should not raise in a program: an exception of the handler is lost, or
        crashes, where it meets the loading of a compiled library or a callback of one.

    echo : float
        Seconds after a first request in which a Ctrl-C is the same one.

    Attributes
    ----------
    asked : threading.Event
        Set by the first request.
    keeps : bool
        Whether the job, asked to end, would give what it has found so far.
    outcome : str
        What to say of the files when the run ends early.
    """

    def __init__(self, began: float, drop: Callable[[Run], None], echo: float = 0.0) -> None:
        self.began = began
        self.asked = threading.Event()
        self.keeps = False
        self.outcome = "nothing was written"
        self._drop, self._echo = drop, echo
        self._first: float | None = None  # a plain value: `Event.set` does not bear a nested call

    def hear(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        now = time.monotonic()
        if self._first is None:
            self._first = now
            self.asked.set()
            if self.keeps:
                say("stopping; what was found so far will be written (Ctrl-C again to drop it)")
            else:
                self._drop(self)
        elif number == signal.SIGINT and now - self._first >= self._echo:
            self._drop(self)


_program: Run | None = None  # of a process that is one command and nothing else


def listen() -> Run:
    """Hear signals from now until the process ends; to drop the work ends it at once.

    For programs, as the first thing they do: Python's own handler would lose a Ctrl-C while
    compiled libraries load.
    """
    global _program
    if _program is None:
        _program = Run(_process_began(), _end, _ECHO)
        _install(_program)
    return _program


@contextlib.contextmanager
def listening() -> Iterator[Run]:
    """Hear signals in the block; to drop the work raises ``KeyboardInterrupt``.

    In a program that listens already, and outside the main thread, where Python delivers no
    signals, nothing is installed. The program hears no more signals after the block: its work is
    done, and a late one would change its exit status.
    """
    if _program is not None:
        yield _program
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)
        return
    run = Run(time.monotonic(), _raise)
    if threading.current_thread() is not threading.main_thread():
        yield run
        return
    previous = _install(run)
    try:
        yield run
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def say(text: str) -> None:
    """Write a line on standard error, if anybody still reads it."""
    with contextlib.suppress(OSError, ValueError, RuntimeError, AttributeError):
        try:
            print(f"jaxsr: {text}", file=sys.stderr, flush=True)
        except OSError:  # what is left of it goes nowhere: at exit it would change the status
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


def _install(run: Run) -> dict[int, Callable[[int, FrameType | None], object] | int]:
    """Let `run` hear the signals that the parent did not ask to ignore, as ``nohup`` does."""
    previous = {}
    for number in _SIGNALS:
        handler = signal.getsignal(number)
        if handler is not None and handler != signal.SIG_IGN:
            previous[number] = handler
            signal.signal(number, run.hear)
    return previous


def _raise(run: Run) -> None:
    raise KeyboardInterrupt


def _end(run: Run) -> None:
    """End the process here and now, without litter; results on their way to DIR get there first."""
    staging = sys.modules.get("jaxsr._staging")
    if staging is not None and not staging.abandon():
        return
    with contextlib.suppress(OSError, ValueError, AttributeError):
        if sys.stderr.isatty():
            sys.stderr.write("\x1b[?25h\n")  # the cursor, which a live bar hides
    say(f"interrupted; {run.outcome}")
    os._exit(INTERRUPTED)


def _process_began() -> float:
    """Return when this process began, on the clock of ``time.monotonic``, in seconds.

    On Linux from the field ``starttime`` of proc(5), so that the start of the interpreter counts;
    elsewhere it is now.
    """
    now = time.monotonic()
    try:
        with open("/proc/self/stat", "rb") as stream:
            ticks = int(stream.read().rpartition(b")")[2].split()[19])
        since_boot = time.clock_gettime(time.CLOCK_BOOTTIME)
        elapsed = since_boot - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return now
    return now - elapsed if 0.0 <= elapsed <= _SLOWEST_START else now
