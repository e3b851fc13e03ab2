"""Unfinished files: under a name of their own, locked while their process lives, then swept."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

PREFIX = ".jaxsr-staging-"

_ABANDONED = 86_400.0
"""Age in seconds at which unfinished files count as left behind where no lock can tell."""

_PATIENCE = 30.0
"""Seconds to wait for another run that puts its results in the same place."""

_mine: set[Path] = set()
_placing = 0  # how many results are being put in their place just now


@contextlib.contextmanager
def staging_folder(parent: Path) -> Iterator[Path]:
    """Yield an empty folder in `parent`; what then stands under its name is removed.

    Whoever sweeps `parent` leaves it alone until this process dies, on this machine or, over a
    file system with locks, on another one.
    """
    with _staged(parent, is_folder=True) as path:
        yield path


@contextlib.contextmanager
def staging_file(parent: Path) -> Iterator[Path]:
    """Yield an empty file in `parent`, in the way of `staging_folder`."""
    with _staged(parent, is_folder=False) as path:
        yield path


@contextlib.contextmanager
def placing() -> Iterator[None]:
    """Guard the moments in which finished files take their place: `abandon` waits for them."""
    global _placing
    _placing += 1
    try:
        yield
    finally:
        _placing -= 1


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder against other runs that place their results in it; wait for those that do.

    Nothing is held where the system has no such locks.

    Raises
    ------
    TimeoutError
        Another run has held it for half a minute.
    """
    end = time.monotonic() + _PATIENCE
    while True:
        held = _open(folder)
        try:
            if held is not None:
                _lock_until(held, end)
            if held is None or _is_same(held, folder):
                yield
                return
        finally:
            if held is not None:
                os.close(held)


def sweep(folder: Path) -> float:
    """Remove from `folder` the unfinished files of processes that are dead.

    Returns
    -------
    float
        When the oldest of them was last written, in seconds since the epoch; infinity if there
        were none.
    """
    oldest = math.inf
    with contextlib.suppress(OSError):
        for name in os.listdir(folder):
            if name.startswith(PREFIX) and folder / name not in _mine:
                oldest = min(oldest, _remove_if_dead(folder / name))
    return oldest


def abandon() -> bool:
    """Remove this process's unfinished files, unless they are being put in their place.

    Returns
    -------
    bool
        Whether nothing was being put in its place.
    """
    if _placing:
        return False
    for path in list(_mine):
        _remove(path)
    return True


@contextlib.contextmanager
def _staged(parent: Path, is_folder: bool) -> Iterator[Path]:
    path, held = _made(parent, is_folder)
    try:
        yield path
    finally:
        try:
            _remove(path)
        finally:
            _mine.discard(path)
            if held is not None:
                os.close(held)


def _made(parent: Path, is_folder: bool) -> tuple[Path, int | None]:
    """Return a new folder or file, and the descriptor that holds its lock."""
    while True:
        if is_folder:
            path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        else:
            handle, name = tempfile.mkstemp(prefix=PREFIX, dir=parent)
            os.close(handle)
            path = Path(name)
        _mine.add(path)
        held = _open(path)
        if held is None:
            return path, None
        with contextlib.suppress(BlockingIOError):
            if not _lock(held) or _is_same(held, path):
                return path, held
        # Another run swept it between its making and its lock.
        os.close(held)
        _remove(path)
        _mine.discard(path)


def _open(path: Path) -> int | None:
    if fcntl is None:
        return None
    try:
        return os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return None


def _lock(held: int) -> bool:
    """Lock a descriptor and return whether the file system has such locks.

    Raises
    ------
    BlockingIOError
        Another process holds it.
    """
    if fcntl is None:
        return False
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def _lock_until(held: int, end: float) -> None:
    """Lock a descriptor, waiting until `end` for who holds it.

    Raises
    ------
    TimeoutError
        Somebody still holds it.
    """
    while True:
        try:
            _lock(held)
            return
        except BlockingIOError as error:
            if time.monotonic() > end:
                raise TimeoutError(errno.ETIMEDOUT, "another run is writing there") from error
            time.sleep(0.01)


def _is_same(held: int, path: Path) -> bool:
    """Return whether an open descriptor is what stands at `path` now."""
    try:
        there = os.lstat(path)
    except OSError:
        return False
    return os.path.samestat(os.fstat(held), there)


def _remove_if_dead(path: Path) -> float:
    """Remove the unfinished files of a dead process; return their time, infinity if it lives."""
    held = _open(path)
    try:
        written = path.lstat().st_mtime
        if (held is not None and _lock(held)) or time.time() - written > _ABANDONED:
            _remove(path)
            return written
    except OSError:  # it is alive, or gone already
        pass
    finally:
        if held is not None:
            os.close(held)
    return math.inf


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()
