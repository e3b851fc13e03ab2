"""Forces that repeat, located in free run: at which frequency one would lower the cost most."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.judging.criteria import independent_residuals
from jaxsr.diagnosis.locating.driven import driven_lines, floor_of
from jaxsr.diagnosis.locating.responses import Responses, surely
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.motion import Line
from jaxsr.diagnosis.mechanisms.periodic import harmonic, ripple, swing
from jaxsr.diagnosis.mechanisms.site import Site

MOST_OF_IT = 0.3
"""Share of the residual's power that makes a broad peak a line as well."""
PROMINENT = 10.0
"""Gain over the median of the neighbouring frequencies."""
PERIODS = 150
"""Most periods in the longest recording, or along the whole path."""
_ELEMENTS = 4_000_000
"""Numbers held at once."""

Pair = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Constants (values,), times and positions (samples, 1) to two signals (samples, values)."""


@dataclass(frozen=True)
class _Kind:
    """A repeating force along one equation: its constants looked at and its pair of signals."""

    site: int
    make: Callable[[Site, Line, int], Candidate]
    grid: np.ndarray
    pair: Pair


def _in_time(
    values: np.ndarray, time: np.ndarray, position: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    return np.sin(values * time), np.cos(values * time)


def _along_path(
    values: np.ndarray, time: np.ndarray, position: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    return np.sin(values * position), np.cos(values * position)


def _of_stiffness(
    values: np.ndarray, time: np.ndarray, position: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    # -kp*q*cos(w*t + phi) = kp*q*(sin(phi)*sin(w*t) - cos(phi)*cos(w*t))
    return -position * np.cos(values * time), position * np.sin(values * time)


def wave_candidates(
    arena: Arena, entry: Entry, responses: Responses, stop: Callable[[], bool] = lambda: False
) -> list[Candidate]:
    """Propose forces that repeat in time or along the path beside an entry.

    What a pair of forces in quadrature along an equation gains is compared with what
    neighbouring frequencies gain and with the best of as many frequencies of noise. Frequencies
    that an input brings are left out unless they hold most of what is left.
    """
    independent = independent_residuals(entry)
    noise = entry.fit.cost / independent
    candidates = []
    for kind in _kinds(arena, responses):
        if stop():
            break
        gains, _ = _gains(responses, kind, kind.grid)
        # Where more than noise is left, frequencies usually gain more than chi-squared's median.
        usual = np.maximum(floor_of(gains), 1.386 * noise)
        enough = MOST_OF_IT * entry.fit.cost
        least = np.minimum(PROMINENT * usual, enough)
        least = np.maximum(surely(entry.fit.cost, independent, gains.size), least)
        if kind.pair is not _along_path:
            # A controller answers a force: its line is then in the input as well.
            driven = _driven(arena, kind.grid) & (gains < enough)
            gains = np.where(driven, 0.0, gains)
        k = int(np.argmax(np.where(gains > least, gains, 0.0)))
        if not (0 < k < gains.size - 1 and gains[k] > least[k]):
            continue
        near = np.linspace(kind.grid[k - 1], kind.grid[k + 1], 17)
        gains, (a, b) = _gains(responses, kind, near)
        best = int(np.argmax(gains))
        line = Line(float(near[best]), float(np.arctan2(b[best], a[best])), 1.0)
        candidates.append(kind.make(responses.sites[kind.site], line, kind.grid.size))
    return candidates


def _kinds(arena: Arena, responses: Responses) -> Iterator[_Kind]:
    """Yield what may repeat along every equation."""
    step = float(np.median(np.diff(arena.prepared[0].time)))
    span = max(float(p.time[-1] - p.time[0]) for p in arena.prepared)
    frequencies = _grid(4.0 * np.pi / span, np.pi / (8.0 * step), span)
    for j, site in enumerate(responses.sites):
        yield _Kind(j, harmonic, frequencies, _in_time)
        if site.position is None:
            continue
        path, speed = responses.course(site.position), responses.course(site.state)
        if responses.reverses(site):
            yield _Kind(j, swing, frequencies, _of_stiffness)
        length = float(np.ptp(path))
        typical = float(np.sqrt(np.mean(speed**2)))
        if length > 0.0 and typical > 0.0:
            top = np.pi / (4.0 * step * typical)
            yield _Kind(j, ripple, _grid(3.0 * np.pi / length, top, length), _along_path)


def _grid(low: float, high: float, span: float) -> np.ndarray:
    """Constants between limits, four to a resolved line."""
    high = min(high, 2.0 * np.pi * PERIODS / span)
    if high <= low:
        return np.zeros(0)
    return np.linspace(low, high, max(int(2.0 * (high - low) * span / np.pi), 8))


def _driven(arena: Arena, grid: np.ndarray) -> np.ndarray:
    """Where on a grid of frequencies an input has a line, in any recording."""
    mask = np.zeros(grid.size, bool)
    for item in arena.prepared:
        span = float(item.time[-1] - item.time[0])
        mask |= driven_lines(grid, span, item.time, np.nan_to_num(item.inputs.T))
    return mask


def _gains(
    responses: Responses, kind: _Kind, grid: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """How much the cost falls at every constant of a grid, and the pair's two coefficients."""
    if grid.size == 0:
        return np.zeros(1), (np.zeros(1), np.zeros(1))
    states, samples = responses.path.shape[:2]
    most = max(_ELEMENTS // (2 * samples * max(states, len(responses.residual))), 1)
    parts = np.array_split(grid, -(-grid.size // most))
    solved = [_solved(responses, kind, part) for part in parts]
    gains = np.concatenate([g for g, _ in solved])
    a, b = np.concatenate([c for _, c in solved]).T
    return gains, (a, b)


def _solved(responses: Responses, kind: _Kind, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gains (values,) and coefficients (values, 2), over all segments together."""
    site = responses.sites[kind.site]
    at = list(site.model.states).index(site.position) if site.position is not None else 0

    def pairs(s: int) -> np.ndarray:
        count = int(responses.segments.count[s])
        time, path = responses.segments.time[:count, s], responses.path[at, :count, s]
        middle = [0.5 * (x[1:] + x[:-1])[:, None] for x in (time, path)]
        return np.concatenate(kind.pair(values, *middle), axis=1)

    return responses.gains(kind.site, pairs, 2)
