"""Whole numbers in place of constants that the data cannot tell from them."""

from __future__ import annotations

from collections.abc import Sequence

from jaxsr.evolution.polish import NEAR, whole_near
from jaxsr.expressions.editing import edit
from jaxsr.expressions.term import Term
from jaxsr.regression import RegressionProblem

_NEAR_EXPONENT = 0.02  # an exponent is likely whole, a frequency or a phase is not
_RISE = 4.0  # of the residual sum of squares, in units of its mean square: two standard errors


def rounded(problem: RegressionProblem, terms: Sequence[Term]) -> tuple[Term, ...]:
    """Round inner constants that lie next to whole numbers, where the fit does not suffer.

    x**1.9999999 is the square, and sin(x - 1.0000002*y) the sine of a difference. A constant is
    rounded if the residual sum of squares rises by no more than a parameter at its true value would
    cost, or stays within the errors of the target.
    """
    terms, loss = problem.refine(terms)
    total = problem.total or 1.0
    for old, new in _candidates(terms):
        if old not in terms:
            continue
        trial = edit(new if term == old else term for term in terms)
        if not trial or -1 in problem.index(trial):
            continue
        after = problem.fit(trial).loss * problem.rows / total
        allowed = max(loss * (1.0 + _RISE / problem.rows), loss + problem.floor)
        if after <= allowed:
            terms, loss = trial, after
    return tuple(terms)


def _candidates(terms: Sequence[Term]) -> list[tuple[Term, Term]]:
    """Return (term, the same with one constant rounded)."""
    out = []
    for term in terms:
        exponents = {id(n.args[1]) for n in term.walk() if n.op == "pow"}
        for place, node in enumerate(term.walk()):
            if not node.is_constant or not term.args or node.value.is_integer():
                continue
            near = _NEAR_EXPONENT if id(node) in exponents else NEAR
            whole = whole_near(node.value, near)
            if whole is not None:
                out.append((term, term.replace_at(place, Term.constant(whole))))
    return out
