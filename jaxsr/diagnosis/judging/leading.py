"""The best so far in a few words, for who waits for a diagnosis."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.entry import Entry


def best_so_far(labels: Iterable[str], left: float, of: str = "re-calibration's error") -> str:
    """Say which explanation leads, and what it leaves of what re-calibration leaves.

    Parameters
    ----------
    labels : iterable of str
        Of its mechanisms.
    left : float
        Relative to re-calibration; NaN where that leaves nothing.
    of : str
        What is left.
    """
    name = " + ".join(labels)
    if not name:
        return "best so far re-calibration"
    return f"best so far {name}" + (f", {100 * left:.0f} % of {of}" if np.isfinite(left) else "")


def leading(arena: Arena, entries: Sequence[Entry]) -> str:
    """Say which estimated set leads; nothing where re-calibration cannot be simulated."""
    null = next((e for e in entries if not e.members), None)
    if null is None or not 0.0 < null.fit.cost < np.inf:
        return ""
    best = min((e for e in entries if plausible(arena, e)), key=_cost, default=null)
    best = min(best, null, key=_cost)
    labels = (arena.super_model.candidates[i].label for i in best.members)
    return best_so_far(labels, float(np.sqrt(best.fit.cost / null.fit.cost)))


def _cost(entry: Entry) -> float:
    return entry.fit.cost
