"""What can be told of a term's sign without looking at data."""

from __future__ import annotations

from jaxsr.expressions.term import Term

_NEVER_NEGATIVE = frozenset({"abs", "exp", "sqrt", "cosh", "heaviside"})
_POSITIVE = frozenset({"exp", "cosh"})


def positive(term: Term, sign: int = 1) -> bool:
    """Tell whether a term is above zero (``sign=-1``: below) wherever it is finite.

    A square is not: it vanishes somewhere, and there its sign is 0.
    """
    match term.op:
        case "constant":
            return sign * term.value > 0.0
        case "add":
            return _both(term, sign, sign)
        case "sub":
            return _both(term, sign, -sign)
        case "mul" | "div":
            a, b = term.args
            return any(positive(a, s) and positive(b, sign * s) for s in (1, -1))
        case "neg":
            return positive(term.args[0], -sign)
        case "pow" | "sqrt":
            return sign > 0 and positive(term.args[0])
        case "abs":
            return sign > 0 and (positive(term.args[0]) or positive(term.args[0], -1))
    return sign > 0 and term.op in _POSITIVE


def _both(term: Term, first: int, second: int) -> bool:
    """Tell whether both parts keep their signs and one of them does not vanish."""
    a, b = term.args
    return (
        _keeps_sign(a, first)
        and _keeps_sign(b, second)
        and (positive(a, first) or positive(b, second))
    )


def never_negative(term: Term) -> bool:
    """Tell whether a term is at least zero wherever it is finite."""
    return _keeps_sign(term, 1)


def never_positive(term: Term) -> bool:
    """Tell whether a term is at most zero wherever it is finite."""
    return _keeps_sign(term, -1)


def _keeps_sign(term: Term, sign: int) -> bool:
    match term.op:
        case "constant":
            return sign * term.value >= 0.0
        case "add" | "sub":
            a, b = term.args
            return _keeps_sign(a, sign) and _keeps_sign(b, sign if term.op == "add" else -sign)
        case "mul" | "div":
            a, b = term.args
            return any(_keeps_sign(a, s) and _keeps_sign(b, sign * s) for s in (1, -1))
        case "neg":
            return _keeps_sign(term.args[0], -sign)
        case "pow":
            base, exponent = term.args
            if exponent.op == "constant" and exponent.value % 2.0 == 0.0:
                return sign > 0
            return sign > 0 and _keeps_sign(base, 1)
    return sign > 0 and term.op in _NEVER_NEGATIVE
