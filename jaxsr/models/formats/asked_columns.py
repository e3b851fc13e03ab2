"""Columns of recordings that are variables of a simulator, found by their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.models.formats.columns import (
    CONTROL,
    LISTED,
    NEUTRAL,
    Quantity,
    candidates,
    scaled,
    words_of,
)

__all__ = ["Quantity", "matched"]


def matched(
    quantities: list[Quantity], columns: Sequence[str], file: str, path: Path
) -> tuple[dict[str, str], list[str]]:
    """Return role to column, and the columns that match nothing.

    A name that is the same stands before one with the same words, and that before words for a
    position, a rate or a force that only one variable can be. The readings among `quantities` are
    changed to the unit that their column's name states.

    Raises
    ------
    InputError
        A column may be two variables, an input has no column, or nothing is measured.
    """
    found: dict[str, str] = {}
    rest = list(columns)
    for rank in (_exactly, _in_words, _at_the_end, None):
        for column in list(rest):
            free = [q for q in quantities if q.role not in found]
            likely = (
                candidates(column, free) if rank is None else [q for q in free if rank(column, q)]
            )
            if len(likely) > 1:
                a, b = likely[0].element, likely[1].element
                what = f"column {shortened(column)!r} may be {a} or {b}"
                raise InputError(what, file, _remedy(path, likely[0].role, column))
            if likely:
                found[likely[0].role] = column
                rest.remove(column)
    missing = [q for q in quantities if q.kind == CONTROL and q.role not in found]
    both = (
        f"columns: {shortened(', '.join(columns), LISTED)}; "
        f"names: {shortened(', '.join(q.element for q in quantities), LISTED)}"
    )
    if missing:
        what = f"no column is {missing[0].element} ({both})"
        raise InputError(what, file, _remedy(path, missing[0].role, "COLUMN"))
    if not any(q.reading and q.role in found for q in quantities):
        what = f"no column is an output or a state ({both})"
        raise InputError(what, file, _remedy(path, quantities[0].role, "COLUMN"))
    for k, q in enumerate(quantities):
        if q.role in found and q.reading:
            quantities[k] = replace(scaled(q, found[q.role]))
    return found, rest


def _exactly(column: str, quantity: Quantity) -> bool:
    return column in (quantity.role, *quantity.names, quantity.reading)


def _in_words(column: str, quantity: Quantity) -> bool:
    return _telling(column) == _telling(quantity.names[0])


def _at_the_end(column: str, quantity: Quantity) -> bool:
    return _telling(column) == _telling(quantity.names[0].rpartition(".")[2])


def _telling(text: str) -> list[str]:
    words = words_of(text)
    return [w for w in words if w not in NEUTRAL] or words


def _remedy(path: Path, role: str, column: str) -> str:
    table = path.with_suffix(".toml").name
    return f'Write {role} = "{shortened(column)}" under [columns] of {table}'
