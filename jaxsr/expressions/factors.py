"""Products as powers of their factors, with the signs of factors apart: Abs(x) = x*sign(x).

A factor is a variable, a function or a sum whose first part has coefficient 1. Whole powers of it
and its sign (exponent 0 or 1) stand beside each other; a broken power stands for that of its size,
Abs(x)**p. So x/Abs(x), Abs(x)/x, x/sqrt(x**2) and sign(x) are one product.

Forms hold wherever no factor whose sign or reciprocal is asked for is zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NoReturn

from jaxsr.expressions.canonical import build_product
from jaxsr.expressions.signs import never_negative, positive
from jaxsr.expressions.term import Term

_SAME_SIGN = frozenset({"tanh", "sinh", "atan"})
_LARGEST = 1e100


class NoForm(Exception):
    """A term has no normal form: it is never finite, or too long once it is multiplied out."""


def refuse(why: str) -> NoReturn:
    raise NoForm(why)


@dataclass(frozen=True)
class Product:
    """coefficient * prod(base**exponent), normalised by `product`."""

    coefficient: float
    powers: frozenset[tuple[Term, float]] = frozenset()

    def term(self) -> Term:
        """Return the product as a term, its coefficient aside."""
        powers = dict(self.powers)
        for sign in [b for b in powers if b.op == "sign"]:
            inner = sign.args[0]
            if powers.get(inner, 0.0) >= 1.0:  # x**2*sign(x) reads x*Abs(x)
                del powers[sign]
                powers[inner] -= 1.0
                powers[Term("abs", (inner,))] = 1.0
        return build_product(1.0, {b: e for b, e in powers.items() if e})


ONE = Product(1.0)
AddExponents = Callable[[list[tuple[float, Term]]], tuple[float, Term | None]]


def number(value: float) -> Product:
    """Return a constant."""
    if not math.isfinite(value) or (value and not 1.0 / _LARGEST < abs(value) < _LARGEST):
        refuse("a constant is no number to reckon with")
    return Product(float(value))


def product(coefficient: float, powers: Mapping[Term, float], exponents: AddExponents) -> Product:
    """Return the normalised product of powers.

    `exponents` adds (factor, argument) pairs of exponentials: exp(a)**2*exp(b) has one argument.
    """
    found = {b: e for b, e in powers.items() if e}
    exponentials = [(found.pop(b), b.args[0]) for b in list(found) if b.op == "exp"]
    if exponentials:
        factor, inner = exponents(exponentials)
        coefficient *= factor
        if inner is not None:
            found[Term("exp", (inner,))] = 1.0
    for sign in [b for b in found if b.op == "sign"]:
        found[sign] %= 2.0
    for size in [b for b in found if b.op == "abs"]:
        _size_joined(size, found)
    kept = frozenset((b, e) for b, e in found.items() if e)
    return Product(number(coefficient).coefficient, kept if coefficient else frozenset())


def _size_joined(size: Term, found: dict[Term, float]) -> None:
    """Join Abs(x)**p with the powers and the sign of x beside it."""
    inner = size.args[0]
    sign = Term("sign", (inner,))
    whole, power = found.pop(inner, 0.0), found.pop(size)
    odd = (found.pop(sign, 0.0) + whole) % 2.0
    power = _near_whole(power + whole)
    if power.is_integer():  # Abs(x)**n = x**n*sign(x)**n
        odd, found[inner] = (odd + power) % 2.0, power
    else:
        found[size] = power
    found[sign] = odd


def _near_whole(value: float) -> float:
    near = float(round(value))
    return near if abs(value - near) < 1e-12 else value


def multiplied(a: Product, b: Product, exponents: AddExponents) -> Product:
    """Return a*b."""
    powers = dict(a.powers)
    for base, exponent in b.powers:
        powers[base] = _near_whole(powers.get(base, 0.0) + exponent)
    return product(a.coefficient * b.coefficient, powers, exponents)


def sign_of(p: Product) -> Product:
    """Return the sign of a product."""
    powers: dict[Term, float] = {}
    for base, exponent in p.powers:
        for part in _signs(base, exponent):
            powers[part] = (powers.get(part, 0.0) + 1.0) % 2.0
    return Product(math.copysign(1.0, p.coefficient) if p.coefficient else 0.0, _kept(powers))


def size_of(p: Product) -> Product:
    """Return the absolute value of a product."""
    powers: dict[Term, float] = {}
    for base, exponent in p.powers:
        if base.op == "sign":
            continue
        powers[base] = exponent
        if not never_negative(base):
            for part in _signs(base, exponent):
                powers[part] = (powers.get(part, 0.0) + 1.0) % 2.0
    return Product(abs(p.coefficient), _kept(powers))


def _kept(powers: Mapping[Term, float]) -> frozenset[tuple[Term, float]]:
    return frozenset((b, e) for b, e in powers.items() if e)


def _signs(base: Term, exponent: float) -> Iterator[Term]:
    """Yield the sign of base**exponent where it has one."""
    if base.op == "sign":
        if exponent % 2.0:
            yield base
    elif exponent % 2.0 == 1.0 and base.op != "abs" and not positive(base):
        while base.op in _SAME_SIGN:
            base = base.args[0]
        yield Term("sign", (base,))


def raised(p: Product, exponent: float, exponents: AddExponents) -> Product:
    """Return p**exponent."""
    if exponent == 0.0:
        return ONE
    if p.coefficient == 0.0:
        return p if exponent > 0.0 else refuse("a division by zero")
    if float(exponent).is_integer():
        powers = {b: e * exponent for b, e in p.powers}
        return product(_power(p.coefficient, exponent), powers, exponents)
    powers, rest = _sizes(p)
    powers = {b: _near_whole(e * exponent) for b, e in powers.items()}
    if rest:
        # its sign is open: sqrt(-x) stays the root of a product
        inner = build_product(math.copysign(1.0, p.coefficient), rest)
        whole = Term("pow", (inner, Term.constant(exponent)))
        powers[whole] = powers.get(whole, 0.0) + 1.0
        return product(_power(abs(p.coefficient), exponent), powers, exponents)
    if p.coefficient < 0.0:
        refuse("the root of a negative number")
    return product(_power(p.coefficient, exponent), powers, exponents)


def _sizes(p: Product) -> tuple[dict[Term, float], dict[Term, float]]:
    """Return the factors that are never negative, as powers of sizes, and the others."""
    powers, sizes = dict(p.powers), dict[Term, float]()
    for base in [b for b in powers if b.op not in ("sign",)]:
        exponent, sign = powers[base], Term("sign", (base,))
        if never_negative(base):
            sizes[base] = powers.pop(base)
        elif exponent % 2.0 == powers.get(sign, 0.0):  # x**2, or x*sign(x)
            powers.pop(sign, None)
            sizes[Term("abs", (base,))] = powers.pop(base)
    return sizes, powers


def _power(value: float, exponent: float) -> float:
    try:
        return number(math.pow(value, exponent)).coefficient
    except (OverflowError, ValueError):
        refuse("a power is not finite")
