"""Which column of a table is time, and how it becomes seconds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.recordings.dates import DAY, Clock, read_clock
from jaxsr.recordings.table import Table, listed, quoted
from jaxsr.recordings.time_units import WORDS, is_time_name, time_unit, unit_in_row

TIME_NAMES = ("t", "time", "time_s", "t_s", "Time", "timestamp", "seconds")
EPOCH = (9.4e8, 4.2e9)
"""Seconds since 1970 that are taken for a date: autumn 1999 to 2103."""
_PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1.0 / 60.0, "h": 1.0 / 3600.0}
LONGEST_STEP = 86_400.0
"""Seconds between samples beyond which a guessed unit is in doubt."""
_NO_TIME = (
    "Name it t or time, or name the column: --time of discover, t under [columns] of a model "
    "(where sample_time can stand in for it), time= in Python"
)


@dataclass(frozen=True, eq=False)
class TimeColumn:
    """Time in seconds, and the columns that it was read from.

    Attributes
    ----------
    seconds : ndarray, shape (samples,)
    columns : tuple of str
    said : str
        How it was read, empty where it is plain.
    stated : bool
        Whether the file says what unit its time has.
    """

    seconds: np.ndarray
    columns: tuple[str, ...]
    said: str = ""
    stated: bool = False


def time_column(table: Table, time: str | None, file: str, required: bool) -> TimeColumn | None:
    """Find time in a table.

    Parameters
    ----------
    table : Table
    time : str, optional
        Name of the column; by default it is found by the usual names, or as the one column of
        dates.
    file : str
        For messages.
    required : bool
        Whether a table without time is an error; else None is returned.

    Raises
    ------
    InputError
        If there is none, or its unit or its dates can be read in two ways.
    """
    name = time if time is not None else _by_name(table, required)
    if time is not None and time not in table.numbers and time not in table.texts:
        if not required:
            return None
        raise InputError(f"no time column '{quoted(time)}'", file, _available(table))
    if name is not None and name in table.numbers:
        return _numeric(table, name, file)
    clock = _text_clock(table, name, file)
    # a sample time stands in for dates of which several rows share one
    if clock is not None and (required or time is not None or np.all(np.diff(clock.seconds) > 0)):
        return clock
    if name is not None and (time is not None or required):
        cell = quoted(_first_cell(table.texts[name]))
        raise InputError(
            f"time column '{quoted(name)}' is not numeric: row 1 holds '{cell}'",
            file,
            "Give time in seconds, as numbers, or as dates or clock times",
        )
    if not required:
        return None
    raise InputError("no time column", file, _available(table))


def _available(table: Table) -> str:
    odd = f". Not columns: {listed(list(table.odd), 100)}" if table.odd else ""
    return f"{_NO_TIME}. Columns: {listed([*table.numbers, *table.texts])}{odd}"


def _first_cell(text: pd.Series) -> str:
    return next((str(cell) for cell in text if cell), "")


def _by_name(table: Table, required: bool) -> str | None:
    for name in TIME_NAMES:
        if name in table.numbers:
            return name
    for columns in (table.numbers, table.texts):
        for name in columns:
            if name in TIME_NAMES or (is_time_name(name) and (required or not _vague(name))):
                return name
    # an oscilloscope may name no column time, but its first one has seconds for unit
    first = next(iter(table.numbers), None)
    if first is not None and unit_in_row(table.units.get(first, "")) in ("s", "ms", "us", "ns"):
        return first
    return None


def _vague(name: str) -> bool:
    """Return whether a name is one of time only where there is no other time."""
    return name.strip().lower() in ("clock", "date", "datum", "elapsed", "epoch", "tempo", "unix")


def _numeric(table: Table, name: str, file: str) -> TimeColumn:
    values = table.numbers[name]
    if values.dtype.kind == "m":
        return TimeColumn(values.astype(np.int64) / 1e9, (name,), "", True)
    if values.dtype.kind == "M":
        ns = values.astype(np.int64)
        clock = Clock(ns, np.isnat(values), True, True, f"'{quoted(name)}' holds dates")
        return _from_clock(clock, (name,), file)
    unit = time_unit(name) or unit_in_row(table.units.get(name, ""))
    epoch = _epoch_unit(values, unit, name, file)
    if epoch is not None:
        return _since_first(table, name, epoch, unit is not None)
    if unit in (None, "s"):
        return TimeColumn(values.astype(np.float64), (name,), "", unit == "s")
    per_second = _PER_SECOND[unit]
    seconds = values / per_second if per_second >= 1.0 else values * round(1.0 / per_second)
    said = f"time is read from '{quoted(name)}' in {WORDS[unit]}"
    return TimeColumn(seconds.astype(np.float64), (name,), said, True)


def _epoch_unit(values: np.ndarray, unit: str | None, name: str, file: str) -> str | None:
    """Return the unit of a column that counts from 1970; None where it counts from elsewhere."""
    known = values[np.isfinite(values)]
    if known.size < 2:
        return None
    first, step = float(known[0]), abs(float(np.median(np.diff(known))))
    units = ("s", "ms", "us", "ns") if unit in (None, "s") else (unit,)
    for guess in units:
        per_second = _PER_SECOND[guess]
        if not EPOCH[0] < first / per_second < EPOCH[1]:
            continue
        if unit is None and guess != "s" and step / per_second > LONGEST_STEP:
            break
        if unit == guess or unit is None:
            return guess
        raise InputError(
            f"time column '{quoted(name)}' begins at {first:.12g}: {WORDS[guess]} since 1970 by "
            f"its size, {WORDS[unit]} by its name",
            file,
            f"Name it after its unit, e.g. time_{guess}",
        )
    return None


def _since_first(table: Table, name: str, unit: str, stated: bool) -> TimeColumn:
    """Count from the first sample before the numbers lose digits as floats."""
    values, per_second = table.numbers[name], _PER_SECOND[unit]
    known = values[np.isfinite(values)]
    start = np.datetime64(int(float(known[0]) / per_second * 1e3), "ms")
    said = (
        f"time in '{quoted(name)}' is read as {WORDS[unit]} since 1970 and counted from the first "
        f"sample, {str(start)[:19].replace('T', ' ')} UTC"
    )
    if values.dtype.kind == "i":
        seconds = (values - values[0]) / per_second
    elif table.exact is not None:
        seconds = _exact_difference(table.exact(name), values) / per_second
    else:
        seconds = (values - known[0]) / per_second
    return TimeColumn(np.asarray(seconds, dtype=np.float64), (name,), said, stated)


def _exact_difference(text: pd.Series, values: np.ndarray) -> np.ndarray:
    """Return values minus the first one, by their digits before and after the decimal sign."""
    parts = text.str.strip().str.extract(r"^(\d{1,18})(?:[.,](\d+))?$")
    if parts[0].isna().any():
        return values - values[np.isfinite(values)][0]
    integers = parts[0].to_numpy(dtype=np.int64)
    fraction = ("0." + parts[1].fillna("0")).to_numpy(dtype=np.float64)
    return (integers - integers[0]) + (fraction - fraction[0])


def _text_clock(table: Table, name: str | None, file: str) -> TimeColumn | None:
    """Read time from columns of dates and clock times."""
    if name is not None:
        clock = read_clock(name, table.texts[name], file)
        if clock is None:
            return None
        return _with_date(table, name, clock, file)
    found = {n: read_clock(n, t, file) for n, t in table.texts.items()}
    clocks = {n: c for n, c in found.items() if c is not None}
    if len(clocks) == 2 and sum(c.has_date and not c.has_time for c in clocks.values()) == 1:
        name = next(n for n, c in clocks.items() if c.has_time)
        return _with_date(table, name, clocks[name], file)
    if len(clocks) > 1:
        raise InputError(
            f"{len(clocks)} columns of dates or clock times and none named time: "
            f"{listed(list(clocks), 80)}",
            file,
            _NO_TIME,
        )
    for name, clock in clocks.items():
        return _from_clock(clock, (name,), file)
    if table.nameless is not None:
        clock = read_clock("", table.nameless, file)
        if clock is not None:
            said = f"time is read from the column without a name, {clock.said}".replace(
                " ''", " it"
            )
            return _from_clock(replace(clock, said=said), (), file)
    return None


def _with_date(table: Table, name: str, clock: Clock, file: str) -> TimeColumn:
    """Join a column of clock times and one of dates, whichever of them is named."""
    if clock.has_date and clock.has_time:
        return _from_clock(clock, (name,), file)
    for other, text in table.texts.items():
        if other == name:
            continue
        second = read_clock(other, text, file)
        if second is None or second.has_date == clock.has_date:
            continue
        day, hours = (clock, second) if clock.has_date else (second, clock)
        if day.has_time:
            continue
        both = Clock(
            day.ns + hours.ns, day.missing | hours.missing, True, True, f"{day.said}, {hours.said}"
        )
        return _from_clock(both, (name, other), file)
    return _from_clock(clock, (name,), file)


def _from_clock(clock: Clock, columns: tuple[str, ...], file: str) -> TimeColumn:
    ns = clock.ns.copy()
    said = clock.said
    if clock.missing.all():
        raise InputError("every time is missing", file, "Give every sample its time")
    if not clock.has_date:
        # past midnight a clock begins anew
        late = np.flatnonzero(np.diff(ns) < -DAY // 2)
        if 0 < late.size < 0.01 * ns.size + 2:
            ns[1:] += DAY * np.cumsum(np.diff(ns) < -DAY // 2)
            said += ", past midnight counted on"
    start = ns[~clock.missing][0]
    if clock.has_date:
        instant = (
            str(np.datetime64(int(start), "ns"))[:23].replace("T", " ").rstrip("0").rstrip(".")
        )
    else:
        instant = str(pd.Timedelta(int(start), "ns")).removeprefix("0 days ")
    seconds = np.where(clock.missing, np.nan, (ns - start) / 1e9)
    said += f"; time is counted in seconds from the first sample, {instant}"
    return TimeColumn(seconds, columns, said, True)
