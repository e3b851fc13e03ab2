"""Symbols of a formula model for the names of a simulator's elements."""

from __future__ import annotations

import re
from collections.abc import Iterable

from jaxsr.expressions import is_identifier

_OWN = re.compile(r"[A-Za-z]+\d+_\w*", re.ASCII)
"""Names that the equations of motion give their definitions."""
RESERVED = frozenset({"t", "g", "metre"})


def symbols_for(names: Iterable[str], taken: set[str]) -> list[str]:
    """Return a symbol for each name, none twice, and none of the grammar's own.

    Parameters
    ----------
    names : iterable of str
        Any text.
    taken : set of str
        Symbols in use; the new ones are added.
    """
    found = []
    for name in names:
        plain = re.sub(r"\W", "_", name, flags=re.ASCII) or "unnamed"
        plain = f"_{plain}" if plain[0].isdigit() else plain
        symbol, count = plain, 1
        while symbol in taken or symbol in RESERVED or not is_identifier(symbol):
            count += 1
            symbol = f"{plain}_{count}"
        taken.add(symbol)
        found.append(symbol)
    return found


def element_symbols(names: Iterable[str]) -> list[str]:
    """Return the part of a symbol that stands for each element, as in ``damping_PART``."""
    return symbols_for(names, set())


def input_symbols(names: Iterable[str], taken: set[str]) -> list[str]:
    """Return the symbols of inputs: their names, or ``u_NAME`` where those have a meaning."""
    texts = [f"u_{name}" if _OWN.fullmatch(name) else name for name in names]
    return symbols_for(texts, taken)
