"""Units in headers: which words are units, and which of them a column of time has."""

from __future__ import annotations

import re

import numpy as np

SECONDS = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
}
"""Seconds in a unit of time."""
_SPELLINGS = {
    "s": ("s", "sec", "secs", "second", "seconds", "sek", "sekunden"),
    "ms": ("ms", "msec", "msecs", "millis", "milliseconds", "millisecond", "millisec"),
    "us": ("us", "µs", "μs", "usec", "usecs", "micros", "microseconds", "microsecond"),
    "ns": ("ns", "nsec", "nsecs", "nanos", "nanoseconds", "nanosecond"),
    "min": ("min", "mins", "minute", "minutes"),
    "h": ("h", "hr", "hrs", "hour", "hours", "std"),
}
_UNIT_OF = {spelling: unit for unit, many in _SPELLINGS.items() for spelling in many}
WORDS = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"} | {
    "min": "minutes",
    "h": "hours",
}

_STEMS = frozenset(
    "t time times timestamp time_stamp zeit zeitstempel temps tiempo tempo elapsed elapsed_time "
    "time_elapsed timeelapsed elapsedtime clock epoch unix unixtime unix_time epoch_time "
    "time_since_start date datetime date_time datum date/time".split()
)
_OPENING, _CLOSING = "[({<", "])}>"
_BETWEEN = " \t_-,./"
"""Signs that part a name from the unit behind it."""

_BASES = (
    "m g s A K mol cd rad sr Hz N Pa J W C V F Ω Ohm ohm S Wb T H °C lm lx bar l L t eV Wh Ah "
    "rpm rps U/min deg degree degrees grad turn turns rev counts count cnt ticks lsb LSB bit bits "
    "% ‰ ppm ppb in ft lb lbf lbs psi mi mph kn kts gal inch foot hp dB dBm px pixel "
    "radians volt volts amp amps newton meter meters metre metres kelvin celsius °F F °K "
    "km/h kmh kph Nm nm mNm kNm VA var Var min h d sec second seconds msec usec ° º '"
).split()
_PREFIXES = ("", "k", "M", "G", "m", "µ", "μ", "u", "n", "c", "d", "h", "p")
_SYMBOLS = frozenset(p + b for p in _PREFIXES for b in _BASES) | {
    "1",
    "-",
    "–",
    "--",
    "none",
    "n/a",
}
_FACTOR = re.compile(r"^(.*?)(?:\^?\(?[-+]?[0-9]{1,2}\)?|[²³⁻¹]+)?$")


def is_unit(cell: str) -> bool:
    """Return whether a cell of a header reads as a unit: ``m/s^2``, ``[deg]``, ``1/min``, ``-``."""
    text = cell.strip()
    if len(text) > 24:
        return False
    bracketed = len(text) > 1 and text[0] + text[-1] in ("[]", "()", "{}", "<>")
    if bracketed:
        text = text[1:-1].strip()
    if not text:
        return True
    if text in _SYMBOLS or text.lower() in _UNIT_OF or (len(text) > 3 and text.lower() in _SYMBOLS):
        return True
    for part in re.split(r"[*/·.\s()]+", text.replace("**", "^")):
        if not part or part.isdigit():
            continue
        factor = _FACTOR.match(part)
        if part not in _SYMBOLS and (factor is None or factor.group(1) not in _SYMBOLS):
            return False
    return True


def time_unit(name: str) -> str | None:
    """Return the unit that a name states: "ms" of ``time_ms``, ``t [ms]`` and ``Time, ms``."""
    if name.strip().lower() in ("milliseconds", "millis", "microseconds", "micros", "nanoseconds"):
        return _UNIT_OF[name.strip().lower()]
    _, unit = _stem_and_unit(name.strip())
    # MS and NS might be mega- and nanosiemens; seconds are written small or as a whole word
    return _UNIT_OF.get(unit) or (_UNIT_OF.get(unit.lower()) if len(unit) > 2 else None)


def as_written(name: str, seconds: np.ndarray) -> np.ndarray:
    """Return times in the unit that the name of their column states, so that they read back."""
    return seconds / SECONDS[time_unit(name) or "s"]


def unit_in_row(cell: str) -> str | None:
    """Return the unit of time that a cell of a row of units states."""
    return _UNIT_OF.get(cell.strip().strip("[](){}<>").strip().lower())


def is_time_name(name: str) -> bool:
    """Return whether a name is one of time, with or without its unit."""
    plain = re.sub(r"\s+", "_", name.strip().lower())
    if plain in _STEMS or plain in ("milliseconds", "millis", "microseconds", "micros"):
        return True
    if time_unit(name) is None:
        return False
    stem, _ = _stem_and_unit(name.strip())
    return re.sub(r"\s+", "_", stem.lower()) in _STEMS


def _stem_and_unit(name: str) -> tuple[str, str]:
    """Part ``t [ms]``, ``t_ms`` and ``Time, ms`` before the unit; empty where there is none."""
    if name and name[-1] in _CLOSING:
        body = name[:-1]
        behind = max(body.rfind(sign) for sign in _CLOSING) + 1
        opened = [body.find(sign, behind) for sign in _OPENING if sign in body[behind:]]
        if opened:
            return body[: min(opened)].rstrip(_BETWEEN + ":"), body[min(opened) + 1 :].strip()
    words = name.rsplit(maxsplit=1)
    if len(words) == 2:
        return words[0].rstrip(_BETWEEN), words[1].lstrip(_BETWEEN)
    begins = min((at for sign in _BETWEEN if (at := name.find(sign, 1)) > 0), default=len(name))
    return name[:begins], name[begins:].lstrip(_BETWEEN)
