"""Dimensions of terms from the units of their variables.

A dimension is a vector of exponents over the base quantities. A constant inside a term may carry
any unit, so it fits everywhere: ``x + 2.0*v`` and ``sin(2.0*x)`` have a meaning, ``x + v`` and
``sin(x)`` of a length have none.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from functools import lru_cache

from jaxsr._result import InputError
from jaxsr.expressions.term import Term
from jaxsr.expressions.unit_text import dimensionality

BASES = (
    "[length]",
    "[mass]",
    "[time]",
    "[current]",
    "[temperature]",
    "[substance]",
    "[luminosity]",
)
_MOST_KEPT = 200_000  # terms whose dimension is remembered

Dimension = tuple[float, ...]
NONE: Dimension = (0.0,) * len(BASES)
"""The dimension of a pure number."""
TIME: Dimension = tuple(float(base == "[time]") for base in BASES)


class Open(enum.Enum):
    """What a term may be instead of having one dimension."""

    ANY = "any"  # a constant inside it, or a variable without a unit, sets the dimension
    NEVER = "never"  # no unit of its constants makes sense of it


_SAME = frozenset({"add", "sub", "max", "min"})
_COMPARE = frozenset({"lt", "le", "gt", "ge", "eq", "ne"})
_KEEP = frozenset({"neg", "abs", "floor"})
_LOSE = frozenset({"sign", "heaviside", "and", "or", "not"})


def dimension(text: str, where: str = "") -> Dimension:
    """Return the exponents over :data:`BASES` of a unit text.

    Raises
    ------
    InputError
        The text is no unit, or one of a quantity outside :data:`BASES`.
    """
    found = dict(dimensionality(text, where))
    strange = sorted(set(found) - set(BASES))
    if strange:
        raise InputError(f"unit {text!r} counts {strange[0]}", where, "Use SI units")
    return tuple(_rounded(float(found.get(base, 0.0))) for base in BASES)


def _rounded(exponent: float) -> float:
    # Cubed cube roots must come back whole; -0.0 must equal 0.0 in text too.
    return round(exponent, 9) + 0.0


class Dimensions:
    """Tell the dimension of terms, and which terms an equation admits.

    Parameters
    ----------
    units : mapping of str to str
        Unit of each variable, e.g. ``{"x": "m", "v": "m/s"}``. A variable without one fits
        everywhere.
    target : str, optional
        Unit of the equation's left-hand side. It binds only together with ``coefficients``: a
        coefficient of free unit gives any consistent term any unit.
    coefficients : sequence of str, optional
        The units that a coefficient may have, e.g. ``["1", "1/s", "1/s^2"]``.

    Raises
    ------
    InputError
        A unit cannot be read, or ``coefficients`` come without ``target``.

    Examples
    --------
    >>> from jaxsr.expressions import parse
    >>> known = Dimensions({"x": "m", "v": "m/s"})
    >>> [known.admissible(parse(s)) for s in ("x*v", "sin(x)", "sin(2.0*x)", "x + v")]
    [True, False, True, False]
    """

    def __init__(
        self,
        units: Mapping[str, str],
        target: str | None = None,
        coefficients: Sequence[str] | None = None,
    ) -> None:
        if coefficients is not None and target is None:
            raise InputError("units of coefficients need the unit of the target", "coefficients")
        self._of = {n: dimension(u, f"units: {n}") for n, u in units.items()}
        self._allowed: frozenset[Dimension] | None = None
        if coefficients is not None and target is not None:
            left = dimension(target, "units: target")
            allowed = (dimension(u, "units: coefficients") for u in coefficients)
            self._allowed = frozenset(_times(left, u, -1.0) for u in allowed)
        self._known: dict[Term, Dimension | Open] = {}

    def of(self, term: Term) -> Dimension | Open:
        """Return the dimension of a term, `Open.ANY`, or `Open.NEVER` where it has no meaning."""
        if term.is_variable:
            return self._of.get(term.name, Open.ANY)
        if not term.args:
            return Open.ANY
        found = self._known.get(term)
        if found is None:
            parts = [self.of(arg) for arg in term.args]
            found = Open.NEVER if Open.NEVER in parts else _combined(term, parts)
            if len(self._known) >= _MOST_KEPT:
                self._known.clear()
            self._known[term] = found
        return found

    def admissible(self, term: Term) -> bool:
        """Tell whether the term can have the unit of the equation, up to its coefficient's."""
        found = self.of(term)
        if isinstance(found, Open):
            return found is Open.ANY
        return self._allowed is None or found in self._allowed


def admissible(term: Term, units: Mapping[str, str]) -> bool:
    """Tell whether a term is consistent in units; see :class:`Dimensions` for many terms."""
    return _of_units(tuple(sorted(units.items()))).admissible(term)


@lru_cache(maxsize=16)
def _of_units(units: tuple[tuple[str, str], ...]) -> Dimensions:
    return Dimensions(dict(units))


def _combined(term: Term, parts: list[Dimension | Open]) -> Dimension | Open:
    """Return the dimension of a primitive of arguments that each have a meaning."""
    op = term.op
    if op in _SAME:
        return _common(parts)
    if op in _COMPARE or op == "atan2":
        return Open.NEVER if _common(parts) is Open.NEVER else NONE
    if op == "piecewise":
        return _common(parts[::2])
    if op in _KEEP:
        return parts[0]
    if op in _LOSE:
        return NONE
    if op == "pow":
        return _power(term.args[1], parts[0], parts[1])
    if op in ("mul", "div", "sqrt", "integral", "integral_over"):
        first, last = parts[0], parts[-1] if op != "integral" else TIME
        if isinstance(first, Open) or isinstance(last, Open):
            return Open.ANY
        if op == "sqrt":
            return tuple(_rounded(0.5 * a) for a in first)
        return _times(first, last, -1.0 if op == "div" else 1.0)
    # sin, exp, tanh and whatever else a user defines: a function of a number, to a number
    return NONE if all(part in (NONE, Open.ANY) for part in parts) else Open.NEVER


def _common(parts: Sequence[Dimension | Open]) -> Dimension | Open:
    """Return the dimension of summands: those that are known must agree."""
    known = {part for part in parts if not isinstance(part, Open)}
    if len(known) > 1:
        return Open.NEVER
    return known.pop() if known else Open.ANY


def _times(first: Dimension, second: Dimension, power: float) -> Dimension:
    return tuple(_rounded(a + power * b) for a, b in zip(first, second, strict=True))


def _power(exponent: Term, base: Dimension | Open, raised: Dimension | Open) -> Dimension | Open:
    if exponent.is_constant:
        if isinstance(base, Open):
            return Open.ANY
        return tuple(_rounded(a * exponent.value) for a in base)
    # an exponent that varies is a number, and so is what it is the power of
    numbers = (NONE, Open.ANY)
    return NONE if base in numbers and raised in numbers else Open.NEVER
