"""Hold a process, and every machine in it, to the same cores."""

from __future__ import annotations

import os

import jax

CORES = 2


def use(number: int) -> int:
    """Run on `number` cores from now on, before JAX's first use; return how many it is.

    JAX sees one CPU device a core, so that rows can be sharded; thread pools that start later
    find these cores only. Where the system pins no process, the pools take what they find.
    """
    if hasattr(os, "sched_setaffinity"):
        mine = sorted(os.sched_getaffinity(0))[:number]
        os.sched_setaffinity(0, mine)
        number = len(mine)
    jax.config.update("jax_num_cpu_devices", number)
    return number
