"""Functions written number by number, as machine code where Numba is installed."""

from __future__ import annotations

import contextlib
import functools
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


@functools.cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any] | None:
    """Return a function as machine code; None where Numba is not installed.

    It is compiled once an installation: Numba keeps what it made beside the function's file, or
    in the user's cache.

    Parameters
    ----------
    function : callable
        Of arrays and numbers, in the part of Python that Numba takes.
    """
    try:
        from numba import njit
    except ImportError:
        return None
    try:
        return njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # no folder to keep it in
        return njit(error_model="numpy")(function)


@functools.cache
def kept(function: Callable[..., Any], made: str) -> Callable[..., Any] | None:
    """Return a function as machine code where that is kept; else None, and have it made beside.

    For what takes too long to compile within a budget: another process does it, for those to come.

    Parameters
    ----------
    function : callable
    made : str
        Statement that calls it as it is called here, for the other process.
    """
    found: Any = compiled(function)
    if found is None or _is_kept(function, Path(found.stats.cache_path)):
        return found
    with contextlib.suppress(OSError):
        subprocess.Popen(
            [sys.executable, "-c", made],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    return None


def _is_kept(function: Callable[..., Any], folder: Path) -> bool:
    """Whether Numba has kept a function since its file was written."""
    source = Path(function.__code__.co_filename)
    files = folder.glob(f"{source.stem}.{function.__qualname__}-*.nbc")
    with contextlib.suppress(OSError):
        written = source.stat().st_mtime
        return any(file.stat().st_mtime >= written for file in files)
    return False
