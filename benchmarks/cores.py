"""Hold a process, and every machine in it, to the same cores."""

from __future__ import annotations

import os

CORES = 2


def use(number: int) -> int:
    """Run on `number` cores from now on, before JAX's first use; return how many it is.

    Thread pools that start later find these cores only, JAX's and ours among them; where the
    system pins no process, they take what they find.
    """
    if hasattr(os, "sched_setaffinity"):
        mine = sorted(os.sched_getaffinity(0))[:number]
        os.sched_setaffinity(0, mine)
        return len(mine)
    return os.cpu_count() or number
