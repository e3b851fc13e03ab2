"""Functions written number by number, as machine code where Numba is installed."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import FunctionType
from typing import Any


@functools.cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any] | None:
    """Return a function as machine code; None where Numba is not installed.

    Other threads run beside it. It is compiled once an installation: Numba keeps what it made
    beside the function's file, or in the user's cache.

    Parameters
    ----------
    function : callable
        Of arrays and numbers, in the part of Python that Numba takes. Functions of its package
        that it calls are compiled with it.
    """
    try:
        from numba import njit
    except ImportError:
        return None
    whole = _linked(function)
    try:
        return njit(cache=True, nogil=True, error_model="numpy")(whole)
    except RuntimeError:  # no folder to keep it in
        return njit(nogil=True, error_model="numpy")(whole)


def _called(function: Callable[..., Any]) -> dict[str, Callable[..., Any]]:
    """Return the functions of the same package that a function calls, by their names there."""
    known, package = function.__globals__, function.__module__.split(".")[0]
    named = {name: known.get(name) for name in function.__code__.co_names}
    return {
        name: found
        for name, found in named.items()
        if isinstance(found, FunctionType) and found.__module__.split(".")[0] == package
    }


def _sources(function: Callable[..., Any]) -> list[Path]:
    """Return the files that a function and those that it calls are written in."""
    found = {Path(function.__code__.co_filename)}
    return sorted(found.union(*map(_sources, _called(function).values())))


def _linked(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that calls compiled ones in the place of their texts.

    What was compiled of it is kept by its name, and called functions may change where its own file
    does not: its name says which they were.
    """
    called = {name: compiled(found) for name, found in _called(function).items()}
    if not called:
        return function
    whole = FunctionType(function.__code__, {**function.__globals__, **called})
    functools.update_wrapper(whole, function)
    whole.__qualname__ += f"_{_digest(path.read_bytes() for path in _sources(function))}"
    return whole


def _digest(words: Iterable[bytes]) -> str:
    return hashlib.sha256(b"\0".join(words)).hexdigest()[:16]


@functools.cache
def kept(function: Callable[..., Any], made: str) -> Callable[..., Any] | None:
    """Return a function as machine code where that is kept; else None, and have it made beside.

    For what takes too long to compile within a budget: another process does it, for those to come.

    Parameters
    ----------
    function : callable
    made : str
        Statement that calls it as it is called here and notes that (`mark`), for the other process.
    """
    found: Any = compiled(function)
    noted = None if found is None else _mark(function, found)
    if noted is None:  # nowhere to keep anything
        return None
    if noted.is_file():
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


def mark(function: Callable[..., Any]) -> None:
    """Note that a function was compiled, and is kept beside the note."""
    noted = _mark(function, compiled(function))
    with contextlib.suppress(OSError):
        if noted is not None:
            noted.touch()


def _mark(function: Callable[..., Any], found: Any) -> Path | None:
    """Return the file that says of a text, a compiler and a processor that they were joined.

    Numba tells texts apart by what they hold: when a file was written says nothing.
    """
    import numba
    from llvmlite import binding

    folder = found.stats.cache_path
    if folder is None:
        return None
    source = Path(function.__code__.co_filename)
    texts = [path.read_bytes() for path in _sources(function)]
    words = numba.__version__, binding.get_host_cpu_name(), sys.version
    joined = _digest([*texts, *(word.encode() for word in words)])
    return Path(folder) / f"{source.stem}.{function.__qualname__}.{joined}.kept"
