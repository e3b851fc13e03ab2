"""Angles that a sensor reads within one turn: found, and counted on where that is safe."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.recordings.checks import GAP
from jaxsr.recordings.data_check import DataCheck
from jaxsr.recordings.recording import Recording

PERIODS = {360.0: "360", 2.0 * np.pi: "2 pi"}
_EDGE = 2e-3  # of a period: rounding and offset of a sensor at the ends of its range
_SMALL = 0.25  # of a period: the longest step that is surely none over the end of the range
_AGREES = 0.125  # of a period: a step over the end and its neighbours
_CHANCE = 1.0 / 16.0  # of a period: over a gap, one wrong speed in eight lies as near a whole turn


@dataclass(frozen=True)
class _Turns:
    """A wrapped channel: how it goes on over every interval, and whether that is sure."""

    period: float
    low: float
    turns: np.ndarray  # to add after each sample but the last
    at: int  # first step over the end
    guessed: int  # gaps over which the speeds on both sides do not agree on the turns
    safe: bool


def unwrap(recording: Recording, channels: Collection[str] | None = None) -> Recording:
    """Count angles on that jump from one end of a turn to the other.

    A channel is taken for a wrapped angle when it stays within 0 to 360 (or -180 to 180, 0 to
    2 pi, -pi to pi) and most of its jumps by three quarters of a turn or more, with a turn added
    or taken away, agree with the steps beside them. It is counted on when all of them do and it
    moves by less than a quarter of a turn otherwise; over a gap, the speeds on both its sides
    tell the number of turns. Else it is left as it is. Both are said in the recording's
    `remarks`.

    Parameters
    ----------
    recording : Recording
    channels : collection of str, optional
        Channels to look at; all by default.

    Returns
    -------
    Recording
        The same one where nothing wraps.
    """
    changed = dict(recording.channels)
    remarks = []
    for name, values in recording.channels.items():
        if channels is not None and name not in channels:
            continue
        if not _may_turn(values):
            continue
        known = np.flatnonzero(np.isfinite(values))
        found = _turns(recording.time[known], values[known])
        if found is None:
            continue
        remarks.append(_remark(recording, name, found, float(recording.time[known[found.at + 1]])))
        if found.safe:
            counted = values.copy()
            counted[known[1:]] += found.period * np.cumsum(found.turns)
            changed[name] = counted
    if not remarks:
        return recording
    return replace(recording, channels=changed, remarks=(*recording.remarks, *remarks))


def _remark(recording: Recording, name: str, found: _Turns, time: float) -> DataCheck:
    low, high = found.low, found.low + found.period
    word = f"{name} wraps at {low:.4g} and {high:.4g}, first at {time:.6g} s: "
    if found.safe:
        word += "it is counted on over the turns"
        if found.guessed:
            word += (
                f"; over {found.guessed} gaps the number of turns is a guess from the speed beside "
                "them: give each stretch its own file if it may be wrong"
            )
    else:
        word += "it is left so, as it moves too far between samples to count the turns"
    return DataCheck(recording.name, name, "wrap", word, found.period)


def _may_turn(values: np.ndarray) -> bool:
    """Whether a column spans what a jump over the end of a turn does, and no more than a turn."""
    span = float(np.fmax.reduce(values, initial=-np.inf) - np.fmin.reduce(values, initial=np.inf))
    most = 1.0 + 2.0 * _EDGE
    return any((1.0 - _SMALL) * turn < span <= most * turn or np.isinf(span) for turn in PERIODS)


def _turns(time: np.ndarray, y: np.ndarray) -> _Turns | None:
    if y.size < 8:
        return None
    step, dt = np.diff(y), np.diff(time)
    low, high = float(y.min()), float(y.max())
    for period in PERIODS:
        edge = _EDGE * period
        if not np.any(np.abs(step) > (1.0 - _SMALL) * period):
            continue
        for start in (0.0, -period / 2.0):
            if start - edge <= low and high <= start + period + edge:
                return _counted(step, dt, period, start)
    return None


def _counted(step: np.ndarray, dt: np.ndarray, period: float, low: float) -> _Turns | None:
    gap = dt > GAP * np.median(dt)
    near = np.where(np.abs(step) > (1.0 - _SMALL) * period, -np.sign(step), 0.0)
    jumps = np.flatnonzero((near != 0.0) & ~gap)
    if jumps.size == 0:
        return None
    inner = step + near * period
    # a signal that is switched between two levels a turn apart stands still once it is counted on
    if np.count_nonzero(inner[jumps]) * 2 <= jumps.size:
        return None
    plain = ~gap & (near == 0.0)
    rate = inner / dt
    before, after = _neighbours(rate, plain)
    expected = 0.5 * (before + after)
    agree = np.abs(inner[jumps] - expected[jumps] * dt[jumps]) < _AGREES * period
    # a sensor that drops to zero moves faster there than anywhere else
    fastest = float(np.max(np.abs(rate[plain]), initial=0.0))
    agree &= np.abs(inner[jumps]) < 2.0 * fastest * dt[jumps] + 0.5 * _EDGE * period
    small = np.abs(step[plain]) < _SMALL * period
    if np.mean(agree) < 0.5 or np.mean(small) < 0.9:
        return None  # jumps, but no turns
    safe = bool(agree.all() and small.all())
    guessed = 0
    for k in np.flatnonzero(gap).tolist():
        sides = ((-1, before[k]), (1, after[k]))
        ahead = np.array([_speed_at(rate, gap, k, side, mean) for side, mean in sides]) * dt[k]
        turns = (ahead.mean() - step[k]) / period
        near[k] = np.round(turns)
        guessed += int(np.ptp(ahead) > _SMALL * period or abs(turns - near[k]) > _CHANCE)
    return _Turns(period, low, near, int(jumps[0]), guessed, safe)


def _speed_at(rate: np.ndarray, gap: np.ndarray, at: int, side: int, mean: float) -> float:
    """Return the speed at one edge of a gap, on the line through the two steps beside it."""
    near, far = at + side, at + 2 * side
    if not 0 <= far < rate.size or gap[near] or gap[far]:
        return mean
    return float(1.5 * rate[near] - 0.5 * rate[far])


def _neighbours(rate: np.ndarray, plain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean rate over up to three plain steps before each step, and after it."""
    sums = np.concatenate([[0.0], np.cumsum(np.where(plain, rate, 0.0))])
    counts = np.concatenate([[0], np.cumsum(plain)])
    index = np.arange(rate.size)
    first, last = np.maximum(index - 4, 0), np.minimum(index + 5, rate.size)
    with np.errstate(invalid="ignore", divide="ignore"):
        before = (sums[index] - sums[first]) / (counts[index] - counts[first])
        after = (sums[last] - sums[index + 1]) / (counts[last] - counts[index + 1])
    before = np.where(np.isnan(before), after, before)
    return np.nan_to_num(before), np.nan_to_num(np.where(np.isnan(after), before, after))
