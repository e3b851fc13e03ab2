"""Unit texts such as ``N*s/m``, ``m/s^2`` or ``kg m²``: their own grammar over pint's names.

pint reads a unit by evaluating it as an expression, so that a typo ends in whatever error the
evaluation meets, and a tower of powers in none. Here pint is asked about single names alone.

    unit     = factor, { [ "*" | "/" ], factor } ;
    factor   = ( name | "1" | "(", unit, ")" ), [ ( "**" | "^" ), exponent ] ;
    exponent = [ sign ], number | "(", [ sign ], number, [ "/", number ], ")" ;
"""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING

from jaxsr._quoting import quoted
from jaxsr._result import InputError
from jaxsr.expressions.dimensionality import DIMENSIONS, SI, Dimensionality

if TYPE_CHECKING:
    import pint

MAX_LENGTH = 120
MAX_EXPONENT = 9.0
_MAX_NESTING = 10
_TOKEN = re.compile(r"\*\*|[*/^()+-]|[0-9]+(?:\.[0-9]*)?|\.[0-9]+|[A-Za-zµμΩΩ°%_]+")
_SUPERSCRIPT = re.compile("[⁺⁻]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+")
_PLAIN = str.maketrans("⁺⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "+-0123456789")
_TIMES = str.maketrans("·⋅×", "***")
# What pint calls otherwise, or takes for a unit that no engineer means ("number metre").
_MEANT = {"°": ("degree",), "Nm": ("newton", "meter")}
_REMEDY = "Write e.g. m/s, N*s/m, kg*m^2, or 1 for a number"

Exponents = dict[str, float]
Meaning = Callable[[str], tuple[tuple[str, float], ...] | None]
"""A name to what it consists of, with powers."""


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


@lru_cache(maxsize=512)
def dimensionality(text: str, where: str = "") -> Dimensionality:
    """Return the dimension of a unit text such as ``"N*s/m"``; ``"1"`` has none.

    Raises
    ------
    InputError
        The text holds anything but names of units, 1, ``* / ^ **``, brackets and small powers.
    """
    if not text.strip():
        return Dimensionality()
    return Dimensionality.of(_Reader(text, where).whole())


def factors_of(text: str) -> Exponents:
    """Return the names in a unit text with their powers, brackets multiplied out.

    Raises
    ------
    InputError
        As `dimensionality` raises it.
    """
    if not text.strip():
        return {}

    def itself(name: str) -> tuple[tuple[str, float], ...] | None:
        return None if _of_name(name) is None else ((name, 1.0),)

    found = _Reader(text, "", itself).whole()
    return {name: power for name, power in found.items() if power}


@lru_cache(maxsize=512)
def si_factor(text: str) -> float:
    """Return how many units of the SI a unit is, e.g. 0.01 for ``cm/s^2``.

    Raises
    ------
    InputError
        As `dimensionality` raises it.
    """
    factor = 1.0
    for name, power in factors_of(text).items():
        for part in _MEANT.get(name, (name,)):
            if part in SI:
                continue
            one = _registry().Quantity(1.0, part)
            factor *= float(one.to_base_units().magnitude) ** power
    return factor


@lru_cache(maxsize=512)
def _of_name(name: str) -> tuple[tuple[str, float], ...] | None:
    """Return the dimension of one name of a unit; None where nobody knows it."""
    parts = _MEANT.get(name, (name,))
    if all(part in DIMENSIONS for part in parts):
        known = functools.reduce(operator.mul, (DIMENSIONS[part] for part in parts))
        return known.powers
    import pint
    from pint.util import UnitsContainer

    registry = _registry()
    try:
        units = UnitsContainer({registry.get_name(n): 1 for n in parts})
        found = registry.get_dimensionality(units)
        return tuple((str(base), float(power)) for base, power in found.items())  # type: ignore[arg-type]
    except (pint.PintError, KeyError, ValueError, TypeError):
        return None


class _Reader:
    """Take tokens from the front and multiply dimensions."""

    def __init__(self, text: str, where: str, meaning: Meaning | None = None) -> None:
        self.text, self.where, self.meaning = text, where, meaning or _of_name
        if len(text) > MAX_LENGTH:
            raise self.fail(f"is longer than {MAX_LENGTH} characters")
        plain = _SUPERSCRIPT.sub(lambda m: f"**{m.group().translate(_PLAIN)}", text)
        self.tokens = _tokens(plain.translate(_TIMES))
        if not all(_TOKEN.fullmatch(token) for token in self.tokens):
            strange = next(t for t in self.tokens if not _TOKEN.fullmatch(t))
            raise self.fail(f"holds {strange!r}")
        self.tokens.reverse()

    def fail(self, why: str) -> InputError:
        return InputError(f"unit {quoted(self.text)} {why}", self.where, _REMEDY)

    def next(self) -> str:
        return self.tokens[-1] if self.tokens else ""

    def take(self) -> str:
        if not self.tokens:
            raise self.fail("ends too early")
        return self.tokens.pop()

    def whole(self) -> Exponents:
        found = self.product(0)
        if self.tokens:
            raise self.fail(f"holds {self.next()!r} where an operator is expected")
        return found

    def product(self, level: int) -> Exponents:
        if level > _MAX_NESTING:
            raise self.fail("is nested too deeply")
        found = self.factor(level)
        while self.tokens and self.next() not in (")", "**", "^", "+", "-"):
            sign = -1.0 if self.next() == "/" else 1.0
            if self.next() in ("*", "/"):
                self.take()
            for base, power in self.factor(level).items():
                found[base] = found.get(base, 0.0) + sign * power
        return found

    def factor(self, level: int) -> Exponents:
        token = self.take()
        if token == "(":
            found = self.product(level + 1)
            if self.take() != ")":
                raise self.fail("holds a bracket that is not closed")
        elif token[0].isdigit() or token[0] == ".":
            if float(token) != 1.0:
                raise self.fail(f"has the number {token} out of place: units have no factors")
            found = {}
        elif token[0] in "*/^()+-":
            raise self.fail(f"holds {token!r} where a name is expected")
        else:
            known = self.meaning(token)
            if known is None:
                what = f"unknown unit {quoted(token)}"
                within = "" if token == self.text.strip() else f" in {quoted(self.text)}"
                raise InputError(what + within, self.where, _REMEDY)
            found = dict(known)
        if self.next() in ("**", "^"):
            self.take()
            exponent = self.exponent()
            found = {base: power * exponent for base, power in found.items()}
        return found

    def exponent(self) -> float:
        if self.next() != "(":
            return self.number()
        self.take()
        value = self.number()
        if self.next() == "/":
            self.take()
            below = self.number()
            if not below:
                raise self.fail("has a power that divides by zero")
            value /= below
        if self.take() != ")":
            raise self.fail("has a power that is no number or fraction")
        return value

    def number(self) -> float:
        token = self.take()
        sign = -1.0 if token == "-" else 1.0
        if token in ("+", "-"):
            token = self.take()
        if not (token[0].isdigit() or token[0] == "."):
            raise self.fail("has a power that is no number")
        if float(token) > MAX_EXPONENT:
            raise self.fail(f"has the power {token}: at most {MAX_EXPONENT:g} is read")
        return sign * float(token)


def _tokens(text: str) -> list[str]:
    """Return the tokens of a text, characters that are none of the grammar among them."""
    return re.findall(rf"{_TOKEN.pattern}|\S", text)
