"""Dates and clock times written as text."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
import pandas as pd

from jaxsr._result import InputError
from jaxsr.recordings.table import quoted

DAY = 86_400_000_000_000  # nanoseconds
_TIME = r"[0-9]{1,2}:[0-9]{2}(?::[0-9]{2}(?:[.,][0-9]{1,9})?)?(?:\s?[AaPp]\.?[Mm]\.?)?"
_ZONE = r"(?:\s?(?:Z|UTC|GMT|[+-][0-9]{2}:?[0-9]{2}))?"
_ISO = re.compile(rf"[0-9]{{4}}[-/.][0-9]{{1,2}}[-/.][0-9]{{1,2}}(?:[T\s]\s*{_TIME}{_ZONE})?")
_NUMERIC = re.compile(
    rf"([0-9]{{1,2}})([-/.])([0-9]{{1,2}})\2([0-9]{{4}}|[0-9]{{2}})(?:,?[T\s]\s*{_TIME}{_ZONE})?"
)
_NAMED = re.compile(
    rf"(?:[0-9]{{1,2}}[-\s.]+[A-Za-z]{{3,9}}\.?[-\s,]+[0-9]{{2,4}}|[A-Za-z]{{3,9}}\.?\s+[0-9]{{1,2}},?\s+[0-9]{{4}})"
    rf"(?:,?[T\s]\s*{_TIME}{_ZONE})?"
)
_CLOCK = re.compile(rf"(?:[0-9]+\s?(?:d|days?)\s+)?{_TIME}|[0-9]{{1,3}}:[0-9]{{2}}[.,][0-9]{{1,9}}")
_FORMS = (_ISO, _NUMERIC, _NAMED, _CLOCK)


@dataclass(frozen=True)
class Clock:
    """Instants of a column.

    Attributes
    ----------
    ns : ndarray of int64, shape (samples,)
        Nanoseconds, since 1970 for dates, since midnight or the start for clock times.
    missing : ndarray of bool, shape (samples,)
    has_date, has_time : bool
    said : str
        How the column was read.
    """

    ns: np.ndarray
    missing: np.ndarray
    has_date: bool
    has_time: bool
    said: str


def looks_like_clock(cell: str) -> bool:
    """Return whether a cell is a date or a clock time in a usual form."""
    return len(cell) < 48 and any(f.fullmatch(cell) for f in _FORMS)


def read_clock(name: str, text: pd.Series, file: str) -> Clock | None:
    """Read a column of dates or clock times; None where its first cell is neither.

    Raises
    ------
    InputError
        If a later cell is none, or day and month cannot be told apart.
    """
    clean = text.astype("string").fillna("").str.strip()
    known = clean[clean != ""]
    if known.empty or not looks_like_clock(str(known.iloc[0])):
        return None
    first = str(known.iloc[0])
    missing = (clean == "").to_numpy(dtype=bool)
    clean = clean.str.replace(r"(?<=:[0-9][0-9]),(?=[0-9])", ".", regex=True)
    if _CLOCK.fullmatch(first):
        ns, said = _clock_times(name, clean, missing, file)
        return Clock(ns, missing, False, True, said)
    ns, said = _dates(name, clean, missing, first, file)
    has_time = bool(clean.str.contains(":", regex=False).any())
    return Clock(ns, missing, True, has_time, said)


def _clock_times(
    name: str, text: pd.Series, missing: np.ndarray, file: str
) -> tuple[np.ndarray, str]:
    known = text.loc[~missing]
    two_parts = known.str.fullmatch(r"[0-9]{1,3}:[0-9]{2}(?:\.[0-9]+)?").to_numpy(dtype=bool)
    form = "hours, minutes and seconds"
    if two_parts.all():
        has_fraction = bool(known.str.contains(".", regex=False).any())
        over_a_day = bool((known.str.extract(r"^([0-9]+)")[0].astype(int) > 23).any())
        if not (has_fraction or over_a_day):
            cell = quoted(known.iloc[0])
            raise InputError(
                f"'{cell}' in column '{quoted(name)}' may be hours and minutes or minutes and "
                "seconds",
                file,
                "Write hours, minutes and seconds (0:12:34), or seconds as numbers",
            )
        text = "0:" + text
        form = "minutes and seconds"
    noon = text.str.extract(r"([AaPp])\.?[Mm]\.?$")[0].str.lower()
    text = text.str.replace(r"\s?[AaPp]\.?[Mm]\.?$", "", regex=True)
    text = text.where(~text.str.fullmatch(r"[0-9]{1,2}:[0-9]{2}"), text + ":00")
    text = text.str.replace(r"^([0-9]+)\s?d(?:ays?)?\s+", r"\1 days ", regex=True)
    spans = pd.to_timedelta(text.where(~missing), errors="coerce")
    ns = spans.to_numpy().astype("m8[ns]").astype(np.int64)
    _refuse_odd(name, text, ns, missing, file)
    if noon.notna().any():
        half = 43_200_000_000_000
        ns = ns % half + half * (noon == "p").to_numpy(dtype=bool, na_value=False)
    return ns, f"clock times in '{quoted(name)}' are read as {form}"


def _dates(
    name: str, text: pd.Series, missing: np.ndarray, first: str, file: str
) -> tuple[np.ndarray, str]:
    text = text.str.replace(r"\s?(?:Z|UTC|GMT)$", "+00:00", regex=True)
    if _ISO.fullmatch(first):
        text = text.str.replace(r"^([0-9]{4})[/.]([0-9]{1,2})[/.]", r"\1-\2-", regex=True)
        ns = _parsed(text, missing, yearfirst=True)
        _refuse_odd(name, text, ns, missing, file)
        return ns, f"dates in '{quoted(name)}' are read as year-month-day"
    match = _NUMERIC.fullmatch(first)
    if match is None:
        ns = _parsed(text, missing)
        _refuse_odd(name, text, ns, missing, file)
        return ns, f"dates in '{quoted(name)}' are read as they are written"
    day_first = _ordered(text, missing, day_first=True)
    if match.group(2) == ".":
        _refuse_odd(name, text, day_first, missing, file)
        return day_first, f"dates in '{quoted(name)}' are read as day.month.year"
    month_first = _ordered(text, missing, day_first=False)
    good = [not _odd(ns, missing).any() for ns in (day_first, month_first)]
    if all(good):
        apart = (day_first - day_first[~missing][0]) != (month_first - month_first[~missing][0])
        if (apart & ~missing).any():
            row = int(np.flatnonzero((day_first != month_first) & ~missing)[0])
            cell = str(text.iloc[row])
            readings = [
                str(np.datetime64(int(ns[row]), "ns"))[:10] for ns in (day_first, month_first)
            ]
            raise InputError(
                f"'{quoted(cell)}' in column '{quoted(name)}', row {row + 1}, may be "
                f"{readings[0]} (day first) or {readings[1]} (month first)",
                file,
                "Write dates as year-month-day",
            )
        return day_first, f"dates in '{quoted(name)}' are all of one day"
    ns = day_first if good[0] else month_first
    if not any(good):
        wrong = [np.count_nonzero(_odd(x, missing)) for x in (day_first, month_first)]
        ns = day_first if wrong[0] <= wrong[1] else month_first
    _refuse_odd(name, text, ns, missing, file)
    order = "day/month/year" if ns is day_first else "month/day/year"
    return ns, f"dates in '{quoted(name)}' are read as {order}"


def _ordered(text: pd.Series, missing: np.ndarray, day_first: bool) -> np.ndarray:
    """Read numeric dates in one order, by rewriting them as year-month-day."""
    order = r"\3-\2-\1" if day_first else r"\3-\1-\2"
    text = text.str.replace(
        r"^([0-9]{1,2})[-/.]([0-9]{1,2})[-/.]([0-9]{2})(?![0-9])", r"\1/\2/20\3", regex=True
    )
    text = text.str.replace(r"^([0-9]{1,2})[-/.]([0-9]{1,2})[-/.]([0-9]{4}),?", order, regex=True)
    return _parsed(text, missing, yearfirst=True)


def _parsed(text: pd.Series, missing: np.ndarray, yearfirst: bool = False) -> np.ndarray:
    """Return nanoseconds since 1970; the least integer where a cell is no date."""
    text = text.str.replace(r"^([0-9]{4})-([0-9])(?=-)", r"\1-0\2", regex=True)
    text = text.str.replace(r"^([0-9]{4}-[0-9]{2})-([0-9])(?![0-9])", r"\1-0\2", regex=True)
    text = text.str.replace(r"([T\s])\s*([0-9]):", r"\g<1>0\2:", regex=True)
    text = text.where(~missing)
    twelve_hours = bool(text.str.contains(r"[AaPp]\.?[Mm]\.?$", regex=True).any())
    form = "ISO8601" if yearfirst and not twelve_hours else "mixed"
    instants = pd.to_datetime(text, format=form, errors="coerce", utc=True)
    return instants.to_numpy(dtype="M8[ns]").astype(np.int64)


def _odd(ns: np.ndarray, missing: np.ndarray) -> np.ndarray:
    return (ns == np.iinfo(np.int64).min) & ~missing


def _refuse_odd(name: str, text: pd.Series, ns: np.ndarray, missing: np.ndarray, file: str) -> None:
    odd = np.flatnonzero(_odd(ns, missing))
    if odd.size:
        cell = quoted(text.iloc[odd[0]])
        raise InputError(
            f"time column '{quoted(name)}' holds '{cell}' in row {odd[0] + 1}, which is no date or "
            "clock time like the first",
            file,
            "Write every row in the same form",
        )
