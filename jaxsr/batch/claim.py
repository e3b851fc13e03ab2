"""The claim of a process on a case: two workers never write the results of one."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Generator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

_POLL = 0.1  # seconds


@contextlib.contextmanager
def claimed(path: Path, stop: Callable[[], bool]) -> Generator[int | None]:
    """Hold a file against other processes and threads; wait for who holds it, or until `stop`.

    A scheduler gives the case of a worker that it lost to another one, and the lost one may go on.
    The system ends the claim of a process that is killed; one that inherited the descriptor keeps
    it.

    Parameters
    ----------
    path : Path
        Removed at the end.
    stop : callable

    Yields
    ------
    int or None
        Descriptor of the claim; None where there is none: `stop`, or a system without locks.
    """
    held = _waited(path, stop)
    try:
        yield held
    finally:
        if held is not None:
            path.unlink(missing_ok=True)
            os.close(held)


def _waited(path: Path, stop: Callable[[], bool]) -> int | None:
    while fcntl is not None and not stop():
        held = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_same(held, path):
                return held
        except BlockingIOError:
            time.sleep(_POLL)
        except OSError:  # a file system without locks
            os.close(held)
            return None
        os.close(held)
    return None


def _is_same(held: int, path: Path) -> bool:
    """Return whether what is held still stands there: who held it before removed it."""
    try:
        return os.path.samestat(os.fstat(held), os.stat(path))
    except OSError:
        return False
