"""What every case of a batch is checked for."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

from jaxsr._files import sha256
from jaxsr._quoting import quoted
from jaxsr._result import InputError


def words(given: Any) -> tuple[str, ...]:
    """Return paths or names as a tuple; one stands for itself."""
    several = [given] if isinstance(given, str | Path) else cast("list[str | Path]", given)
    return tuple(os.fspath(one) for one in several)


def check_seed(seed: Any, where: str) -> None:
    """Raise unless a seed is a whole number from 0.

    Raises
    ------
    InputError
        It is none.
    """
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed {quoted(seed)}", where, "Write 0, 1, 2, ...")


def check_limits(limits: dict[str, Any], where: str) -> None:
    """Raise unless every limit is absent or a number above zero.

    Raises
    ------
    InputError
        One is neither.
    """
    for name, value in limits.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < float("inf")):
            raise InputError(f"{name} {quoted(value)}", where, "Write more than zero")


def checksum(command: Iterable[str], files: Iterable[str], directory: str) -> str:
    """Return a checksum of a command and of the files that it reads, seen from a directory."""
    parts = [*command, *(sha256(Path(directory, path)) for path in files)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()
