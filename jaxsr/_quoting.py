"""Values of users in messages: one line, short whatever the value is."""

from __future__ import annotations

import difflib
import reprlib
from collections.abc import Iterable
from typing import Any

MOST_QUOTED = 80
"""Characters of a value that a message quotes."""
_LISTED = 240  # characters of known names that a message lists
_COMPARED = 2000  # names that a misspelt one is compared with: the comparison is slow


class _Short(reprlib.Repr):
    """The representation of containers, few entries and few levels of them."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxdict, self.maxlist, self.maxtuple = 2, 3, 4, 4
        self.maxstring = self.maxother = MOST_QUOTED

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to print integers of thousands of digits.
        digits = int(x.bit_length() * 0.30103) + 1
        return repr(x) if digits <= 40 else f"an integer of {digits} digits"


_SHORT = _Short()


def quoted(value: Any) -> str:
    """Return a value as a message quotes it, of any type and size.

    Examples
    --------
    >>> quoted("nose")
    "'nose'"
    >>> len(quoted("x" * 10_000)) <= MOST_QUOTED
    True
    """
    shown = _SHORT.repr(value)
    return shown if len(shown) <= MOST_QUOTED else shown[: MOST_QUOTED - 4] + "..." + shown[-1]


def shortened(text: str, most: int = MOST_QUOTED) -> str:
    """Return text cut to `most` characters, with dots where some are left out."""
    return text if len(text) <= most else text[: most - 3] + "..."


def closest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that a misspelt one is nearest to, if any is near."""
    near = [k for k in known if isinstance(k, str) and len(k) <= MOST_QUOTED][:_COMPARED]
    if len(name) > MOST_QUOTED:
        return None
    return next(iter(difflib.get_close_matches(name, near, 1)), None)


def hint(name: str, known: Iterable[str]) -> str:
    """Return the remedy for a name that is not known: the nearest one, or those that are."""
    names = list(known)
    near = closest(name, names)
    if near is not None:
        return f"Did you mean {near!r}?"
    if not names:
        return "None is known here"
    return f"Known: {shortened(', '.join(names), _LISTED)}"
