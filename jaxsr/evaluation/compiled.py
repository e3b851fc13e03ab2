"""Compiled programs kept on disk between runs."""

from __future__ import annotations

import atexit
import contextlib
import math
import os
import warnings
from pathlib import Path

import jax
import pooch

from jaxsr._staging import staging_file, sweep

_SECONDS = 0.2  # programs that compile faster are not worth a file
_DAMAGED = r"Error (reading|writing) persistent compilation cache"

_marked: set[Path] = set()


def keep_compiled(folder: str | Path | None = None) -> Path:
    """Keep what JAX compiles in a folder, so that the next process need not compile it again.

    The commands do so by themselves. It sets JAX's own persistent cache for the whole process,
    which is why importing jaxsr does not.

    JAX writes an entry in place and never again, so that one whose writing was cut off would be
    compiled in every run to come, with a warning each time. A run therefore leaves a mark in the
    folder that is locked while it lives, and the next one drops what was written since the mark
    of a run that died. An entry that cannot be read, because another run is just writing it, is
    compiled without a word.

    Parameters
    ----------
    folder : path, optional
        By default what ``JAX_COMPILATION_CACHE_DIR`` says, else a folder of the user's cache.

    Returns
    -------
    Path
        The folder.
    """
    chosen = (
        folder or os.environ.get("JAX_COMPILATION_CACHE_DIR") or pooch.os_cache("jaxsr") / "xla"
    )
    path = Path(chosen)
    jax.config.update("jax_compilation_cache_dir", str(path))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", _SECONDS)
    warnings.filterwarnings("ignore", _DAMAGED)
    with contextlib.suppress(OSError):  # without a folder that takes files nothing is kept
        _mark(path)
    return path


def _mark(folder: Path) -> None:
    """Drop what dead runs may have left unfinished, and mark `folder` until this one ends."""
    folder.mkdir(parents=True, exist_ok=True)
    since = sweep(folder)
    if since < math.inf:
        for entry in folder.iterdir():
            if entry.name.endswith("-cache") and entry.stat().st_mtime >= since:
                entry.unlink(missing_ok=True)
    if folder not in _marked:
        mark = contextlib.ExitStack()
        mark.enter_context(staging_file(folder))
        atexit.register(mark.close)
        _marked.add(folder)
