"""Partial derivatives of terms as terms, and terms built without what is void."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import BOOLEAN, Term

ZERO, ONE, TWO = Term.constant(0.0), Term.constant(1.0), Term.constant(2.0)
TRUE = Term.boolean(True)


class NoDerivativeError(ValueError):
    """A primitive whose derivative is no term."""


def built(op: str, *args: Term) -> Term:
    """Return primitive `op` of `args`; numbers are computed, zeros and ones left out.

    What is left out is exact for finite arguments.
    """
    if all(a.is_constant for a in args) and op not in _CONDITIONS:
        with np.errstate(all="ignore"):
            value = float(PRIMITIVES[op].numpy(*(np.float64(a.value) for a in args)))
        if np.isfinite(value):
            return Term.constant(value)
    zero, one = ([a.is_constant and a.value == number for a in args] for number in (0.0, 1.0))
    match op:
        case "add" if any(zero):
            return args[1] if zero[0] else args[0]
        case "add" if args[1].op == "neg":
            return built("sub", args[0], args[1].args[0])
        case "sub" if zero[1]:
            return args[0]
        case "sub" if zero[0]:
            return built("neg", args[1])
        case "sub" if args[1].op == "neg":
            return built("add", args[0], args[1].args[0])
        case "mul" if any(zero):
            return ZERO
        case "mul" if any(one):
            return args[1] if one[0] else args[0]
        case "mul" if any(a.is_constant and a.value == -1.0 for a in args):
            return built("neg", args[1] if args[0].is_constant else args[0])
        case "div" if zero[0] or one[1]:
            return args[0]
        case "neg" if args[0].op == "neg":
            return args[0].args[0]
        case "pow" if one[1]:
            return args[0]
        case "pow" if zero[1]:
            return ONE
    return Term.apply(op, *args)


def chosen(condition: Term, then: Term, otherwise: Term) -> Term:
    """Return `then` where a condition holds, else `otherwise`."""
    if condition.op == BOOLEAN:
        return then if condition.value else otherwise
    if then == otherwise:
        return then
    return Term.apply("piecewise", then, condition, otherwise, TRUE)


def derivative(term: Term, name: str, known: dict[Term, Term] | None = None) -> Term:
    """Return d(term)/d(name), without what is void.

    At a kink it is the derivative of one side, at a jump zero. `known` holds derivatives of
    subtrees by the same variable and is filled on the way.

    Raises
    ------
    NoDerivativeError
        The variable enters a primitive that has no derivative among the terms.
    """
    known = {} if known is None else known
    if term.is_variable:
        return ONE if term.name == name else ZERO
    if not term.args:
        return ZERO
    if term not in known:
        known[term] = _derivative(term, name, known)
    return known[term]


def _derivative(term: Term, name: str, known: dict[Term, Term]) -> Term:
    args = term.args
    if term.op == "piecewise":
        values = [derivative(a, name, known) for a in args[::2]]
        if all(v == values[0] for v in values):
            return values[0]
        pairs = zip(values, args[1::2], strict=True)
        return Term("piecewise", tuple(part for pair in pairs for part in pair))
    slopes = [derivative(a, name, known) for a in args]
    if all(s == ZERO for s in slopes) or term.op in _FLAT:
        return ZERO
    match term.op:
        case "add" | "sub":
            return built(term.op, *slopes)
        case "max" | "min":
            return _of_extreme(term, slopes)
    total = ZERO
    for by, slope in zip(_partials(term), slopes, strict=True):
        if slope != ZERO:
            total = built("add", total, built("mul", by(), slope))
    return total


def _of_extreme(term: Term, slopes: list[Term]) -> Term:
    value, slope = term.args[0], slopes[0]
    for other, own in zip(term.args[1:], slopes[1:], strict=True):
        first = Term.apply("ge" if term.op == "max" else "le", value, other)
        slope = chosen(first, slope, own)
        value = Term.apply(term.op, value, other)
    return slope


def _partials(term: Term) -> list[Callable[[], Term]]:
    """Partial derivatives by the arguments, computed when asked for."""
    if term.op == "pow":
        a, b = term.args
        lower = lambda: built("pow", a, built("sub", b, ONE))  # noqa: E731
        return [
            lambda: built("mul", b, lower()),
            lambda: built("mul", term, built("log", a)),
        ]
    if term.op in _PARTIALS:
        parts = _PARTIALS[term.op]
        return [lambda p=part: p(term) for part in parts]
    name_of: Callable[[int], str] | None = getattr(PRIMITIVES[term.op], "partial", None)
    if name_of is None:
        raise NoDerivativeError(term.op)
    return [partial(_called, name_of, term, k) for k in range(len(term.args))]


def _called(name_of: Callable[[int], str], term: Term, position: int) -> Term:
    return Term(name_of(position), term.args)


def _square(term: Term) -> Term:
    return built("pow", term, TWO)


def _inverse(term: Term) -> Term:
    return built("div", ONE, term)


_CONDITIONS = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not", "piecewise"})
_FLAT = frozenset({"sign", "floor", "heaviside"}) | _CONDITIONS
_Partial = Callable[[Term], Term]
_PARTIALS: dict[str, tuple[_Partial, ...]] = {
    "mul": (lambda y: y.args[1], lambda y: y.args[0]),
    "div": (
        lambda y: _inverse(y.args[1]),
        lambda y: built("neg", built("div", y, y.args[1])),
    ),
    "neg": (lambda y: Term.constant(-1.0),),
    "sin": (lambda y: built("cos", y.args[0]),),
    "cos": (lambda y: built("neg", built("sin", y.args[0])),),
    "tan": (lambda y: built("add", ONE, _square(y)),),
    "sinh": (lambda y: built("cosh", y.args[0]),),
    "cosh": (lambda y: built("sinh", y.args[0]),),
    "tanh": (lambda y: built("sub", ONE, _square(y)),),
    "exp": (lambda y: y,),
    "log": (lambda y: _inverse(y.args[0]),),
    "sqrt": (lambda y: built("div", Term.constant(0.5), y),),
    "asin": (lambda y: _inverse(built("sqrt", built("sub", ONE, _square(y.args[0])))),),
    "acos": (
        lambda y: built("neg", _inverse(built("sqrt", built("sub", ONE, _square(y.args[0]))))),
    ),
    "atan": (lambda y: _inverse(built("add", ONE, _square(y.args[0]))),),
    "atan2": (
        lambda y: built("div", y.args[1], _radius(y)),
        lambda y: built("neg", built("div", y.args[0], _radius(y))),
    ),
    "abs": (lambda y: built("sign", y.args[0]),),
}


def _radius(y: Term) -> Term:
    return built("add", _square(y.args[0]), _square(y.args[1]))
