"""The clock that budgets are read on: wall-clock time, or processor time.

The environment variable ``JAXSR_CLOCK=processor`` asks for the processor time of this process,
summed over threads, and of those that it asks (`count`): what runs beside takes nothing of a
budget then, so that benchmarks can be rerun on a busy machine.
"""

from __future__ import annotations

import os
import time

_elsewhere: list[float] = []
"""Seconds that other processes have used in answering this one."""


def now() -> float:
    """Return seconds since some fixed moment; it never runs backwards."""
    return time.process_time() + sum(_elsewhere) if processor() else time.monotonic()


def count(seconds: float) -> None:
    """Count what another process has used in answering this one."""
    _elsewhere[:] = [sum(_elsewhere) + seconds]


def processor() -> bool:
    """Whether budgets are of processor time."""
    return os.environ.get("JAXSR_CLOCK") == "processor"
