"""Messages of a log to columns: every number of every topic, named by its place in the message."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

WIDEST = 64
"""Numbers of an array that are still channels, and no picture or cloud of points."""


class Columns:
    """Numbers of messages, topic by topic."""

    def __init__(self) -> None:
        self._rows: dict[str, list[tuple[int, dict[str, float]]]] = {}

    def add(self, topic: str, nanoseconds: int, message: Any) -> None:
        """Take a message, at the time of its header, else at that of the log."""
        stamp = _stamp(message)
        row = dict(_numbers(message))
        if row:
            at = nanoseconds if stamp is None else stamp
            self._rows.setdefault(topic, []).append((at, row))

    def channels(self) -> list[tuple[str, np.ndarray, np.ndarray, str]]:
        """Return name, time in s from the earliest message on, values, and no unit."""
        first = min((at for rows in self._rows.values() for at, _ in rows), default=0)
        found = []
        for topic, rows in self._rows.items():
            rows.sort(key=lambda row: row[0])
            time = np.array([at - first for at, _ in rows]) / 1e9
            for name in dict.fromkeys(name for _, row in rows for name in row):
                values = np.array([row.get(name, np.nan) for _, row in rows])
                found.append((f"{topic}.{name}" if name else topic, time, values, ""))
        return found


def _fields(message: Any) -> Mapping[str, Any] | None:
    """Return the fields of a message: a mapping, or an object of rosbags."""
    if isinstance(message, Mapping):
        return message
    names = getattr(message, "__dataclass_fields__", None)
    if names is None:
        return None
    return {n: getattr(message, n) for n in names if not n.startswith("__")}


def _stamp(message: Any) -> int | None:
    """Return the time of a message's header in ns, where it has one that was set."""
    header = (_fields(message) or {}).get("header")
    stamp = _fields((_fields(header) or {}).get("stamp")) or {}
    seconds, rest = stamp.get("sec", stamp.get("secs")), stamp.get("nanosec", stamp.get("nsecs"))
    if not isinstance(seconds, int) or not isinstance(rest, int) or not (seconds or rest):
        return None
    return seconds * 1_000_000_000 + rest


def _numbers(
    value: Any, name: str = "", labels: tuple[str, ...] = ()
) -> Iterator[tuple[str, float]]:
    """Yield the numbers of a message with their names."""
    fields = _fields(value)
    if fields is not None:
        own = fields.get("name")
        named = isinstance(own, list | tuple) and all(isinstance(n, str) for n in own)
        for key, item in fields.items():
            if key != "header":
                inner = f"{name}.{key}" if name else key
                yield from _numbers(item, inner, tuple(own or ()) if named else ())
    elif isinstance(value, bool | int | float | np.number):
        yield name, float(value)
    elif isinstance(value, list | tuple | np.ndarray) and len(value) <= WIDEST:
        # joint_states: position[elbow] by the names that the message gives
        keys = labels if len(labels) == len(value) else range(len(value))
        for key, item in zip(keys, value, strict=True):
            if not isinstance(item, str):
                yield from _numbers(item, f"{name}[{key}]")
