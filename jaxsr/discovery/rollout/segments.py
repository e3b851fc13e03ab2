"""Stretches of recordings, cut to one length, that are simulated side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

Table = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Segments:
    """Stretches of one length; a short one is filled up with missing samples.

    Attributes
    ----------
    time : ndarray, (samples, segments)
    values : dict of str to ndarray, (samples, segments)
        Every state, smoothed, and every input: what drives the states that are not simulated,
        and where those that are start.
    slopes : dict of str to ndarray, (samples, segments)
        Time derivatives of those that are smooth, for cubics between samples.
    measured : dict of str to ndarray, (samples, segments)
        Recorded samples of the states that have a sensor, NaN where missing.
    noise : dict of str to ndarray, (samples, segments)
        Their standard deviation.
    """

    time: np.ndarray
    values: Table
    slopes: Table
    measured: Table
    noise: Table

    @property
    def count(self) -> int:
        """Return the number of segments."""
        return self.time.shape[1]

    def size(self, name: str) -> float:
        """Return the largest size of a signal that is recorded; 1 where it is nowhere but zero."""
        known = np.abs(self.values[name]) if name in self.values else np.zeros(1)
        return float(np.max(known, where=np.isfinite(known), initial=0.0)) or 1.0

    def take(self, which: np.ndarray) -> Segments:
        """Return some of the segments."""
        tables = (
            {k: v[:, which] for k, v in table.items()}
            for table in (self.values, self.slopes, self.measured, self.noise)
        )
        return Segments(self.time[:, which], *tables)


def cut(recordings: Sequence[Mapping[str, Table]], length: int, most: int) -> Segments:
    """Cut recordings into consecutive stretches, neighbours sharing their end sample.

    Parameters
    ----------
    recordings : sequence of {"time", "values", "slopes", "measured", "noise"}
        Tables of arrays (samples,); "time" holds one, "t"; "slopes" may be absent.
    length : int
        Samples in a segment.
    most : int
        Segments; where there are more, evenly spread ones are taken.
    """
    places = []
    for number, recording in enumerate(recordings):
        size = len(recording["time"]["t"])
        starts = range(0, max(size - 1, 1), length - 1)
        places += [(number, start) for start in starts if size - start > 2]
    if len(places) > most:
        chosen = np.linspace(0, len(places) - 1, most).round().astype(int)
        places = [places[k] for k in chosen]

    def table(key: str, hold: bool) -> Table:
        names = set.intersection(*(set(r.get(key, ())) for r in recordings))
        return {
            name: np.column_stack(
                [_stretch(recordings[n][key][name], start, length, hold) for n, start in places]
            )
            for name in sorted(names)
        }

    time = np.column_stack(
        [_instants(recordings[n]["time"]["t"], start, length) for n, start in places]
    )
    values, slopes = table("values", True), table("slopes", True)
    return Segments(time, values, slopes, table("measured", False), table("noise", True))


def _stretch(values: np.ndarray, start: int, length: int, hold: bool) -> np.ndarray:
    part = values[start : start + length]
    fill = part[-1] if hold else np.nan
    return np.concatenate([part, np.full(length - len(part), fill)])


def _instants(t: np.ndarray, start: int, length: int) -> np.ndarray:
    part = t[start : start + length]
    step = part[-1] - part[-2]
    return np.concatenate([part, part[-1] + step * np.arange(1, length - len(part) + 1)])
