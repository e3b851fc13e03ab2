"""The tables of one model file, typed, with errors that say where."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Any

from jaxsr._quoting import closest, hint, quoted, shortened
from jaxsr._result import InputError
from jaxsr.models.model import Event, Parameter

MAX_EXPRESSION = 10_000
"""Characters of an expression that a file may hold."""
MAX_NAME = 80


def place(table: str, *keys: str) -> str:
    """Return where a key stands, e.g. ``[inertia] v.w``; keys of any length."""
    return f"[{table}] {'.'.join(map(_label, keys))}" if keys else f"[{table}]"


def _label(key: str) -> str:
    return shortened(key) if key.strip() and key.isprintable() else quoted(key)


def event_place(number: int, key: str = "") -> str:
    """Return where a key of the event of a number, counted from 1, stands."""
    return f"[[events]] {key}{f' of event {number}' if number > 1 else ''}".strip()


class Tables:
    """The tables of one model file.

    Parameters
    ----------
    document : mapping
        As a TOML reader returns it: any value may stand anywhere.
    source : str
        Name of the file in messages.
    """

    def __init__(self, document: Mapping[str, Any], source: str) -> None:
        self.document, self.source = document, source

    def fail(self, what: str, where: str = "", remedy: str = "") -> InputError:
        """Return the error for a place of this file."""
        return InputError(what, f"{self.source} {where}".strip(), remedy)

    def known(self, table: Mapping[str, Any], keys: Collection[str], where: str = "") -> None:
        """Refuse keys that mean nothing: a misspelt one would be ignored in silence."""
        allowed = keys if isinstance(keys, Mapping) else frozenset(keys)
        for key in table:
            if key not in allowed:
                raise self.fail(f"unknown key {quoted(key)}", where, hint(key, keys))

    def table(self, name: str) -> Mapping[str, Any]:
        """Return a table; empty where the file has none."""
        value = self.document.get(name, {})
        if not isinstance(value, Mapping):
            what = f"must be a table, got {quoted(value)}"
            raise self.fail(what, place(name), f"Write [{name}] on a line of its own")
        return value

    def text(self, value: Any, where: str) -> str:
        """Return a value that must be text, and not empty."""
        if not isinstance(value, str):
            raise self.fail(f"must be text, got {quoted(value)}", where, 'Write "..."')
        if not value.strip():
            raise self.fail("is empty", where, "Write it, or leave the key out")
        return value

    def expression(self, value: Any, where: str) -> str:
        """Return the text of an expression, of a length that is read."""
        if isinstance(value, int | float) and not isinstance(value, bool):
            remedy = "Write the number in quotes"
            raise self.fail(f"must be text, got {quoted(value)}", where, remedy)
        text = self.text(value, where)
        if len(text) > MAX_EXPRESSION:
            what = f"is an expression of {len(text)} characters"
            remedy = f"At most {MAX_EXPRESSION} are read: name parts of it in [definitions]"
            raise self.fail(what, where, remedy)
        return text

    def texts(self, name: str) -> dict[str, str]:
        """Return a table of names."""
        return {k: self.text(v, place(name, k)) for k, v in self.table(name).items()}

    def expressions(self, name: str) -> dict[str, str]:
        """Return a table of expressions."""
        return {k: self.expression(v, place(name, k)) for k, v in self.table(name).items()}

    def rows(self, name: str) -> dict[str, dict[str, Any]]:
        """Return a table of tables."""
        found = {}
        for key, value in self.table(name).items():
            if not isinstance(value, Mapping):
                what = f"must be a table, got {quoted(value)}"
                raise self.fail(what, place(name, key), "Write { name = ... }")
            if not value:
                raise self.fail("is empty", place(name, key), "Write { name = ... }")
            found[key] = dict(value)
        return found

    def inertia(self) -> dict[str, dict[str, str]]:
        """Return the rows of the mass matrix."""
        return {
            i: {j: self.expression(value, place("inertia", i, j)) for j, value in row.items()}
            for i, row in self.rows("inertia").items()
        }

    def per_recording(self) -> dict[str, dict[str, float]]:
        """Return the values of parameters by the name of a file."""
        name = "per_recording"
        return {
            p: {file: self.number(value, place(name, p, file)) for file, value in row.items()}
            for p, row in self.rows(name).items()
        }

    def names(self, head: Mapping[str, Any], key: str, needed: bool = False) -> tuple[str, ...]:
        """Return a list of names of [model]."""
        value = head.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            what = f"{key} must be a list of names, got {quoted(value)}"
            raise self.fail(what, "[model]", 'Write ["..."]')
        if needed and not value:
            raise self.fail(f"no {key}", "[model]", f'Write {key} = ["..."]')
        seen: set[str] = set()
        for name in value:
            if name in seen:
                what = f"{quoted(name)} is listed twice"
                raise self.fail(what, place("model", key), "Rename one of them")
            seen.add(name)
        return tuple(value)

    def number(self, value: Any, where: str) -> float:
        """Return a finite number, as the type that stands in the file."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(f"must be a number, got {quoted(value)}", where, "Write e.g. 1.0")
        try:
            finite = math.isfinite(float(value))
        except OverflowError:
            finite = False
        if not finite:
            what = f"must be finite, got {quoted(value)}"
            raise self.fail(what, where, "Write a number below 1e308")
        return float(value)

    def above_zero(self, value: Any, where: str, what: str) -> float:
        """Return a number that must be positive; `what` names it with its article."""
        number = self.number(value, where)
        if number <= 0:
            raise self.fail(f"{what} of {number:g}", where, "Write more than zero")
        return number

    def parameter(self, name: str, entry: Any) -> Parameter:
        """Return an entry of [parameters]: a number, or a table of value, unit and bounds."""
        where = place("parameters", name)
        if isinstance(entry, int | float) and not isinstance(entry, bool):
            return Parameter(self.number(entry, where))
        if not isinstance(entry, Mapping) or "value" not in entry:
            remedy = "Write { value = 1.0, bounds = [...] }"
            raise self.fail(f"needs a value, got {quoted(entry)}", where, remedy)
        self.known(entry, ["value", "unit", "bounds"], where)
        value = self.number(entry["value"], where)
        unit = self.text(entry["unit"], f"{where} unit") if "unit" in entry else None
        return Parameter(value, unit, self._bounds(entry, value, where))

    def _bounds(
        self, entry: Mapping[str, Any], value: float, where: str
    ) -> tuple[float, float] | None:
        if "bounds" not in entry:
            return None
        bounds = entry["bounds"]
        if not isinstance(bounds, list) or len(bounds) != 2:
            what = f"bounds must be [low, high], got {quoted(bounds)}"
            raise self.fail(what, where, "Write two numbers")
        low, high = (self.number(b, f"{where} bounds") for b in bounds)
        if low >= high:
            what = f"bounds [{low:g}, {high:g}] do not rise"
            raise self.fail(what, where, "Write the lower one first; leave out both to fix a value")
        if not low <= value <= high:
            what = f"value {value:g} outside bounds [{low:g}, {high:g}]"
            remedy = "Widen the bounds, or leave them out for a fixed parameter"
            raise self.fail(what, where, remedy)
        return low, high

    def initial(self, free: str) -> dict[str, float | str]:
        """Return [initial]: numbers, or the word `free`."""
        found: dict[str, float | str] = {}
        for state, value in self.table("initial").items():
            where = place("initial", state)
            if isinstance(value, str) and value != free:
                remedy = f'Write a number or "{free}"'
                raise self.fail(f"{quoted(value)} is no start", where, remedy)
            found[state] = value if isinstance(value, str) else self.number(value, where)
        return found

    def delays(self, parameters: Mapping[str, Parameter]) -> dict[str, float | str]:
        """Return [delays]: seconds, or the name of a parameter."""
        found: dict[str, float | str] = {}
        for name, value in self.table("delays").items():
            where = place("delays", name)
            if isinstance(value, str) and value not in parameters:
                near = closest(value, parameters)
                remedy = f"Write {near!r}, or declare it" if near else "Declare it"
                what = f"unknown parameter {quoted(value)}"
                raise self.fail(what, where, f"{remedy} in [parameters]")
            seconds = parameters[value].value if isinstance(value, str) else None
            seconds = self.number(value, where) if seconds is None else seconds
            if seconds < 0:
                raise self.fail(f"a delay of {seconds:g} s", where, "Write zero or more seconds")
            found[name] = value if isinstance(value, str) else seconds
        return found

    def spreads(self, name: str, what: str) -> dict[str, float]:
        """Return a table of positive numbers in the readings' units: [noise], [resolution]."""
        table = self.table(name)
        return {k: self.above_zero(v, place(name, k), what) for k, v in table.items()}

    def events(self) -> tuple[Event, ...]:
        """Return the tables of [[events]]."""
        entries = self.document.get("events", [])
        if not isinstance(entries, list):
            what = f"must be a list of tables, got {quoted(entries)}"
            raise self.fail(what, "[[events]]", "Write [[events]] above each event")
        return tuple(self._event(entry, number) for number, entry in enumerate(entries, 1))

    def _event(self, entry: Any, number: int) -> Event:
        where = event_place(number)
        if not isinstance(entry, Mapping) or "when" not in entry or "reset" not in entry:
            remedy = 'Write reset = { v = "-0.8*v" }'
            raise self.fail("an event needs when and reset", where, remedy)
        self.known(entry, ["when", "direction", "reset"], where)
        direction = entry.get("direction", 0)
        if type(direction) is not int or direction not in (-1, 0, 1):
            what = f"direction must be -1, 0 or 1, got {quoted(direction)}"
            raise self.fail(what, where, "Use -1 for falling")
        when, reset = self.expression(entry["when"], event_place(number, "when")), entry["reset"]
        if not isinstance(reset, Mapping) or not reset:
            what = f"reset must be a table of states, got {quoted(reset)}"
            raise self.fail(what, where, 'Write reset = { v = "-0.8*v" }')
        texts = {
            s: self.expression(e, event_place(number, f"reset {_label(s)}"))
            for s, e in reset.items()
        }
        return Event(when, direction, texts)
