"""What the elementwise primitives of JAX mean among the terms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxsr.expressions import Term
from jaxsr.expressions.derivative import ONE, ZERO, built, chosen
from jaxsr.expressions.term import BOOLEAN


class UnreadableError(ValueError):
    """A primitive, with these arguments, has no meaning among the terms."""


def condition(term: Term) -> Term:
    """Return a condition where a number made of one stands."""
    if term.op == "piecewise" and term.args[0] == ONE and term.args[2] == ZERO:
        return term.args[1]
    if term.op in CONDITIONS:
        return term
    return Term.apply("ne", term, ZERO)


def _number(params: Any, term: Term) -> Term:
    """Return a number for a condition, where the program asks for one."""
    kind = np.dtype(params["new_dtype"]).kind
    conditional = term.op in CONDITIONS
    if kind == "b":
        return condition(term)
    if term.op == BOOLEAN:
        return Term.constant(term.value)
    if conditional:
        return chosen(term, ONE, ZERO)
    if kind in "iu":  # towards zero, as a cast does: no primitive of the grammar
        raise UnreadableError
    return term


def _power(params: Any, term: Term) -> Term:
    return built("pow", term, Term.constant(params["y"]))


def _selected(params: Any, which: Term, *cases: Term) -> Term:
    if len(cases) != 2:
        raise UnreadableError
    return chosen(condition(which), cases[1], cases[0])


def _logical(op: str) -> Callable[..., Term]:
    def meaning(params: Any, *args: Term) -> Term:
        if not all(a.op in CONDITIONS for a in args):
            raise UnreadableError
        return Term.apply(op, *args)

    return meaning


def _plain(op: str) -> Callable[..., Term]:
    return lambda params, *args: built(op, *args)


def _times(number: float, term: Term) -> Term:
    return built("mul", Term.constant(number), term)


CONDITIONS = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not", BOOLEAN})
ELEMENTWISE: dict[str, Callable[..., Term]] = {
    **{op: _plain(op) for op in ("add", "sub", "mul", "div", "neg", "max", "min", "pow", "sqrt")},
    **{op: _plain(op) for op in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2")},
    **{op: _plain(op) for op in ("sinh", "cosh", "tanh", "exp", "log", "abs", "sign", "floor")},
    **{op: _plain(op) for op in ("lt", "le", "gt", "ge", "eq", "ne")},
    **{op: _logical(op) for op in ("and", "or", "not")},
    "add_any": _plain("add"),
    "integer_pow": _power,
    "square": lambda params, a: built("pow", a, Term.constant(2.0)),
    "rsqrt": lambda params, a: built("div", ONE, built("sqrt", a)),
    "log1p": lambda params, a: built("log", built("add", ONE, a)),
    "expm1": lambda params, a: built("sub", built("exp", a), ONE),
    "exp2": lambda params, a: built("exp", _times(float(np.log(2.0)), a)),
    "logistic": lambda params, a: built(
        "div", ONE, built("add", ONE, built("exp", built("neg", a)))
    ),
    "ceil": lambda params, a: built("neg", built("floor", built("neg", a))),
    "clamp": lambda params, low, a, high: built("min", built("max", a, low), high),
    "select_n": _selected,
    "convert_element_type": _number,
    "copy": lambda params, a: a,
    "copy_p": lambda params, a: a,
    "stop_gradient": lambda params, a: a,
    "reduce_precision": lambda params, a: a,
}
