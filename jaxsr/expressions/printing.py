"""Terms to text of the model grammar; `parse(to_text(term))` gives the term back.

The negative of a constant alone comes back as the negative constant.
"""

from __future__ import annotations

from jaxsr._quoting import shortened
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import BOOLEAN, Term

_SYMBOL = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**"}
_COMPARE = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
_PRECEDENCE = {"add": 2, "sub": 2, "mul": 3, "div": 3, "neg": 4, "pow": 5}
_ATOM = 6
_EXCERPT = 60  # nodes of a term that is printed whole in a message


def number_text(value: float, digits: int | None = None) -> str:
    """Print a number: shortest text that reads back exactly, or `digits` significant ones."""
    if digits is not None:
        value = float(f"{value:.{digits}g}")
    if _is_whole(value):
        return str(int(value)) if digits is not None else repr(float(value))
    return repr(float(value))


def _is_whole(value: float) -> bool:
    return abs(value) < 1e15 and value == int(value)


def to_text(term: Term, digits: int | None = None) -> str:
    """Print a term in the model grammar; whole exponents read ``x**2``, other numbers ``2.0``.

    Parameters
    ----------
    term : Term
    digits : int, optional
        Significant digits of constants; exact when None.
    """
    return _text(term, digits)[0]


def excerpt(term: Term, digits: int = 4) -> str:
    """Print a term for a message: of a large one the top alone, with dots for what is below."""
    return shortened(to_text(term if term.size <= _EXCERPT else _top(term, 4), digits))


def _top(term: Term, depth: int) -> Term:
    if term.size == 1:
        return term
    if depth == 0:
        return Term.variable("...")
    return Term(term.op, tuple(_top(arg, depth - 1) for arg in term.args))


def _text(term: Term, digits: int | None) -> tuple[str, int]:
    if term.is_constant:
        text = number_text(term.value, digits)
        return text, (_ATOM if term.value >= 0 and "-" not in text else _PRECEDENCE["neg"])
    if term.is_variable:
        return term.name, _ATOM
    if term.op == BOOLEAN:
        return ("True" if term.value else "False"), _ATOM
    if term.op in _SYMBOL:
        return _binary(term, digits)
    if term.op == "neg":
        text, precedence = _text(term.args[0], digits)
        text = text if precedence >= _PRECEDENCE["pow"] else f"({text})"
        return f"-{text}", _PRECEDENCE["neg"]
    if term.op in _COMPARE:
        a, b = (_wrap(arg, digits, 2) for arg in term.args)
        return f"{a} {_COMPARE[term.op]} {b}", 1
    parts = [_text(arg, digits)[0] for arg in term.args]
    if term.op == "piecewise":
        pairs = zip(parts[::2], parts[1::2], strict=True)
        return f"Piecewise({', '.join(f'({value}, {when})' for value, when in pairs)})", _ATOM
    return f"{PRIMITIVES[term.op].text}({', '.join(parts)})", _ATOM


def _wrap(term: Term, digits: int | None, least: int) -> str:
    text, precedence = _text(term, digits)
    return text if precedence >= least else f"({text})"


def _binary(term: Term, digits: int | None) -> tuple[str, int]:
    precedence = _PRECEDENCE[term.op]
    left, right = term.args
    if term.op == "pow":
        a = _wrap(left, digits, _ATOM)
        return f"{a}**{_exponent(right, digits)}", precedence
    a = _wrap(left, digits, precedence)
    # Operators group to the left, so a right operand of equal rank keeps its brackets.
    b = _wrap(right, digits, precedence + 1)
    gap = " " if precedence == 2 else ""
    return f"{a}{gap}{_SYMBOL[term.op]}{gap}{b}", precedence


def _exponent(term: Term, digits: int | None) -> str:
    if not (term.is_constant and _is_whole(term.value)):
        return _wrap(term, digits, _ATOM)
    whole = int(term.value)
    return f"{whole}" if whole >= 0 else f"({whole})"


def kind(term: Term) -> str:
    """Return the term's form without the values of its constants; whole numbers stay."""
    if not term.args:
        return term.name or (f"{term.value:g}" if term.value.is_integer() else "c")
    return f"{term.op}({','.join(map(kind, term.args))})"
