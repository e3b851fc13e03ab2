"""A folder that grows: recordings are judged as they are whole."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from jaxsr.recordings.containers.opened import LIBRARIES

ENDINGS = (".csv", ".tsv", ".gz", ".parquet", ".npz", ".mat", ".xlsx", *LIBRARIES)
"""Of the files that are recordings; others are left alone."""
PAUSE = 2.0
"""Seconds between two looks. A file is whole when it is the same at both."""


def recordings(
    places: list[Path],
    follow: bool,
    stop: Callable[[], bool],
    pause: float = PAUSE,
) -> Iterator[Path]:
    """Yield files, and those of folders in the order of their times, each once.

    Parameters
    ----------
    places : list of Path
        Files and folders.
    follow : bool
        Whether to wait for more until `stop`. A file that is still written is waited for.
    stop : callable
        Whether to end now.
    pause : float
        Seconds between two looks.
    """
    done: set[Path] = set()
    before: dict[Path, tuple[int, int]] = {}
    while not stop():
        now = _held(places)
        for path, state in now.items():
            if path not in done and (not follow or before.get(path) == state):
                done.add(path)
                yield path
                if stop():
                    return
        if not follow:
            return
        before = now
        _wait(pause, stop)


def _held(places: list[Path]) -> dict[Path, tuple[int, int]]:
    """Return the recordings there are, oldest first, with their size and time."""
    found: dict[Path, tuple[int, int]] = {}
    for place in places:
        files = [place] if not place.is_dir() else sorted(place.iterdir())
        states: list[tuple[int, str, Path, int]] = []
        for path in files:
            if place.is_dir() and not path.name.lower().endswith(ENDINGS):
                continue
            try:
                status = os.stat(path)
            except OSError:  # it went away between two looks
                continue
            states.append((status.st_mtime_ns, path.name, path, status.st_size))
        found |= {path: (size, changed) for changed, _, path, size in sorted(states)}
    return found


def _wait(seconds: float, stop: Callable[[], bool]) -> None:
    """Wait, or less where it is to end."""
    end = time.monotonic() + seconds
    while not stop() and (left := end - time.monotonic()) > 0.0:
        time.sleep(min(left, 0.1))
