"""The normal form of a law: a sum of products, in which equal laws look equal.

It goes beyond `canonical.simplify`, which keeps a term as short as it is: sums are multiplied out,
Max, Min, Heaviside and Piecewise become signs, cosines become sines, and sines of one argument
become one. A law is compared in this form, and written in the shorter of the two.
"""

from __future__ import annotations

import cmath
import functools
import math
from collections.abc import Mapping

from jaxsr.expressions.canonical import _build_sum, _key, simplify
from jaxsr.expressions.factors import (
    ONE,
    NoForm,
    Product,
    multiplied,
    number,
    product,
    raised,
    refuse,
    sign_of,
    size_of,
)
from jaxsr.expressions.primitives import INTEGRALS
from jaxsr.expressions.term import BOOLEAN, Term

_LONGEST = 200  # summands of a sum that is multiplied out
_LARGEST_TERM = 300  # nodes
_DIGITS = 12
_NOTHING = 1e-12  # of what was added up, below which a difference is rounding
_NEAR = 1e-11  # radians below which two phases are one
_BRANCHES = 3
_PASSES = 4
_ODD = frozenset({"tan", "asin", "atan", "sinh", "tanh"})

Sum = Mapping[frozenset[tuple[Term, float]], float]
"""Coefficients of products."""


def normal_form(term: Term) -> Term:
    """Return a sum of products that equals a term.

    Parameters
    ----------
    term : Term

    Returns
    -------
    Term
        With constants of twelve digits. The canonical form where a term has no normal one: what is
        never finite, what is too long once multiplied out, integrals.

    Notes
    -----
    Equal to the term wherever every part of it is finite, and no argument of a sign or of a
    condition is zero.
    The normal form of a normal form is itself.
    """
    form = _once(term)
    for _ in range(_PASSES):  # digits that were cut off inside a function come back otherwise
        before, form = form, _once(form)
        if form == before:
            break
    return form


def _once(term: Term) -> Term:
    parts = _sum(term)
    return simplify(term) if parts is None else _written(parts)


def summands(term: Term) -> dict[Term, float]:
    """Return the products of a term's normal form with their coefficients; 1 for a constant."""
    parts = _sum(term)
    if parts is None:
        return {simplify(term): 1.0}
    return {Product(1.0, powers).term(): c for powers, c in parts.items()}


def _sum(term: Term) -> Sum | None:
    """Return a term as a sum of products; None where neither it nor its canonical form is one."""
    if term.size > _LARGEST_TERM or term.uses(frozenset(INTEGRALS)):
        return None
    for form in (lambda: term, lambda: simplify(term)):
        try:
            return sum_of(form())
        except NoForm:
            continue
    return None


@functools.lru_cache(maxsize=20_000)
def sum_of(term: Term) -> Sum:
    """Return a term as a sum of products.

    Raises
    ------
    NoForm
    """
    match term.op:
        case "add" | "sub":
            sign = -1.0 if term.op == "sub" else 1.0
            return _one_phase(_plus(sum_of(term.args[0]), sum_of(term.args[1]), sign))
        case "max" | "min" if 1 < len(term.args) <= _BRANCHES:
            return sum_of(_folded(term))
        case "heaviside":
            return _plus({frozenset(): 0.5}, _scaled(_multiplied_out(_sign(term.args[0])), 0.5))
        case "piecewise":
            return _branches(term)
    return _one_phase(_multiplied_out(product_of(term)))


@functools.lru_cache(maxsize=20_000)
def product_of(term: Term) -> Product:
    """Return a term as a product whose sums are not multiplied out.

    Raises
    ------
    NoForm
    """
    args = term.args
    match term.op:
        case "constant":
            return number(term.value)
        case "variable":
            return Product(1.0, frozenset({(term, 1.0)}))
        case "neg":
            return _times(number(-1.0), product_of(args[0]))
        case "mul":
            return _times(product_of(args[0]), product_of(args[1]))
        case "div":
            below = raised(product_of(args[1]), -1.0, _exponents)
            return _times(product_of(args[0]), below)
        case "sqrt":
            return raised(product_of(args[0]), 0.5, _exponents)
        case "pow" if args[1].is_constant:
            return raised(product_of(args[0]), args[1].value, _exponents)
        case "abs":
            return size_of(product_of(args[0]))
        case "sign":
            return _sign(args[0])
        case "exp":
            factor, inner = _exponents([(1.0, args[0])])
            powers = {} if inner is None else {Term("exp", (inner,)): 1.0}
            return product(factor, powers, _exponents)
        case "sin" | "cos":
            return _sine(term)
        case "add" | "sub" | "max" | "min" | "heaviside" | "piecewise":
            if term.op in ("max", "min") and not 1 < len(args) <= _BRANCHES:
                return _opaque(term)
            return _factored(sum_of(term))
    if term.op in _ODD or term.op == "cosh":
        inner, sign = _positive_lead(sum_of(args[0]))
        sign = 1.0 if term.op == "cosh" else sign
        return _times(number(sign), _opaque(Term(term.op, (_written(inner),))))
    return _opaque(Term(term.op, tuple(_part(arg) for arg in args)))


def _part(arg: Term) -> Term:
    """Return an argument of a function in normal form; conditions keep their own."""
    if not arg.args or arg.op in ("and", "or", "not"):
        return arg
    return normal_form(arg)


def _opaque(term: Term) -> Product:
    if term.args and all(arg.is_constant for arg in term.args):
        folded = simplify(term)
        return number(folded.value) if folded.is_constant else _whole(folded)
    return _whole(term)


def _whole(term: Term) -> Product:
    return Product(1.0, frozenset({(term, 1.0)}))


def _times(a: Product, b: Product) -> Product:
    return multiplied(a, b, _exponents)


def _sign(arg: Term) -> Product:
    return sign_of(product_of(arg))


def _plus(a: Sum, b: Sum, factor: float = 1.0) -> Sum:
    total = dict(a)
    for powers, value in b.items():
        old, new = total.get(powers, 0.0), factor * value
        if abs(old + new) <= _NOTHING * max(abs(old), abs(new)):
            total.pop(powers, None)
        else:
            total[powers] = old + new
    if len(total) > _LONGEST:
        refuse("too many summands")
    return total


def _scaled(parts: Sum, factor: float) -> Sum:
    return {powers: c * factor for powers, c in parts.items()} if factor else {}


def _product_of_sums(a: Sum, b: Sum) -> Sum:
    if len(a) * len(b) > _LONGEST**2:
        refuse("too many summands")
    total: Sum = {}
    for powers, c in a.items():
        own: Sum = {}
        for others, d in b.items():
            made = _times(Product(c, powers), Product(d, others))
            own = _plus(own, {made.powers: made.coefficient} if made.coefficient else {})
        total = _plus(total, own)
    return total


def _multiplied_out(p: Product) -> Sum:
    """Return a product as a sum: whole positive powers of sums are multiplied out."""
    if p.coefficient == 0.0:
        return {}
    sums = [(b, int(e)) for b, e in p.powers if b.op in ("add", "sub") and e > 0 and e.is_integer()]
    rest = frozenset((b, e) for b, e in p.powers if (b, e) not in {(s, float(n)) for s, n in sums})
    total: Sum = {rest: p.coefficient}
    for base, times in sorted(sums, key=lambda item: _key(item[0])):
        if len(sum_of(base)) ** times > _LONGEST:
            refuse("too many summands")
        for _ in range(times):
            total = _product_of_sums(total, sum_of(base))
    return total


def _factored(parts: Sum) -> Product:
    """Return a sum as a product: what its summands have in common, times a sum that begins at 1."""
    if not parts:
        return number(0.0)
    if len(parts) == 1:
        ((powers, coefficient),) = parts.items()
        return Product(coefficient, powers)
    common = _in_common(parts)
    inverse = raised(Product(1.0, common), -1.0, _exponents)
    inner: Sum = {}
    for powers, c in parts.items():
        left = _times(Product(c, powers), inverse)
        inner = _plus(inner, {left.powers: left.coefficient})
    lead = inner[min(inner, key=_order)]
    base = _written(_scaled(inner, 1.0 / lead))
    return _times(Product(lead, common), _whole(base))


def _in_common(parts: Sum) -> frozenset[tuple[Term, float]]:
    """Return the powers by which every summand can be divided; broken powers stay where they are.

    Exponentials stay as well: their arguments would have to be compared.
    """
    every = [dict(powers) for powers in parts]
    shared = set(every[0]).intersection(*every[1:])
    least = {b: min((p[b] for p in every), key=abs) for b in shared if b.op not in ("exp", "abs")}
    same_side = {b for b in least if len({p[b] > 0 for p in every}) == 1}
    return frozenset((b, e) for b, e in least.items() if b in same_side and float(e).is_integer())


def _order(powers: frozenset[tuple[Term, float]]) -> tuple[bool, str]:
    """Order summands, constants last."""
    return not powers, _key(Product(1.0, powers).term())


def _written(parts: Sum) -> Term:
    """Write a sum, its constants to twelve digits."""
    rounded = {p: float(f"{c:.{_DIGITS}g}") for p, c in parts.items()}
    constant = rounded.pop(frozenset(), 0.0)
    return _build_sum(constant, {Product(1.0, p).term(): c for p, c in rounded.items() if c})


def _positive_lead(parts: Sum) -> tuple[Sum, float]:
    """Return a sum whose first part has a positive coefficient, and the sign that this takes."""
    lead = parts[min(parts, key=_order)] if parts else 1.0
    return (parts, 1.0) if lead > 0.0 else (_scaled(parts, -1.0), -1.0)


def _exponents(pairs: list[tuple[float, Term]]) -> tuple[float, Term | None]:
    """Add arguments of exponentials; the constant among them becomes a factor."""
    total: Sum = {}
    for factor, argument in pairs:
        total = _plus(total, sum_of(argument), factor)
    total = dict(total)
    constant = total.pop(frozenset(), 0.0)
    if abs(constant) > 200.0:
        refuse("an exponential is too large")
    return math.exp(constant), _written(total) if total else None


def _sine(term: Term) -> Product:
    """Return a sine, or a cosine as a sine, with a phase from 0 to half a turn."""
    turned = dict(sum_of(term.args[0]))
    phase = turned.pop(frozenset(), 0.0)
    inner, sign = _positive_lead(turned)
    if term.op == "cos":
        phase, sign = sign * phase + 0.5 * math.pi, 1.0
    else:
        phase = sign * phase
    if not inner:
        return number(sign * math.sin(phase))
    phase, flip = _half_turn(phase)
    return _times(number(sign * flip), _whole(_sine_of(inner, phase)))


def _half_turn(phase: float) -> tuple[float, float]:
    """Return a phase from 0 to pi, and the sign that this takes."""
    turns = math.floor(phase / math.pi)
    phase -= turns * math.pi
    if min(phase, math.pi - phase) < _NEAR:
        turns, phase = turns + (phase > 1.0), 0.0
    return phase, -1.0 if turns % 2 else 1.0


def _sine_of(inner: Sum, phase: float) -> Term:
    constant = {frozenset[tuple[Term, float]](): phase} if phase else {}
    return Term("sin", (_written({**inner, **constant}),))


def _one_phase(parts: Sum) -> Sum:
    """Join sines of one argument whose phases differ: a*sin(x) + b*cos(x) = c*sin(x + d)."""
    groups: dict[tuple[Term, frozenset[tuple[Term, float]]], list] = {}
    for powers, c in parts.items():
        sines = [b for b, e in powers if b.op == "sin" and e == 1.0]
        if len(sines) != 1:
            continue
        argument = dict(sum_of(sines[0].args[0]))
        phase = argument.pop(frozenset(), 0.0)
        if abs(phase - 0.5 * math.pi) < _NEAR:  # a cosine, whose phase was written to few digits
            phase = 0.5 * math.pi
        rest = powers - {(sines[0], 1.0)}
        groups.setdefault((_written(argument), rest), []).append((powers, c, phase))
    total = dict(parts)
    for (argument, rest), found in groups.items():
        if len(found) < 2:
            continue
        phasor = sum(c * cmath.exp(1j * phase) for _, c, phase in found)
        for powers, _, _ in found:
            del total[powers]
        if abs(phasor) <= _NOTHING * max(abs(c) for _, c, _ in found):
            continue
        phase, flip = _half_turn(cmath.phase(phasor))
        made = _times(Product(1.0, rest), _whole(_sine_of(sum_of(argument), phase)))
        joined = {made.powers: flip * abs(phasor) * made.coefficient}
        total = dict(_plus(total, joined))
    return total


def _folded(term: Term) -> Term:
    """Write Max and Min of two or three as sums with absolute values."""
    first, *others = term.args
    sign = "add" if term.op == "max" else "sub"
    for other in others:
        apart = Term("abs", (Term("sub", (first, other)),))
        whole = Term(sign, (Term("add", (first, other)), apart))
        first = Term("mul", (Term.constant(0.5), whole))
    return first


def _branches(term: Term) -> Sum:
    """Write a Piecewise of few branches, the last one without a condition, with signs."""
    values, conditions = term.args[::2], term.args[1::2]
    last = conditions[-1]
    if not (last.op == BOOLEAN and last.value) or len(values) > _BRANCHES:
        return {_opaque(term).powers: 1.0}
    total = sum_of(values[-1])
    for value, condition in reversed(list(zip(values[:-1], conditions[:-1], strict=True))):
        held = _indicator(condition)
        total = _plus(total, _product_of_sums(held, _plus(sum_of(value), total, -1.0)))
    return total


def _indicator(condition: Term) -> Sum:
    """Return 1 where a condition holds and 0 elsewhere."""
    one: Sum = {ONE.powers: 1.0}
    args = condition.args
    match condition.op:
        case "lt" | "le" | "gt" | "ge":
            low, high = args if condition.op in ("lt", "le") else args[::-1]
            return sum_of(Term("heaviside", (Term("sub", (high, low)),)))
        case "not":
            return _plus(one, _indicator(args[0]), -1.0)
        case "and":
            return functools.reduce(_product_of_sums, map(_indicator, args))
        case "or":
            none = [_plus(one, _indicator(arg), -1.0) for arg in args]
            return _plus(one, functools.reduce(_product_of_sums, none), -1.0)
    if condition.op == BOOLEAN:
        return one if condition.value else {}
    refuse("a condition that is no comparison")


__all__ = ["normal_form", "summands"]
