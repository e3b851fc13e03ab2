"""Names of columns as people have them, and the symbols that stand for them in expressions."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jaxsr._result import InputError
from jaxsr.expressions import is_identifier
from jaxsr.recordings import Recording

_LISTED = 12  # columns that a message names
_LONGEST = 80  # characters of a name in a message


@dataclass(frozen=True)
class Naming:
    """Symbols of columns.

    Attributes
    ----------
    columns : dict of str to str
        Symbol to column, where they differ.
    """

    columns: Mapping[str, str]

    @staticmethod
    def of(names: Sequence[str], columns: Mapping[str, str] | None = None) -> Naming:
        """Find a symbol for every name that is none.

        Parameters
        ----------
        names : sequence of str
            Columns with a role, or symbols that ``columns`` maps to columns.
        columns : mapping of str to str, optional
            Symbol to column, as the caller wants them.

        Raises
        ------
        InputError
            A key of ``columns`` is no symbol, or a column has two.
        """
        given = dict(columns or {})
        for symbol, column in given.items():
            if not is_identifier(symbol):
                raise InputError(
                    f"{quoted(symbol)} cannot stand in an expression",
                    "columns",
                    "Use letters, digits and _, beginning with a letter",
                )
            if not isinstance(column, str) or not column:
                raise InputError(f"{symbol} has no column", "columns", "Give a column's name")
        if len(set(given.values())) < len(given):
            raise InputError("a column has two names", "columns")
        out = {symbol: column for symbol, column in given.items() if symbol != column}
        taken = {*given, *(name for name in names if is_identifier(name))}
        for name in dict.fromkeys(names):
            if name in taken or name in given.values():
                continue
            symbol = identifier(name, taken)
            taken.add(symbol)
            out[symbol] = name
        return Naming(out)

    def symbol(self, name: str) -> str:
        """Return the symbol of a column."""
        return next((s for s, column in self.columns.items() if column == name), name)

    def symbols(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the symbols of columns."""
        return tuple(self.symbol(name) for name in names)

    def column(self, symbol: str) -> str:
        """Return the column that a symbol stands for."""
        return self.columns.get(symbol, symbol)

    def with_rates(self, states: Sequence[str]) -> Naming:
        """Return the naming with the columns of the rates of states, ``d_STATE``, named too."""
        rates = {f"d_{s}": f"d_{self.columns[s]}" for s in states if s in self.columns}
        return Naming({**rates, **self.columns})

    def renamed(self, recording: Recording) -> Recording:
        """Return a recording whose channels have the symbols for names."""
        found = {s: c for s, c in self.columns.items() if c in recording.channels}
        aside = {s: c for s, c in self.columns.items() if c in recording.set_aside}
        if not found and not aside:
            return recording
        channels = {**recording.channels, **{s: recording.channels[c] for s, c in found.items()}}
        told = {**recording.set_aside, **{s: recording.set_aside[c] for s, c in aside.items()}}
        return replace(recording, channels=channels, set_aside=told)

    def missing(self, recording: Recording, symbols: Sequence[str]) -> InputError | None:
        """Return what to say where a recording lacks a column, None where it has all."""
        for symbol in symbols:
            column = self.column(symbol)
            if symbol in recording.set_aside:
                return InputError(
                    f"column {quoted(column)} {recording.set_aside[symbol]}", recording.name
                )
            if symbol not in recording.channels:
                known = list(recording.channels)
                more = f" and {len(known) - _LISTED} more" if len(known) > _LISTED else ""
                return InputError(
                    f"no column {quoted(column)}",
                    recording.name,
                    f"Columns: {', '.join(map(quoted, known[:_LISTED])) or 'none'}{more}. "
                    "Name one of them among the states or inputs, or say which column a name "
                    f"stands for: --columns {symbol}=COLUMN",
                )
        return None


def quoted(name: object) -> str:
    """Return a name for a message, in quotes, not too long."""
    text = str(name)
    return repr(text if len(text) <= _LONGEST else text[:_LONGEST] + "...")


def identifier(name: str, taken: set[str]) -> str:
    """Return a symbol of the model grammar that reads like a column's name.

    ``Angle/rad`` becomes ``Angle_rad``, an accent or a Greek letter its Latin letters.
    """
    text = "".join(_latin(letter) for letter in unicodedata.normalize("NFKD", name))
    text = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_") or "x"
    if text[0].isdigit():
        text = f"x_{text}"
    if not is_identifier(text):
        text += "_"
    symbol, number = text, 2
    while symbol in taken or not is_identifier(symbol):
        symbol, number = f"{text}_{number}", number + 1
    return symbol


def _latin(letter: str) -> str:
    if letter.isascii():
        return letter
    if unicodedata.combining(letter):
        return ""
    words = unicodedata.name(letter, "").split()
    greek = len(words) > 3 and words[0] == "GREEK" and words[2] == "LETTER"
    if not greek:
        return " "
    return words[3].lower() if words[1] == "SMALL" else words[3].capitalize()
