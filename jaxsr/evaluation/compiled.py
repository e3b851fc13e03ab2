"""Compiled programs kept on disk between runs."""

from __future__ import annotations

import os
from pathlib import Path

import jax
import pooch

_SECONDS = 0.2  # programs that compile faster are not worth a file


def keep_compiled(folder: str | Path | None = None) -> Path:
    """Keep what JAX compiles in a folder, so that the next process need not compile it again.

    The commands do so by themselves. It sets JAX's own persistent cache for the whole process,
    which is why importing jaxsr does not.

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
    return path
