"""Wall-clock times with their spread, and two subjects timed in alternation.

A machine slows down and speeds up while other work runs; taken in pairs, both subjects meet the
same minutes, and the median of the ratios of pairs is steadier than the ratio of medians.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Spread:
    """Median and quartiles of repeated measurements."""

    median: float
    quartile_1: float
    quartile_3: float
    repeats: int


@dataclass(frozen=True)
class Pairs:
    """Seconds of two subjects, taken in alternation.

    Attributes
    ----------
    ours, theirs : tuple of float
    """

    ours: tuple[float, ...]
    theirs: tuple[float, ...]

    def document(self, work: float, peer: str) -> dict[str, Any]:
        """Return rates (work per second) and ratios of seconds: above 1, ours is faster."""
        a, b = np.array(self.ours), np.array(self.theirs)
        return {
            "ours": asdict(spread(work / a)),
            peer: asdict(spread(work / b)),
            "ratio_of_medians": float(np.median(b) / np.median(a)),
            "paired_ratio": asdict(spread(b / a)),
        }


def seconds(call: Callable[[], object]) -> float:
    """Return the seconds that a call took."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def repeated(call: Callable[[], object], repeats: int, warm: int = 1) -> tuple[float, ...]:
    """Return the seconds of each repeat, after calls that are not timed."""
    for _ in range(warm):
        call()
    return tuple(seconds(call) for _ in range(repeats))


def alternated(ours: Callable[[], object], theirs: Callable[[], object], repeats: int) -> Pairs:
    """Time two calls in turns, A B A B ..., after one of each that is not timed."""
    for call in (ours, theirs):
        call()
    taken = [(seconds(ours), seconds(theirs)) for _ in range(repeats)]
    return Pairs(tuple(a for a, _ in taken), tuple(b for _, b in taken))


def spread(values: Sequence[float] | np.ndarray) -> Spread:
    """Return median and quartiles."""
    low, middle, high = np.percentile(np.asarray(values, dtype=float), [25, 50, 75])
    return Spread(float(middle), float(low), float(high), len(values))


def exponent(rows: Sequence[float], times: Sequence[float]) -> float:
    """Return the slope of log seconds over log rows, by least squares."""
    return float(np.polyfit(np.log(rows), np.log(times), 1)[0])
