"""The clock that budgets are read on: wall-clock time, or this process' own processor time.

The environment variable ``JAXSR_CLOCK=processor`` asks for processor time, summed over threads:
what runs beside takes nothing of a budget then, so that benchmarks can be rerun on a busy machine.
"""

from __future__ import annotations

import os
import time


def now() -> float:
    """Return seconds since some fixed moment; it never runs backwards."""
    return time.process_time() if processor() else time.monotonic()


def processor() -> bool:
    """Whether budgets are of processor time."""
    return os.environ.get("JAXSR_CLOCK") == "processor"
