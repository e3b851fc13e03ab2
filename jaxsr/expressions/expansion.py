"""Terms multiplied out: sums of products, in which one term may be looked for inside another."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping

from jaxsr.expressions.canonical import (
    ONE,
    Product,
    build_product,
    collect_product,
    is_nan,
    simplify,
)
from jaxsr.expressions.term import Term

MOST_PRODUCTS = 200
"""Products from which a sum is not multiplied out."""
DEEPEST, MOST_NODES = 300, 3000
"""Depth and number of different subtrees from which a term is not looked into."""
EQUAL = 1e-9
"""Relative difference of coefficients that rounding makes."""

Monomial = frozenset[tuple[Term, float]]
"""A product without its coefficient: bases with their exponents."""
Expansion = Mapping[Monomial, float]
"""A sum of products: their coefficients."""
UNIT: Monomial = frozenset()


def expanded(term: Term) -> Expansion | None:
    """Return a term as a sum of products, None where that is too long or never finite.

    Products of sums and whole powers of them are multiplied out; other functions, and sums below
    the line, are bases in their canonical form.
    """
    leaves = (node for node in term.distinct() if not node.args)
    done, deep = dict[Term, Expansion](), dict[Term, int]()
    for node in itertools.chain(leaves, term.upward()):
        deep[node] = 1 + max((deep[arg] for arg in node.args), default=0)
        if deep[node] > DEEPEST or len(done) > MOST_NODES:
            return None
        found = _of(node, [done[arg] for arg in node.args])
        if found is None or len(found) > MOST_PRODUCTS:
            return None
        done[node] = found
    return done[term]


def contracted(expansion: Expansion) -> Term:
    """Return the term of a sum of products."""
    total = Term.constant(0.0)
    for monomial, coefficient in expansion.items():
        total = Term.apply("add", total, build_product(coefficient, dict(monomial)))
    return simplify(total)


def factor_inside(
    whole: Expansion, part: Expansion, allowed: frozenset[str]
) -> tuple[Monomial, float] | None:
    """Return the product a for which a*part is a part of a sum, None without any.

    Parameters
    ----------
    whole, part : Expansion
    allowed : frozenset of str
        Variables that may stand in a.
    """
    lead = max(part, key=len, default=None)
    if lead is None:
        return None
    for monomial, coefficient in whole.items():
        quotient = _times(monomial, _inverse(lead))
        if all(b.is_variable and b.name in allowed for b, _ in quotient):
            factor = coefficient / part[lead]
            if all(
                abs(whole.get(_times(m, quotient), 0.0) - factor * c) <= EQUAL * abs(factor * c)
                for m, c in part.items()
            ):
                return quotient, factor
    return None


def without(whole: Expansion, part: Expansion, factor: tuple[Monomial, float]) -> Expansion:
    """Return a sum less factor*part, every product of which stands in it."""
    gone = {_times(m, factor[0]) for m in part}
    return {m: c for m, c in whole.items() if m not in gone}


def _of(node: Term, args: list[Expansion]) -> Expansion | None:
    """Expand a node whose arguments are expanded."""
    match node.op:
        case "constant":
            return {UNIT: node.value} if node.value else {}
        case "add":
            return _sum(args)
        case "sub":
            return _sum([args[0], _scaled(args[1], -1.0)])
        case "neg":
            return _scaled(args[0], -1.0)
        case "mul":
            return _multiplied(*args)
        case "div" if len(args[1]) == 1:
            ((monomial, coefficient),) = args[1].items()
            return _multiplied(args[0], {_inverse(monomial): 1.0 / coefficient})
        case "div":
            below = _base(Term("div", (ONE, node.args[1])))
            return None if below is None else _multiplied(args[0], below)
        case "pow" if node.args[1] == Term.constant(2.0):
            return _multiplied(args[0], args[0])
    return _base(node)


def _base(node: Term) -> Expansion | None:
    """Return a node that is not multiplied out, as one product."""
    plain = simplify(node)
    if is_nan(plain):
        return None
    coefficient, powers = collect_product(plain)
    return {_monomial(powers): coefficient} if coefficient else {}


def _sum(parts: Iterable[Expansion]) -> Expansion:
    total: dict[Monomial, float] = {}
    for part in parts:
        for monomial, coefficient in part.items():
            total[monomial] = total.get(monomial, 0.0) + coefficient
    return {m: c for m, c in total.items() if c != 0.0}


def _scaled(part: Expansion, factor: float) -> Expansion:
    return {m: factor * c for m, c in part.items()}


def _multiplied(a: Expansion, b: Expansion) -> Expansion | None:
    if len(a) * len(b) > MOST_PRODUCTS:
        return None
    return _sum({_times(m, n): c * d} for m, c in a.items() for n, d in b.items())


def _times(a: Monomial, b: Monomial) -> Monomial:
    powers: Product = dict(a)
    for base, exponent in b:
        powers[base] = powers.get(base, 0.0) + exponent
    return _monomial(powers)


def _inverse(monomial: Monomial) -> Monomial:
    return frozenset((base, -exponent) for base, exponent in monomial)


def _monomial(powers: Product) -> Monomial:
    return frozenset((base, exponent) for base, exponent in powers.items() if exponent)
