"""Long and many recordings, thinned: what a search works on, while all of it is kept.

A search that compares hundreds of sets needs every regime of the motion, not every sample of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from jaxsr._clock import now
from jaxsr.diagnosis.setup import check_data, open_recording
from jaxsr.models import Model
from jaxsr.models.segments import Prepared, unbroken
from jaxsr.recordings import Recording, check_time_units
from jaxsr.recordings.decimation import decimated, is_uniform
from jaxsr.views.half_width import choose_half_widths, sampled_alike

MOST, PER_SECOND = 60_000, 1000
"""Samples times states that a search works on: in all, and for each second of the time budget."""
WEIGHED = 12_000
"""Samples times states that an evidence is asked about: of much less data it decides as well."""
MOST_RECORDINGS = 40
"""Recordings that a search works on; thinned, there are at most `STRETCHES[1]` pieces."""
STRETCH, LEAST = 1500, 4000
"""Usual length of a piece in samples, and the least number of samples in all."""
STRETCHES = (6, 24)
"""Fewest and most pieces."""
PER_WIDTH = 40
"""Samples in the half-width of a test function beyond which there are more than the motion asks."""
COMPLETING = 0.2
"""Half the share of the time budget that is kept for estimates and runs over everything."""
BETWEEN = 0.01
"""Error of straight lines between fewer samples, relative to a reading's deviation, up to which
they tell the course of a state that no force accelerates."""
LOOKING, AGAIN = 0.1, 3.0
"""Share of a search's time in which all samples may be looked at; how much longer than reading them
that takes."""
PREPARING = 0.15
"""Share of a search's time in which the states along its pieces are estimated."""
GOLDEN = 0.5 * (5.0**0.5 - 1.0)
SEEN = 20_000
"""Samples that tell how fast the motion is."""


@dataclass(frozen=True, eq=False)
class Whole:
    """All recordings of a diagnosis whose search is on a part of them.

    Attributes
    ----------
    model : Model
    recordings : tuple of Recording
    factor : int
        Samples that became one in the search.
    searched : int
        Samples that the search works on.
    """

    model: Model
    recordings: tuple[Recording, ...]
    factor: int
    searched: int

    @property
    def samples(self) -> int:
        """Number of all samples."""
        return sum(len(r) for r in self.recordings)


def prepare_search(
    model: Model,
    items: Sequence[str | Path | Recording],
    checked: bool = True,
    seconds: float = np.inf,
) -> tuple[tuple[Prepared, ...], Whole | None]:
    """Read recordings and prepare what a search of so many seconds works on.

    Raises
    ------
    InputError
        A recording cannot be read or, `checked`, no choice can rest on what it holds.

    Returns
    -------
    prepared : tuple of Prepared
        The recordings, or pieces of them under the same names and with the same times.
    whole : Whole or None
        Everything, where that is more than a search should work on.
    """
    began = now()
    recordings = tuple(open_recording(model, item) for item in items)
    read = now() - began
    check_time_units(recordings)
    if checked:
        check_data(model, recordings)
    few, most = len(recordings) <= MOST_RECORDINGS, int(min(MOST, PER_SECOND * seconds))
    samples = sum(len(r) for r in recordings)
    if few and (samples * len(model.states) <= most or samples <= LEAST):
        return _unbroken(model, recordings)
    bearable = LOOKING * seconds / max(AGAIN * read, 1e-9)
    return thinned(model, recordings, most, min(bearable, 1.0), PREPARING * seconds)


def _unbroken(
    model: Model, recordings: tuple[Recording, ...]
) -> tuple[tuple[Prepared, ...], Whole | None]:
    """Prepare recordings, those with breaks in their rows stretch by stretch."""
    parts = [(r, a, b) for r in recordings for a, b in unbroken(r.time)]
    if all(b - a == len(r) for r, a, b in parts):
        return tuple(Prepared.build(model, r) for r in recordings), None
    pieces = [(r.select(slice(a, b)), a == 0) for r, a, b in parts]
    prepared = tuple(Prepared.build(model, part, begins=begins) for part, begins in pieces)
    return prepared, Whole(model, recordings, 1, sum(p.time.size for p in prepared))


def time_for(whole: Whole | None, seconds: float) -> float:
    """Return the share of a budget in s, half of what estimates and runs over everything need."""
    return 0.0 if whole is None else COMPLETING * seconds


def thinned(
    model: Model,
    recordings: Sequence[Recording],
    most: int = MOST,
    share: float = 1.0,
    room: float = np.inf,
) -> tuple[tuple[Prepared, ...], Whole | None]:
    """Return pieces of recordings that hold what their motion shows, and all of them.

    Where samples follow each other far faster than the motion, fewer of them are taken
    (`decimated`). Pieces of about `STRETCH` consecutive samples are then chosen, half of them
    evenly over all recordings, the others where inputs and readings differ most from those of
    the pieces chosen before, so that rare regimes are seen.

    Where there is no time to look at every sample, a `share` of each recording, in stretches that
    are spread over it evenly, stands for it; pieces whose states there is no `room`, in s, to
    estimate are left out.
    """
    parts = _stretches(recordings, share)
    factor = _factor(model, [part for part, _ in parts], most)
    holds = {model.column(u): model.input_hold for u in model.inputs}
    coarse = [decimated(part, factor, holds) for part, _ in parts]
    total = max(most // len(model.states), LEAST)
    number = int(np.clip(total // STRETCH, *STRETCHES))
    rows = _tiles(coarse, total // number)
    chosen = spread(_features(model, coarse, rows), number)
    prepared, begun = {}, now()
    for k in np.argsort((np.arange(len(chosen)) * GOLDEN) % 1.0):
        if prepared and (now() - begun) * (1.0 + 1.0 / len(prepared)) > room:
            break
        r, first, last = rows[chosen[k]]
        begins = first == 0 and parts[r][1]
        prepared[k] = Prepared.build(model, coarse[r].select(slice(first, last)), begins=begins)
    prepared = [prepared[k] for k in sorted(prepared)]
    searched = sum(p.time.size for p in prepared)
    return tuple(prepared), Whole(model, tuple(recordings), factor, searched)


def for_evidence(model: Model, prepared: Sequence[Prepared]) -> tuple[Prepared, ...]:
    """Return recordings, or pieces of long ones."""
    if sum(p.time.size for p in prepared) * len(model.states) <= WEIGHED:
        return tuple(prepared)
    return thinned(model, [p.recording for p in prepared], WEIGHED)[0]


def _stretches(recordings: Sequence[Recording], share: float) -> list[tuple[Recording, bool]]:
    """Return recordings, or a share of each, and whether that is where a recording begins."""
    if share >= 1.0:
        return [(r, True) for r in recordings]
    found = []
    for r in recordings:
        count = int(np.clip(share * len(r) // STRETCH, 1, STRETCHES[1]))
        size = max(int(share * len(r) / count), min(STRETCH, len(r)))
        starts = np.linspace(0, len(r) - size, count).astype(int)
        found += [(r.select(slice(a, a + size)), a == 0) for a in starts.tolist()]
    return found


def _factor(model: Model, recordings: Sequence[Recording], most: int) -> int:
    """How many samples may become one: as far as too many ask for it, and the motion allows."""
    used = [model.column(u) for u in model.inputs]
    if model.input_hold == "bandlimited" or not all(is_uniform(r, used) for r in recordings):
        return 1
    step = max(r.sample_time for r in recordings)
    if step > 1.01 * min(r.sample_time for r in recordings):
        return 1
    asked = sum(len(r) for r in recordings) * len(model.states) / most
    longest = max(recordings, key=len)
    start = max(len(longest) // 2 - SEEN // 2, 0)
    part = longest.select(slice(start, start + SEEN))
    columns = [c for y in model.outputs if (c := part.channels.get(model.column(y))) is not None]
    if not columns:
        return 1
    widths: list[float] = []
    for present, signals in sampled_alike(np.stack(columns, axis=1)):
        moving = np.ptp(signals, axis=0) > 0.0 if present.any() else np.zeros(0, bool)
        if present.sum() > PER_WIDTH and moving.any():
            widths += choose_half_widths(part.time[present], signals[:, moving])
    allowed = min(widths, default=0.0) / step / PER_WIDTH
    if asked > 1.0 and all(model.kinematic_parent(s) is None for s in model.dynamic_states):
        # A level or a temperature changes by sums: what is small and fast there is a sensor's.
        between = _between(model, recordings)
        if between > min(asked, allowed):
            allowed = asked = between
    shortest = min(len(r) for r in recordings) / STRETCH
    return max(int(min(asked, allowed, max(shortest, 1.0))), 1)


def _between(model: Model, recordings: Sequence[Recording]) -> float:
    """Return how many samples straight lines may leap without losing what the readings do."""
    factor = 1
    while True:
        for recording in recordings:
            for output in model.outputs:
                y = recording.channels.get(model.column(output))
                if y is None or not np.isfinite(y).all() or np.ptp(y) == 0.0:
                    continue
                kept = np.arange(0, y.size, 2 * factor)
                drawn = np.interp(np.arange(kept[-1] + 1), kept, y[kept])
                error = np.sqrt(np.mean((y[: kept[-1] + 1] - drawn) ** 2))
                if error > BETWEEN * np.std(y) or kept.size < STRETCHES[1]:
                    return float(factor)
        factor *= 2
        if 2 * factor > max(len(r) for r in recordings):
            return float(factor)


def _tiles(recordings: Sequence[Recording], length: int) -> list[tuple[int, int, int]]:
    """Cut recordings into pieces of about equal length: (recording, first, last + 1) each."""
    rows = []
    for r, recording in enumerate(recordings):
        count = max(round(len(recording) / length), 1)
        edges = np.linspace(0, len(recording), count + 1).astype(int)
        rows += [(r, int(a), int(b)) for a, b in pairwise(edges)]
    return rows


def _features(
    model: Model, recordings: Sequence[Recording], rows: Sequence[tuple[int, int, int]]
) -> np.ndarray:
    """What inputs and readings do in every piece, each feature in its spread over the pieces."""
    names = [model.column(name) for name in (*model.inputs, *model.outputs)]
    table = np.zeros((len(rows), 5 * len(names)))
    for i, (r, first, last) in enumerate(rows):
        found = []
        for name in names:
            values = recordings[r].channels.get(name, np.zeros(0))[first:last]
            values = values[np.isfinite(values)]
            if values.size < 2:
                found += [np.nan] * 5
                continue
            moving = np.abs(np.diff(values)).mean()
            found += [values.mean(), values.std(), values.min(), values.max(), moving]
        table[i] = found
    centre = np.nanmean(table, axis=0) if len(table) else 0.0
    table = np.where(np.isfinite(table), table, centre) - centre
    size = np.nanstd(table, axis=0)
    return np.nan_to_num(table / np.where(size > 0, size, 1.0))


def spread(features: np.ndarray, number: int) -> list[int]:
    """Choose rows: half of them evenly, then the farthest from all that are chosen.

    References
    ----------
    Gonzalez, Theoretical Computer Science 38 (1985): farthest-first traversal.
    """
    count = len(features)
    if count <= number:
        return list(range(count))
    chosen = list(dict.fromkeys(np.linspace(0, count - 1, -(-number // 2)).round().astype(int)))
    distance = np.full(count, np.inf)
    for i in chosen:
        distance = np.minimum(distance, np.sum((features - features[i]) ** 2, axis=1))
    while len(chosen) < number:
        far = int(np.argmax(distance))
        chosen.append(far)
        distance = np.minimum(distance, np.sum((features - features[far]) ** 2, axis=1))
        distance[chosen] = -1.0
    return sorted(int(i) for i in chosen)


__all__ = ["Whole", "prepare_search", "spread", "thinned", "time_for"]
