"""Partial derivatives of terms, as terms: they share their subtrees with what they come from.

A machine that computes each distinct subtree once then has value and derivatives in one pass
(forward differentiation, written out).
"""

from __future__ import annotations

from collections.abc import Callable

from jaxsr.expressions.primitives import DISCONTINUOUS
from jaxsr.expressions.term import Term

ZERO, UNIT = Term.constant(0.0), Term.constant(1.0)
_FLAT = DISCONTINUOUS | {"and", "or", "not"}

# Of a primitive's first argument, from its arguments and the whole term.
_UNARY: dict[str, Callable[[Term, Term], Term]] = {
    "sin": lambda a, f: Term.apply("cos", a),
    "cos": lambda a, f: Term.apply("neg", Term.apply("sin", a)),
    "tan": lambda a, f: _plus(UNIT, _square(f)),
    "sinh": lambda a, f: Term.apply("cosh", a),
    "cosh": lambda a, f: Term.apply("sinh", a),
    "tanh": lambda a, f: _minus(UNIT, _square(f)),
    "exp": lambda a, f: f,
    "log": lambda a, f: Term.apply("div", UNIT, a),
    "sqrt": lambda a, f: Term.apply("div", Term.constant(0.5), f),
    "asin": lambda a, f: Term.apply("div", UNIT, _root(_minus(UNIT, _square(a)))),
    "acos": lambda a, f: Term.apply("div", Term.constant(-1.0), _root(_minus(UNIT, _square(a)))),
    "atan": lambda a, f: Term.apply("div", UNIT, _plus(UNIT, _square(a))),
    "abs": lambda a, f: Term.apply("sign", a),
}
_BINARY = frozenset({"add", "sub", "mul", "div", "pow", "atan2", "max", "min"})


def derivative(term: Term, name: str) -> Term | None:
    """Return d term / d variable ``name``; None where a primitive's rule is not known here.

    At a kink (Abs, Max, Min) it is the mean of both sides, at a jump zero.
    """
    known: dict[Term, Term | None] = {}

    def of(node: Term) -> Term | None:
        if node not in known:
            known[node] = _of(node, name, of)
        return known[node]

    return of(term)


def _of(node: Term, name: str, of: Callable[[Term], Term | None]) -> Term | None:
    if node.is_variable:
        return UNIT if node.name == name else ZERO
    if not node.args or node.op in _FLAT:
        return ZERO
    slopes = [of(arg) for arg in node.args]
    if all(slope == ZERO for slope in slopes):
        return ZERO
    known = [slope for slope in slopes if slope is not None]
    if len(known) < len(slopes):
        return None
    if len(known) == 1:
        if node.op == "neg":
            return Term.apply("neg", known[0])
        rule = _UNARY.get(node.op)
        return None if rule is None else _times(rule(node.args[0], node), known[0])
    if len(known) != 2 or node.op not in _BINARY:
        return None
    return _of_two(node, *known)


def _of_two(node: Term, da: Term, db: Term) -> Term:
    a, b = node.args
    match node.op:
        case "add":
            return _plus(da, db)
        case "sub":
            return _minus(da, db)
        case "mul":
            return _plus(_times(b, da), _times(a, db))
        case "div":
            # f / b of f = 1 / b is a product, which takes a fraction of a quotient's time
            ratio = _square(node) if a == UNIT else Term.apply("div", node, b)
            down = _times(Term.apply("neg", ratio), db) if db != ZERO else ZERO
            return _plus(_over(da, b), down)
        case "pow":
            lower = _minus(b, UNIT) if not b.is_constant else Term.constant(b.value - 1.0)
            first = _times(_times(b, Term.apply("pow", a, lower)), da) if da != ZERO else ZERO
            second = _times(_times(node, Term.apply("log", a)), db) if db != ZERO else ZERO
            return _plus(first, second)
        case "atan2":
            square = _plus(_square(a), _square(b))
            return _minus(_times(_over(b, square), da), _times(_over(a, square), db))
    high, low = (a, b) if node.op == "max" else (b, a)
    first = Term.apply("heaviside", _minus(high, low))
    return _plus(_times(first, da), _times(_minus(UNIT, first), db))


def _plus(a: Term, b: Term) -> Term:
    if a == ZERO:
        return b
    return a if b == ZERO else Term.apply("add", a, b)


def _minus(a: Term, b: Term) -> Term:
    if b == ZERO:
        return a
    return Term.apply("neg", b) if a == ZERO else Term.apply("sub", a, b)


def _times(a: Term, b: Term) -> Term:
    if ZERO in (a, b):
        return ZERO
    if b == UNIT:
        return a
    return b if a == UNIT else Term.apply("mul", a, b)


def _over(a: Term, b: Term) -> Term:
    return ZERO if a == ZERO else Term.apply("div", a, b)


def _square(a: Term) -> Term:
    return Term.apply("mul", a, a)


def _root(a: Term) -> Term:
    return Term.apply("sqrt", a)
