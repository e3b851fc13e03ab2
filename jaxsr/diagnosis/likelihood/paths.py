"""The path of a hypothesis, where others look for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.models.segments import Prepared, Segments


def path_over(
    segments: Segments,
    prepared: Sequence[Prepared],
    known: Sequence[Prepared],
    rows: Sequence[tuple[int, int, int]],
    path: np.ndarray,
) -> np.ndarray:
    """Return a path over other segments; where it is not known, the sensors' own.

    Parameters
    ----------
    segments, prepared
        Where the path is asked for.
    known : sequence of Prepared
        The same recordings, thinned perhaps, along which it was found.
    rows : sequence of (int, int, int)
        Recording, first and last sample (beyond it) of each piece of the path.
    path : ndarray, shape (states, samples, pieces)

    Returns
    -------
    ndarray, shape (all states of the segments, samples, segments)
    """
    result = segments.course.copy()
    for s, (r, first, count) in enumerate(
        zip(segments.recording, segments.start, segments.count, strict=True)
    ):
        pieces = [(k, a, b) for k, (own, a, b) in enumerate(rows) if own == r]
        time = np.concatenate([known[r].time[a:b] for _, a, b in pieces])
        here = prepared[r].time[first : first + count]
        inside = (here >= time[0]) & (here <= time[-1])
        for i in range(len(path)):
            values = np.concatenate([path[i, : b - a, k] for k, a, b in pieces])
            result[i, : here.size, s][inside] = np.interp(here[inside], time, values)
        result[: len(path), here.size :, s] = result[: len(path), here.size - 1, s][:, None]
    return result
