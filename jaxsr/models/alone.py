"""One segment simulated in numbers: arrays of one element cost several times as much."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxsr._deadline import ask
from jaxsr.models.field import Field, Point
from jaxsr.models.segments import Segments

Array = Any


def alone(
    field: Field,
    segments: Segments,
    inputs: Array,
    path: Array,
    stop: Callable[[], bool],
    first: int,
) -> Array | None:
    """Return the simulation from a path's start by RK4, one sample after the other.

    Parameters
    ----------
    inputs : ndarray, shape (3, inputs, samples, substeps, 1)
        At the start, the middle and the end of every substep.
    path : ndarray, shape (states, samples, 1)
        From sample `first` of the segment on; written over.

    Returns
    -------
    ndarray or None
        None if it diverges, or `stop` says so.
    """
    times, lengths = segments.time[:, 0], segments.length[:, :, 0]
    for k in range(path.shape[1] - 1):
        ask()
        x, t = list(path[:, k, 0]), times[first + k]
        for number, h in enumerate(lengths[first + k]):
            begin, middle, end = (list(u) for u in inputs[:, :, first + k, number, 0])
            k1 = field.rates(Point(t, x, begin))
            k2 = field.rates(Point(t + h / 2, _moved(x, h / 2, k1), middle))
            k3 = field.rates(Point(t + h / 2, _moved(x, h / 2, k2), middle))
            k4 = field.rates(Point(t + h, _moved(x, h, k3), end))
            slopes = zip(x, k1, k2, k3, k4, strict=True)
            x = [a + h / 6 * (p + 2 * (q + r) + s) for a, p, q, r, s in slopes]
            t = t + h
        path[:, k + 1, 0] = x
        if stop() or not np.isfinite(path[:, k + 1]).all():
            return None
    return path


def _moved(x: list[Array], by: Array, rates: list[Array]) -> list[Array]:
    return [a + by * b for a, b in zip(x, rates, strict=True)]
