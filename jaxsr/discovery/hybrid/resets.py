"""Reset maps: states that jump at an impact, where, and to what."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.discovery.samples import Roles
from jaxsr.expressions import number_text
from jaxsr.models.model import Event
from jaxsr.recordings import Recording

_LARGE = 0.1  # of a state's range: smaller steps are no jumps
_OVER = 30.0  # times what neighbouring steps usually differ by
_RARE = 0.05  # share of the samples that may jump
_FEWEST = 3  # jumps that a map is fitted to
_FIT = 4  # samples on either side from which both ends of a jump are extrapolated
_SPREAD = 0.02  # of a state's range within which impacts happen at one place
_MISFIT = 0.05  # of the states after the jumps that the map may leave
_SHORT = 12  # samples of a piece between two impacts that a law is learnt from


@dataclass(frozen=True, slots=True)
class Reset:
    """What becomes of a state where another passes a place.

    Attributes
    ----------
    state : str
        Jumps from v to ``factor*v + offset``.
    factor, offset : float
    place : str
        State that tells where it happens.
    threshold : float
    direction : int
        -1: the place is reached from above; 1: from below.
    jumps : int
        Number of jumps seen.
    """

    state: str
    factor: float
    offset: float
    place: str
    threshold: float
    direction: int
    jumps: int

    @property
    def event(self) -> Event:
        """Return the reset as a model file holds it."""
        size = number_text(abs(self.threshold))
        sign = "-" if self.threshold > 0.0 else "+"
        when = self.place if self.threshold == 0.0 else f"{self.place} {sign} {size}"
        after = f"{number_text(self.factor)}*{self.state}"
        if self.offset:
            side = "-" if self.offset < 0.0 else "+"
            after += f" {side} {number_text(abs(self.offset))}"
        return Event(when, self.direction, {self.state: after})


def jump_places(values: np.ndarray) -> np.ndarray:
    """Return the samples after which a signal jumps (jumps,).

    There the step differs from the mean of its neighbours by a tenth of the signal's range, and
    by thirty times what nine in ten steps do.
    """
    if len(values) < 4 * _FIT or not np.all(np.isfinite(values)):
        return np.zeros(0, dtype=int)
    step = np.diff(values)
    bend = np.abs(step[1:-1] - 0.5 * (step[:-2] + step[2:]))
    usual = float(np.quantile(bend, 0.9 if len(bend) > 60 else 0.75))
    large = bend > max(_LARGE * float(np.ptp(values)), _OVER * usual)
    places = np.flatnonzero(large) + 1
    # a jump bends the steps beside it by half of itself
    places = np.array(
        [k for k in places if np.abs(step[k]) >= np.max(np.abs(step[max(k - 1, 0) : k + 2]))],
        dtype=int,
    )
    return places if len(places) <= _RARE * len(values) else np.zeros(0, dtype=int)


def find_resets(recordings: Sequence[Recording], part: Roles) -> list[Reset]:
    """Return the reset maps of states that jump by one rule at one place.

    Nothing is returned where jumps follow no rule: they are then left to the laws.
    """
    out = []
    for state in part.states:
        if any(state not in r.channels for r in recordings):
            continue
        others = [s for s in part.states if s != state and all(s in r.channels for r in recordings)]
        ends = [e for r in recordings for e in _ends(r, state, others)]
        if len(ends) < _FEWEST:
            continue
        reset = _map(state, others, np.array(ends), recordings)
        if reset is not None:
            out.append(reset)
    return out


def _ends(recording: Recording, state: str, others: Sequence[str]) -> list[list[float]]:
    """Return, for each jump: state before and after, direction, and the others at that instant."""
    t, v = recording.time, recording.channel(state)
    out = []
    for k in jump_places(v).tolist():
        before, after = slice(k - _FIT + 1, k + 1), slice(k + 1, k + 1 + _FIT)
        if k - _FIT + 1 < 0 or k + 1 + _FIT > len(t):
            continue
        row: list[float] = []
        when = float(0.5 * (t[k] + t[k + 1]))
        meets = [_meet(t, recording.channel(s), before, after, k) for s in others]
        sure = [m for m in meets if m is not None]
        if sure:
            when = float(np.median(sure))
        row = [_at(t[before], v[before], when), _at(t[after], v[after], when)]
        row += [_at(t[before], recording.channel(s)[before], when) for s in others]
        row += [
            float(np.sign(recording.channel(s)[k] - recording.channel(s)[k - 1])) for s in others
        ]
        out.append(row)
    return out


def _at(t: np.ndarray, values: np.ndarray, when: float) -> float:
    """Extrapolate by a parabola."""
    middle = float(np.mean(t))
    return float(np.polyval(np.polyfit(t - middle, values, 2), when - middle))


def _meet(t: np.ndarray, values: np.ndarray, before: slice, after: slice, k: int) -> float | None:
    """Return when the parabolas before and after meet within the step after sample k."""
    middle = 0.5 * (t[k] + t[k + 1])
    apart = np.polyfit(t[before] - middle, values[before], 2) - np.polyfit(
        t[after] - middle, values[after], 2
    )
    roots = np.roots(apart)
    real = roots[np.abs(roots.imag) < 1e-9].real + middle
    good = real[(real >= t[k]) & (real <= t[k + 1])]
    return float(good[0]) if len(good) == 1 else None


def _map(
    state: str, others: Sequence[str], ends: np.ndarray, recordings: Sequence[Recording]
) -> Reset | None:
    """Fit the map and the place, if there is one."""
    v, after = ends[:, 0], ends[:, 1]
    count = len(others)
    best: tuple[float, str, float, int] | None = None
    for j, name in enumerate(others):
        at, ways = ends[:, 2 + j], ends[:, 2 + count + j]
        size = max(float(np.ptp(r.channel(name))) for r in recordings)
        spread = float(np.std(at)) / size if size > 0.0 else np.inf
        if spread < _SPREAD and np.all(ways == ways[0]) and (best is None or spread < best[0]):
            threshold = float(np.median(at))
            near_zero = abs(threshold) <= 3.0 * float(np.std(at)) / np.sqrt(len(at)) + 1e-6 * size
            best = spread, name, 0.0 if near_zero else threshold, int(ways[0])
    if best is None or not v @ v > 0.0:
        return None
    scale = float(np.sqrt(np.mean(after**2))) or 1.0
    factor = float(v @ after / (v @ v))
    left = after - factor * v
    offset = 0.0
    if np.sqrt(np.mean(left**2)) > _MISFIT * scale and np.ptp(v) > 0.0:
        factor, offset = (float(c) for c in np.polyfit(v, after, 1))
        left = after - factor * v - offset
    if np.sqrt(np.mean(left**2)) > _MISFIT * scale:
        return None
    return Reset(state, factor, offset, best[1], best[2], best[3], len(v))


def cut_at(recordings: Sequence[Recording], resets: Sequence[Reset]) -> list[Recording]:
    """Return the recordings in pieces between jumps; those too short for a law are left out."""
    out = []
    for recording in recordings:
        places = [jump_places(recording.channel(r.state)) for r in resets]
        edges = np.unique(np.concatenate([[0], *(p + 1 for p in places), [len(recording.time)]]))
        pieces = [slice(int(a), int(b)) for a, b in itertools.pairwise(edges) if b - a >= _SHORT]
        if len(edges) == 2:
            out.append(recording)
            continue
        for rows in pieces:
            channels = {n: v[rows] for n, v in recording.channels.items()}
            out.append(replace(recording, time=recording.time[rows], channels=channels))
    return out
