"""What a table holds: time in seconds, channels, and what is to be said of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from jaxsr._result import InputError
from jaxsr.recordings.clock import TimeColumn, time_column
from jaxsr.recordings.data_check import DataCheck
from jaxsr.recordings.table import Table, quoted


@dataclass(frozen=True, eq=False)
class Contents:
    """A table as the arguments of a `Recording`, which checks them.

    Attributes
    ----------
    name : str
    time : ndarray
        In seconds.
    channels : mapping of str to ndarray
    set_aside : mapping of str to str
        Columns without numbers, each with the reason.
    remarks : tuple of DataCheck
    time_stated : bool
        Whether the table says in which unit its time is.
    """

    name: str
    time: np.ndarray
    channels: Mapping[str, np.ndarray]
    set_aside: Mapping[str, str]
    remarks: tuple[DataCheck, ...]
    time_stated: bool


def contents_of(
    table: Table, name: str, time: str | None = None, sample_time: float | None = None
) -> Contents:
    """Return what a table holds, see `read_recording`.

    Raises
    ------
    InputError
        There is no column of time, or it can be read in two ways.
    """
    if sample_time is not None and not (np.isfinite(sample_time) and sample_time > 0):
        raise InputError(f"sample_time is {sample_time}", name, "Give seconds above 0")
    found = time_column(table, time, name, required=sample_time is None)
    if found is None:
        assert sample_time is not None  # time_column raised otherwise
        length = max((values.size for values in table.numbers.values()), default=0)
        found = TimeColumn(np.arange(length) * sample_time, (), stated=True)
    channels, set_aside = _channels(table, found)
    remarks = tuple(_remarks(table, found, name))
    return Contents(name, found.seconds, channels, set_aside, remarks, found.stated)


def _channels(table: Table, time: TimeColumn) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return the columns as long as time, and why the others are none."""
    channels: dict[str, np.ndarray] = {}
    set_aside = dict(table.odd)
    for name, values in table.numbers.items():
        if name in time.columns or values.size != time.seconds.size:
            continue
        if values.dtype.kind == "M":
            set_aside[name] = "holds dates, not numbers"
        elif values.dtype.kind == "m":
            channels[name] = values.astype(np.int64) / 1e9
        else:
            channels[name] = values
    for name, text in table.texts.items():
        if name in time.columns:
            continue
        known = np.flatnonzero((text.fillna("") != "").to_numpy(dtype=bool))
        if known.size:
            cell = quoted(text.iloc[known[0]], 40)
            set_aside[name] = f"is not numeric: row {known[0] + 1} holds '{cell}'"
        else:
            channels[name] = np.full(time.seconds.size, np.nan)
    return channels, set_aside


def _remarks(table: Table, time: TimeColumn, file: str) -> Iterator[DataCheck]:
    if table.said:
        yield DataCheck(file, "file", "reading", f"the file is read with {'; '.join(table.said)}")
    if time.said:
        yield DataCheck(file, "time", "reading", time.said)
