"""How round a corner is: the width at which the evidence is largest."""

from __future__ import annotations

import math
from collections.abc import Mapping


def likeliest_width(logs: Mapping[float, float], gain: float) -> float | None:
    """Return where the parabola through the best width and its neighbours has its top.

    Parameters
    ----------
    logs : mapping
        Width, above 0, to log evidence; the parabola is one of the logarithm of the width.
    gain : float
        Log evidence above the best that the top must promise.

    Returns
    -------
    float or None
        None where no neighbour is known on one side, or less is promised.
    """
    order = sorted(w for w, log in logs.items() if math.isfinite(log))
    at = order.index(max(order, key=logs.__getitem__)) if order else 0
    if not 0 < at < len(order) - 1:
        return None
    near = order[at - 1 : at + 2]
    (a, b, c), (low, top, high) = (math.log(w) for w in near), (logs[w] for w in near)
    first, second = (top - low) / (b - a), (high - top) / (c - b)
    bend = (second - first) / (c - a)
    if bend >= 0.0:
        return None
    vertex = 0.5 * (a + b) - 0.5 * first / bend
    promised = low + first * (vertex - a) + bend * (vertex - a) * (vertex - b)
    return math.exp(vertex) if promised > top + gain else None
