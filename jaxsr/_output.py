"""What a command puts out: lines on standard output, and the files of its results."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxsr._process import say
from jaxsr._result import InputError


def print_line(text: str) -> None:
    """Print a result; that nobody reads it any more is no error.

    Raises
    ------
    InputError
        The file that standard output goes to cannot be written.
    """
    try:
        print(text, flush=True)
    except OSError as error:
        close_stdout()
        if error.errno not in (errno.EPIPE, errno.EIO):  # neither a closed pipe nor a terminal
            raise InputError(f"cannot be written: {error.strerror}", "standard output") from error


def close_stdout() -> None:
    """Let what is still to be printed go nowhere, at exit too."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def save_results(found: Any, folder: Path, summary: str, **options: Any) -> None:
    """Save results; where their folder does not take them after all, save what can be saved.

    Parameters
    ----------
    found : Diagnosis or Discovery
    folder : Path
    summary : str
        The result in words, printed where the folder does not take it.
    **options
        What `found.save` and `found.write` take besides.

    Raises
    ------
    InputError
        The folder cannot be written; says which temporary folder holds the results now.
    """
    try:
        found.save(folder, **options)
    except Exception as error:
        where = _rescued(found, options)
        print_line(summary)
        if isinstance(error, InputError):
            raise InputError(error.what, error.where, where) from error
        say(where)
        raise


def _rescued(found: Any, options: Mapping[str, Any]) -> str:
    """Write each file of a result that can be written in a temporary folder; say where."""
    try:
        folder = Path(tempfile.mkdtemp(prefix="jaxsr-results-"))
    except OSError:
        return "No temporary folder takes the results either"
    with contextlib.suppress(Exception):  # the first error is the one to tell
        found.write(folder, **options)
    names = sorted(path.name for path in folder.iterdir())
    if not names:
        folder.rmdir()
        return f"{folder.parent} does not take the results either"
    return f"The results are in {folder}: {', '.join(names)}"
