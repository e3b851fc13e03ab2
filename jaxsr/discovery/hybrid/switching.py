"""The mode sequence: which mode holds when, and for how long."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from jaxsr.discovery.hybrid.guards import Region, inside

Row = tuple[float, float, int]


def labels(regions: Sequence[Sequence[Region]], variables: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the number of the mode of every sample (samples,); the last one is the rest."""
    out = np.full(len(next(iter(variables.values()))), len(regions) - 1)
    for number in reversed(range(len(regions) - 1)):
        for region in regions[number]:
            out[inside(region, variables)] = number
    return out


def sequence(
    time: np.ndarray, regions: Sequence[Sequence[Region]], variables: Mapping[str, np.ndarray]
) -> list[Row]:
    """Return rows (from, to, mode) of one recording; switches lie between two samples.

    A switch is located where straight lines between the samples of all variables cross the guard.

    Parameters
    ----------
    time : ndarray, (samples,)
        Seconds.
    regions : sequence of sequence of Region
        Of every mode.
    variables : mapping of str to ndarray, (samples,)
    """
    mode = labels(regions, variables)
    changes = np.flatnonzero(mode[1:] != mode[:-1])
    edges = [float(time[0])]
    for k in changes.tolist():
        share = _crossing(regions, variables, k, int(mode[k]))
        edges.append(float(time[k] + share * (time[k + 1] - time[k])))
    edges.append(float(time[-1]))
    starts = np.concatenate([[0], changes + 1])
    return [
        (a, b, int(mode[k])) for a, b, k in zip(edges[:-1], edges[1:], starts.tolist(), strict=True)
    ]


def _crossing(
    regions: Sequence[Sequence[Region]], variables: Mapping[str, np.ndarray], k: int, mode: int
) -> float:
    """Return the share of an interval after which a mode is left, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        point = {n: v[k : k + 1] * (1.0 - middle) + v[k + 1 : k + 2] * middle
                 for n, v in variables.items()}  # fmt: skip
        if labels(regions, point)[0] == mode:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def joined(first: Sequence[Row], second: Sequence[Row]) -> list[Row]:
    """Return the rows of two pieces of a recording, between which a state was reset.

    A visit goes on where both pieces meet in one mode; else the switch lies halfway.
    """
    (start, end, mode), (begin, stop, other) = first[-1], second[0]
    if mode == other:
        return [*first[:-1], (start, stop, mode), *second[1:]]
    middle = 0.5 * (end + begin)
    return [*first[:-1], (start, middle, mode), (middle, stop, other), *second[1:]]


def dwell_times(rows: Sequence[Row], mode: int) -> np.ndarray:
    """Return how long each visit of a mode lasted, in seconds; cut visits at the ends left out."""
    return np.array([b - a for a, b, m in rows[1:-1] if m == mode])


def next_to_switch(mode: np.ndarray, group: np.ndarray, reach: int) -> np.ndarray:
    """Tell which samples have another mode within ``reach`` samples of their recording."""
    near = np.zeros(len(mode), dtype=bool)
    for number in np.unique(group):
        rows = np.flatnonzero(group == number)
        for k in np.flatnonzero(mode[rows][1:] != mode[rows][:-1]).tolist():
            near[rows[max(k - reach + 1, 0) : k + 1 + reach]] = True
    return near
