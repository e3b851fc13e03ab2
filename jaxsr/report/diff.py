"""The diff of a model, entry by entry, as a version control tool would show it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Any

from jaxsr.expressions import number_text
from jaxsr.report.evidence import DiffRow

_DIGITS = 6  # of numbers in a model's entries
_TOKEN = re.compile(r"\s+|[A-Za-z_]\w*|\d+\.?\d*(?:[eE][+-]?\d+)?|\*\*|.")


@dataclass(frozen=True)
class DiffLine:
    """One line: its sign, and pieces of text with whether they changed."""

    sign: str
    pieces: list[tuple[str, bool]]


@dataclass(frozen=True)
class DiffTable:
    """The changed lines of one table of the model file."""

    name: str
    lines: list[DiffLine]


def diff_tables(rows: Sequence[DiffRow]) -> list[DiffTable]:
    """Return the changes grouped by table, in the order in which the tables come."""
    tables: dict[str, list[DiffLine]] = {}
    for row in rows:
        table, _, name = row.key.rpartition(".")
        table, name = (table, name) if table else ("model", row.key)
        before, after = entry_text(row.before), entry_text(row.after)
        if before != after:
            tables.setdefault(table, []).extend(_lines(name, before, after))
    return [DiffTable(name, lines) for name, lines in tables.items()]


def entry_text(value: object) -> str | None:
    """Return an entry as the model file writes it; None when there is none."""
    if value is None:
        return None
    if isinstance(value, Mapping):
        inner = ", ".join(
            f"{key} = {entry_text(item)}" for key, item in value.items() if item is not None
        )
        return f"{{ {inner} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(str(entry_text(item)) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return number_text(float(value), _DIGITS)
    return f'"{value}"'


def _lines(name: str, before: str | None, after: str | None) -> list[DiffLine]:
    if before is None or after is None:
        sign, text = ("+", after) if before is None else ("−", before)
        return [DiffLine(sign, [(f"{name} = {text}", False)])]
    old, new = _changed(before, after)
    return [
        DiffLine("−", [(f"{name} = ", False), *old]),
        DiffLine("+", [(f"{name} = ", False), *new]),
    ]


def _changed(before: str, after: str) -> tuple[list[tuple[str, bool]], list[tuple[str, bool]]]:
    """Return the pieces of both texts, those that differ marked."""
    a, b = _TOKEN.findall(before), _TOKEN.findall(after)
    old: list[tuple[str, bool]] = []
    new: list[tuple[str, bool]] = []
    for tag, a0, a1, b0, b1 in SequenceMatcher(None, a, b, autojunk=False).get_opcodes():
        old.append(("".join(a[a0:a1]), tag != "equal"))
        new.append(("".join(b[b0:b1]), tag != "equal"))
    return [p for p in old if p[0]], [p for p in new if p[0]]


def given_parameters(rows: Sequence[DiffRow]) -> dict[str, Mapping[str, Any]]:
    """Return the parameters' entries before, by name, as far as the diff knows them."""
    entries: dict[str, Mapping[str, Any]] = {}
    for row in rows:
        table, _, name = row.key.partition(".")
        if table == "parameters" and row.before is not None:
            before = row.before
            entries[name] = before if isinstance(before, Mapping) else {"value": before}
    return entries
