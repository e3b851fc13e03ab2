"""Slopes of terms that are straight lines in one variable, read off their structure."""

from __future__ import annotations

from jaxsr.expressions.canonical import ONE, simplify
from jaxsr.expressions.term import Term

ZERO = Term.constant(0.0)
_CONDITIONS = frozenset(
    {"piecewise", "lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not", "boolean"}
)


def affine_slope(term: Term, name: str) -> Term | None:
    """Return the slope of a term in a variable in which it is a straight line.

    Parameters
    ----------
    term : Term
    name : str
        Variable.

    Returns
    -------
    Term or None
        Zero where the variable does not occur. It occurs in the slope only as a condition of a
        Piecewise whose branches are lines. None where the term is no line.

    Notes
    -----
    The canonical form is asked where the term itself shows no line, so that x**2/x is one. Sums
    are not multiplied out: (x + 1)*(x - 1) - x**2 is none.
    """
    found = _slope(term, name, {})
    if found is None and not term.uses(_CONDITIONS):
        found = _slope(simplify(term), name, {})
    if found is None:
        return None
    return found if found.uses(_CONDITIONS) else simplify(found)


def _slope(term: Term, name: str, known: dict[Term, Term | None]) -> Term | None:
    """Return the slope; `known` holds those of subtrees, which definitions share."""
    if term.is_variable:
        return ONE if term.name == name else ZERO
    if not term.args:
        return ZERO
    if term not in known:
        known[term] = _of_node(term, name, known)
    return known[term]


def _of_node(term: Term, name: str, known: dict[Term, Term | None]) -> Term | None:
    branches = term.args[::2] if term.op == "piecewise" else term.args
    slopes = [_slope(arg, name, known) for arg in branches]
    if any(slope is None for slope in slopes):
        return None
    parts = [slope for slope in slopes if slope is not None]
    if all(part == ZERO for part in parts):
        return ZERO
    match term.op:
        case "add":
            return _sum(*parts)
        case "sub":
            return parts[0] if parts[1] == ZERO else Term("sub", (parts[0], parts[1]))
        case "neg":
            return Term("neg", (parts[0],))
        case "mul" if ZERO in parts:
            number = parts.index(ZERO)
            return _product(term.args[number], parts[1 - number])
        case "div" if parts[1] == ZERO:
            return Term("div", (parts[0], term.args[1]))
        case "pow" if term.args[1] == ONE:
            return parts[0]
        case "piecewise":
            pairs = zip(parts, term.args[1::2], strict=True)
            return Term("piecewise", tuple(part for pair in pairs for part in pair))
    return None


def _sum(first: Term, second: Term) -> Term:
    if first == ZERO:
        return second
    return first if second == ZERO else Term("add", (first, second))


def _product(factor: Term, slope: Term) -> Term:
    return factor if slope == ONE else Term("mul", (factor, slope))
