"""Independent pieces of work side by side, on the cores that this process may use."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0))


def side_by_side(
    work: Callable[[Item], Made], items: Sequence[Item], threads: int | None = None
) -> list[Made]:
    """Return what `work` makes of each item, by default on all cores."""
    workers = threads or cores()
    if workers == 1 or len(items) == 1:
        return [work(item) for item in items]
    return list(_pool(workers, os.getpid()).map(work, items))


def spans(count: int, parts: int, first: int = 0) -> list[tuple[int, int]]:
    """Return `count` items in at most `parts` spans of like length: first, and behind the last."""
    parts = max(min(parts, count), 1)
    return list(pairwise(first + count * k // parts for k in range(parts + 1)))


@functools.cache
def _pool(workers: int, process: int) -> ThreadPoolExecutor:  # a fork has no threads of its parent
    return ThreadPoolExecutor(workers, thread_name_prefix="jaxsr")
