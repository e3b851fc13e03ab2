"""Long recordings thinned for a search: local fits where they are oversampled, else stretches."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.discovery.samples import Roles
from jaxsr.recordings import Recording, noise_level
from jaxsr.recordings.local_polynomials import at_blocks

MOST_ROWS = 12_000
"""Rows of all recordings together that a search begins with."""
_MOST_CELLS = 96_000  # rows times signals
_CELLS_A_SECOND = 4_000  # of the budget: smoothing takes a fifth of it then
_MOST_SIGNALS = 600  # signals over all recordings: each is smoothed by itself,
_SIGNALS_A_SECOND = 2  # of the budget
_STRETCHES = 12  # of a recording of which nothing may be left out in between
LEAST_ROWS = 250  # of a stretch
_WINDOWS = 200  # windows in which it is told what a local fit leaves
_NOISE = 1.21  # mean square over the noise's that a local fit may leave,
_FINEST = 2e-3  # and the rms of the signal's, besides
_CLEAN = 1e-6  # noise over the signal's spread up to which samples are picked and not averaged
_STEADY = 0.8  # share of the windows in which an input may not do more than a parabola


@dataclass(frozen=True, eq=False)
class Thinned:
    """Recordings as a search sees them, and what final estimates are made on.

    Attributes
    ----------
    searched : tuple of Recording
    whole : tuple of Recording
        All of the recordings, in pieces, at the rate of ``searched``; the same where nothing was
        left out.
    factor : int
        Samples that became one row.
    rows, recorded : int
        Rows searched, and samples recorded.
    seconds : float
        Budget that a search of so many rows and signals is for.
    """

    searched: tuple[Recording, ...]
    whole: tuple[Recording, ...]
    factor: int
    rows: int
    recorded: int
    seconds: float

    @property
    def is_partial(self) -> bool:
        """Whether the search leaves a part of the recordings out."""
        return self.searched is not self.whole

    def __str__(self) -> str:
        """Return what was done, in a few words; empty where nothing was."""
        if self.factor == 1 and not self.is_partial:
            return ""
        told = f"searched on {self.rows} rows of {self.recorded} samples"
        return told + (f", each made of {self.factor}" if self.factor > 1 else "")


def thin(
    recordings: Sequence[Recording], part: Roles, seconds: float = math.inf, *, joined: bool = False
) -> Thinned:
    """Thin recordings to as many rows as a search within a budget can use.

    Where signals are sampled far faster than they move, blocks of samples become a row each, by
    local parabolas, so that nothing of them is aliased and their noise is averaged; clean signals
    are picked. What is still too long is cut, and stretches evenly spread are searched.

    Parameters
    ----------
    recordings : sequence of Recording
    part : Roles
    seconds : float
        Budget of the search.
    joined : bool
        Whether recordings must not be cut, for an integral needs all samples before.
    """
    names = _named(recordings, part)
    recorded = sum(len(r) for r in recordings)
    width = max(len(names), 1)
    cells = min(_MOST_CELLS, _CELLS_A_SECOND * seconds)
    most = int(np.clip(cells / width, 4 * LEAST_ROWS, MOST_ROWS))
    factor = 1
    if recorded > most:
        factor = _factor(recordings, names, part.inputs, math.ceil(recorded / most))
    if factor > 1:
        picked = all(_is_clean(r, n) for r in recordings for n in names if n in r.channels)
        recordings = [_reduced(r, names, factor, picked) for r in recordings]
    whole = tuple(recordings)
    signals = max(1, int(min(_MOST_SIGNALS, _SIGNALS_A_SECOND * seconds) / width))
    rows = sum(len(r) for r in whole)
    if joined or (rows <= 1.2 * most and len(whole) <= max(signals, 4)):
        return Thinned(whole, whole, factor, rows, recorded, _seconds(whole, width))
    longest = max(most // min(_STRETCHES, max(signals, 4)), LEAST_ROWS)
    pieces = [piece for r in whole for piece in _cut(r, longest)]
    count = min(max(signals, 4), max(4, most // max(1, rows // len(pieces))), len(pieces))
    places = np.unique(np.linspace(0, len(pieces) - 1, count).round().astype(int))
    searched = tuple(pieces[k] for k in places.tolist())
    whole = tuple(piece for r in whole for piece in _cut(r, most))
    rows = sum(len(r) for r in searched)
    return Thinned(searched, whole, factor, rows, recorded, _seconds(searched, width))


def _seconds(recordings: Sequence[Recording], width: int) -> float:
    """Return the budget that a search of recordings with so many signals each is for."""
    cells = width * sum(len(r) for r in recordings)
    return max(cells / _CELLS_A_SECOND, width * len(recordings) / _SIGNALS_A_SECOND)


def _named(recordings: Sequence[Recording], part: Roles) -> list[str]:
    """Return the columns with a role that the recordings have."""
    roles = dict.fromkeys([*part.states, *part.derivatives.values(), *part.inputs])
    return [name for name in roles if any(name in r.channels for r in recordings)]


def _cut(recording: Recording, longest: int) -> list[Recording]:
    """Return a recording in pieces of nearly one length."""
    count = math.ceil(len(recording) / longest)
    if count < 2:
        return [recording]
    edges = np.linspace(0, len(recording), count + 1).astype(int).tolist()
    return [recording.select(slice(a, b)) for a, b in itertools.pairwise(edges)]


def _factor(
    recordings: Sequence[Recording], names: Sequence[str], inputs: Sequence[str], wanted: int
) -> int:
    """Return how many samples may become one row, at most as many as wanted."""
    while wanted > 1:
        long = [r for r in recordings if len(r) >= 8 * wanted] or list(recordings)
        if all(
            _is_smooth(r, n, 2 * wanted, n in inputs)
            for r in long[:: max(1, len(long) // 8)]
            for n in names
            if n in r.channels
        ):
            return wanted
        wanted //= 2
    return 1


def _is_smooth(recording: Recording, name: str, width: int, driving: bool) -> bool:
    """Tell whether windows of so many samples hold no more than a parabola and noise."""
    values = recording.channels[name]
    count = len(values) // width
    if count < 4:
        return False
    known = np.isfinite(values)
    if np.count_nonzero(known) < 4 or not np.ptp(values[known]) > 0.0:
        return True
    chosen = np.unique(np.linspace(0, count - 1, min(count, _WINDOWS)).astype(int))
    rows = chosen[:, None] * width + np.arange(width)
    t, y = recording.time[rows], values[rows]
    fit, present = _polynomials(t, y, 2)
    s = _places(t)
    shape = fit[:, :1] + fit[:, 1:2] * s + fit[:, 2:] * s**2
    error = np.where(np.isfinite(y), y - shape, 0.0) ** 2
    left = np.sum(error, axis=1) / np.maximum(present - 3, 1)
    left = left[present > 3]
    if not len(left):
        return False
    span = slice(0, min(len(values), 100_000))
    noise = noise_level(recording.time[span], values[span])
    allowed = _NOISE * noise**2 + (_FINEST * float(np.nanstd(values))) ** 2
    told = np.quantile(left, _STEADY) if driving else np.mean(left)
    return bool(told <= allowed)


def _is_clean(recording: Recording, name: str) -> bool:
    values = recording.channels[name][:100_000]
    spread = float(np.nanstd(values)) if np.any(np.isfinite(values)) else 0.0
    return noise_level(recording.time[:100_000], values) <= _CLEAN * spread


def _reduced(recording: Recording, names: Sequence[str], factor: int, picked: bool) -> Recording:
    """Return a recording with one row for each block of samples; what is left over is dropped."""
    count = len(recording) // factor
    if count < 4:
        return recording
    rows = np.arange(count * factor).reshape(count, factor)
    own = [name for name in names if name in recording.channels]
    if picked:
        middle = rows[:, factor // 2]
        channels = {n: recording.channels[n][middle] for n in own}
        return replace(recording, time=recording.time[middle], channels=channels)
    fitted = {n: at_blocks(recording.time, recording.channels[n], factor) for n in own}
    time = next(iter(fitted.values()))[0]
    return replace(recording, time=time, channels={n: value for n, (_, value) in fitted.items()})


def _places(t: np.ndarray) -> np.ndarray:
    """Return times from -1 to 1, nearly, about each block's mean."""
    span = np.maximum(t[:, -1:] - t[:, :1], np.finfo(float).tiny)
    return 2.0 * (t - np.mean(t, axis=1, keepdims=True)) / span


def _polynomials(t: np.ndarray, y: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the polynomial through the samples of each block, and how many those are.

    The mean is taken off first: a large offset must not cost digits.
    """
    known = np.isfinite(y)
    present = np.count_nonzero(known, axis=1)
    filled = np.where(known, y, 0.0)
    mean = np.sum(filled, axis=1) / np.maximum(present, 1)
    centred = np.where(known, filled - mean[:, None], 0.0)
    s = _places(t)
    powers = np.arange(degree + 1)
    moments = np.stack([np.sum(known * s**k, axis=1) for k in range(2 * degree + 1)], axis=1)
    gram = moments[:, powers[:, None] + powers]
    gram = gram + 1e-9 * np.maximum(present, 1)[:, None, None] * np.eye(degree + 1)
    right = np.stack([np.sum(centred * s**k, axis=1) for k in powers], axis=1)
    fit = np.linalg.solve(gram, right[:, :, None])[:, :, 0]
    fit[:, 0] += mean
    return fit, present
