"""The editing operation of the paper's section 4.2.1: simplify, split, shorten, drop.

A term that can never be finite (the root of a negative constant, a division by zero) is the
constant NaN in its canonical form, and :func:`edit` drops it.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Iterable

from jaxsr.expressions.canonical import (
    ONE,
    REMEMBERED,
    build_product,
    collect_product,
    collect_sum,
    is_nan,
    product,
    simplify,
    times,
)
from jaxsr.expressions.primitives import INTEGRALS
from jaxsr.expressions.term import Term

__all__ = ["ONE", "edit", "shorten", "simplify", "split"]

_MOST_EXPANDED = 6  # a product of sums that expands to more parts stays a product


def split(term: Term) -> list[tuple[float, Term]]:
    """Return a term as (coefficient, term of outer coefficient 1): sums apart, products expanded.

    In a linear regression each part deserves its own coefficient: ``x*(y + 3)`` holds an inner
    constant, ``x*y`` and ``x`` hold none.
    """
    return _split(simplify(term))


def _split(form: Term) -> list[tuple[float, Term]]:
    constant, parts = collect_sum(form)
    out: list[tuple[float, Term]] = []
    for base, coefficient in parts.items():
        pieces = _expand(base)
        if pieces == [base]:
            out.append((coefficient, base))
        else:
            out += [(coefficient * c, part) for piece in pieces for c, part in _split(piece)]
    if constant != 0.0:
        out.append((constant, ONE))
    return out


def shorten(term: Term) -> Term:
    """Return the term with chains of one function cut to two links; this changes its value.

    sin(sin(sin(sin(x)))) becomes sin(sin(x)): the repetition adds nodes, not physics (paper,
    section 4.2.1, a).
    """
    if term.operators < 3:
        return term
    if len(term.args) == 1 and term.args[0].op == term.op == _inner(term.args[0]):
        return shorten(term.args[0])
    args = tuple([shorten(arg) for arg in term.args])
    return term if all(map(operator.is_, args, term.args)) else Term(term.op, args)


def _inner(term: Term) -> str:
    return term.args[0].op if len(term.args) == 1 else ""


def edit(terms: Iterable[Term]) -> tuple[Term, ...]:
    """Return an individual's terms in canonical form, without repeats and hopeless terms."""
    return tuple(dict.fromkeys(part for term in terms for part in _parts(term)))


@functools.lru_cache(maxsize=REMEMBERED)
def _parts(term: Term) -> tuple[Term, ...]:
    form = simplify(term)
    short = shorten(form)
    pieces = _split(form) if short is form else split(short)
    return tuple(part for scale, part in pieces if math.isfinite(scale) and _is_finite(part))


def _is_finite(term: Term) -> bool:
    return not any(is_nan(node) for node in term.walk())


def _expand(base: Term) -> list[Term]:
    """Return a product of sums, or the integral of a sum, as its parts where they are few."""
    if base.op in INTEGRALS and base.args[0].op in ("add", "sub"):
        whole = [Term(base.op, (piece, *base.args[1:])) for piece in _pieces(base.args[0])]
        return [simplify(part) for part in whole]
    if base.op not in ("mul", "div", "pow"):
        return [base]
    _, powers = collect_product(base)
    for factor, exponent in powers.items():
        if factor.op not in ("add", "sub") or exponent not in (1.0, 2.0):
            continue
        rest = dict(powers)
        rest[factor] = exponent - 1.0
        others = build_product(1.0, {k: e for k, e in rest.items() if e != 0.0})
        pieces = _pieces(factor)
        if len(pieces) <= _MOST_EXPANDED:
            return [simplify(product(piece, others)) for piece in pieces]
    return [base]


def _pieces(term: Term) -> list[Term]:
    constant, parts = collect_sum(term)
    pieces = [times(c, part) for part, c in parts.items()]
    return [*pieces, Term.constant(constant)] if constant else pieces
