"""Sums as text: what one formula has that another has not."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping

_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


def summands(text: str) -> list[str]:
    """Return the signed terms of a sum, ``"- b*c"``, brackets left as they are.

    Examples
    --------
    >>> summands("-a + b*(c - d) - 1e-3*e")
    ['- a', '+ b*(c - d)', '- 1e-3*e']
    """
    found: list[str] = []
    depth, start, sign = 0, 0, "+"
    for i, letter in enumerate(text):
        depth += (letter in "([") - (letter in ")]")
        if letter not in "+-" or depth:
            continue
        before = text[:i].rstrip()
        part = text[start:i].strip()
        if part and before[-1] not in "*/eE+-":
            found.append(f"{sign} {part}")
        elif part and (before[-1] in "*/" or re.search(r"\d[eE]$", before)):
            continue
        elif part:
            found.append(f"{sign} {part}")
        sign, start = letter, i + 1
    if part := text[start:].strip():
        found.append(f"{sign} {part}")
    return found


def plain(term: str) -> str:
    """Return a term without blanks, to be compared."""
    return re.sub(r"\s+", "", term)


def names_in(text: str) -> set[str]:
    """Return the names in an expression."""
    return set(_NAME.findall(text))


def needed_by(texts: list[str], definitions: Mapping[str, str]) -> list[str]:
    """Return the definitions that expressions rest on, in their order."""
    wanted: set[str] = set()
    left = list(texts)
    while left:
        new = (names_in(left.pop()) & definitions.keys()) - wanted
        wanted |= new
        left += [definitions[name] for name in new]
    return [name for name in definitions if name in wanted]


def sum_difference(before: str, after: str, touched: set[str]) -> tuple[list[str], list[str]]:
    """Return the terms that `after` has more, and those that `before` has more.

    Terms in which a name of `touched` stands, whose meaning has changed, count as different.
    """
    old, new = summands(before), summands(after)
    same = Counter(plain(t) for t in old if not names_in(t) & touched)
    same &= Counter(plain(t) for t in new if not names_in(t) & touched)
    return _beyond(new, same.copy()), _beyond(old, same.copy())


def _beyond(terms: list[str], same: Counter[str]) -> list[str]:
    out = []
    for term in terms:
        key = plain(term)
        if same[key] > 0:
            same[key] -= 1
        else:
            out.append(term)
    return out
