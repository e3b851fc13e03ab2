"""Functions written number by number, as machine code where Numba is installed."""

from __future__ import annotations

import functools
from collections.abc import Callable
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
