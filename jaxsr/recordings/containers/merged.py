"""Channels with clocks of their own, laid on one time; a sample is missing where none was taken."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxsr._result import InputError
from jaxsr.recordings.containers.opened import Channel, opened
from jaxsr.recordings.table import Table

TIME = "time"
SAME = 1e-3
"""Share of the least interval by which times differ that are one time, written twice."""
MOST_ROWS = 5_000_000
"""Times of all clocks together."""


def container_table(kind: str, path: Path) -> Table:
    """Return what a container file holds as a table.

    Channels that share a clock, or have none, are columns as they are. Of several clocks the rows
    are all of their times: every channel is missing where it was not sampled, as a sensor with a
    rate of its own is.

    Raises
    ------
    InputError
        The file cannot be read, holds no channel, or too many different times.
    """
    channels = opened(kind, path)
    if not channels:
        remedy = "Name a file with vectors of numbers"
        raise InputError("holds no channel of numbers", path.name, remedy)
    units = {c.name: c.unit for c in channels if c.unit}
    clocks = {c.clock: c.time for c in channels if c.clock is not None and c.time is not None}
    if not clocks:
        return Table({c.name: c.values for c in channels}, units=units)
    sizes = {name: time.size for name, time in clocks.items()}
    same = SAME * min(_interval(time) for time in clocks.values())
    every = np.sort(np.concatenate([_usable(time) for time in clocks.values()]))
    whole = every[np.concatenate([[True], np.diff(every) > same])[: every.size]]
    if whole.size > MOST_ROWS:
        raise InputError(f"holds {whole.size} different times", path.name, "Save a shorter stretch")
    name = _free(TIME, channels)
    numbers, units = {name: whole}, {**units, name: "s"}
    for channel in channels:
        numbers[channel.name] = _laid(channel, whole, same)
    rates = sorted({size / max(np.ptp(whole), 1e-300) for size in sizes.values()})
    said: tuple[str, ...] = ()
    if len(clocks) > 1:
        spread = f"{rates[0]:.3g} to {rates[-1]:.3g}" if len(rates) > 1 else f"{rates[0]:.3g}"
        said = (f"{len(clocks)} clocks of {spread} samples per second laid on one time",)
    return Table(numbers, units=units, said=said)


def _interval(time: np.ndarray) -> float:
    """Return the least interval of a clock, 0 where there is none."""
    steps = np.diff(np.sort(_usable(time)))
    return float(np.min(steps[steps > 0.0], initial=np.inf)) if (steps > 0.0).any() else 0.0


def _usable(time: np.ndarray) -> np.ndarray:
    return time[np.isfinite(time)]


def _free(name: str, channels: Sequence[Channel]) -> str:
    """Return a name for the time that no channel has."""
    taken = {channel.name for channel in channels}
    while name in taken:
        name = f"{name}_s"
    return name


def _laid(channel: Channel, whole: np.ndarray, same: float) -> np.ndarray:
    """Return a channel's values on all times; the last one where a time repeats."""
    values = np.full(whole.size, np.nan)
    if channel.time is None:
        known = channel.values[: whole.size] if channel.values.size == whole.size else ()
        if len(known):
            values[:] = known
        return values
    count = min(channel.time.size, channel.values.size)
    finite = np.isfinite(channel.time[:count])
    # the first time of those that are the same but for rounding
    place = np.searchsorted(whole, channel.time[:count][finite] - same)
    values[place] = channel.values[:count][finite]
    return values
