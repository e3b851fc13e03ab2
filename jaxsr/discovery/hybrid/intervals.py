"""Regions of one variable as intervals, joined and written as plainly as they can be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.discovery.hybrid.guards import Guard, Region
from jaxsr.expressions.term import Term

Interval = tuple[float, float]
"""Open below, closed above, as guards are."""


def base(variable: Term) -> Term:
    """Return x for a guard on x or on its size."""
    return variable.args[0] if variable.op == "abs" else variable


def joined_regions(regions: Sequence[Region]) -> tuple[Region, ...]:
    """Return regions with neighbours joined, where all are of one variable; else as they are.

    ``And(Abs(e) > 1, e <= 0)`` or ``And(Abs(e) <= 1, e <= 0)`` is ``e <= 0``.
    """
    bases = {base(guard.variable) for region in regions for guard in region}
    if len(bases) != 1:
        return tuple(regions)
    x = next(iter(bases))
    intervals = [part for region in regions for part in _intervals(region)]
    return tuple(_written(_union(intervals), x))


def _intervals(region: Region) -> list[Interval]:
    """Return what a region covers of the real line."""
    out: list[Interval] = [(-np.inf, np.inf)]
    for guard in region:
        c = guard.threshold
        if guard.variable.op == "abs":
            parts = [(c, np.inf), (-np.inf, -c)] if guard.above else [(-c, c)]
        else:
            parts = [(c, np.inf)] if guard.above else [(-np.inf, c)]
        out = [(max(a, p), min(b, q)) for a, b in out for p, q in parts]
        out = [(a, b) for a, b in out if a < b]
    return out


def _union(intervals: Sequence[Interval]) -> list[Interval]:
    out: list[Interval] = []
    for a, b in sorted(intervals):
        if out and a <= out[-1][1]:
            out[-1] = (out[-1][0], max(b, out[-1][1]))
        else:
            out.append((a, b))
    return out


def _written(intervals: Sequence[Interval], x: Term) -> list[Region]:
    """Return intervals as regions; two that mirror each other are one on the size of x."""
    size = Term.apply("abs", x)
    left = list(intervals)
    out: list[Region] = []
    while left:
        a, b = left.pop(0)
        if a == -b and np.isfinite(b):
            out.append((Guard(size, b, False),))
        elif a == -np.inf and np.isfinite(b) and (-b, np.inf) in left:
            left.remove((-b, np.inf))
            out.append((Guard(size, -b, True),))
        else:
            low = (Guard(x, a, True),) if np.isfinite(a) else ()
            high = (Guard(x, b, False),) if np.isfinite(b) else ()
            out.append((*low, *high))
    return out
