"""Models that can never run: rates that are no numbers, and mass matrices without an inverse."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate
from jaxsr.expressions.printing import excerpt
from jaxsr.models.mass_matrix import check_invertible
from jaxsr.models.model import Model

Values = Mapping[str, float]
# What stays without a finite value whatever the finite value of another argument is.
_SPREADING = frozenset({"add", "sub", "mul", "neg", "abs"})
_CHOOSING = frozenset({"piecewise", "max", "min", "and", "or", "not"})


def check_solvable(model: Model) -> None:
    """Refuse a model whose rates or readings are no numbers whatever its states are.

    What depends on states, inputs or time is left to the simulation; what constants and given
    parameter values decide is decided here.

    Raises
    ------
    InputError
        An expression is infinite or NaN at the given values, or the mass matrix is singular.
    """
    values = {name: p.value for name, p in model.parameters.items()}
    met: dict[Term, Term | None] = {}
    places = [(f"[equations] {s}", e) for s, e in model.equation_terms.items()]
    places += [
        (f"[inertia] {i}.{j}", e) for i, row in model.inertia_terms.items() for j, e in row.items()
    ]
    places += [(f"[readings] {y}", e) for y, e in model.reading_terms.items()]
    for where, term in places:
        culprit = never_finite(term, values, met)
        if culprit is not None:
            what = f"{excerpt(culprit)!r} has no finite value{_given(culprit, values)}"
            raise InputError(what, where, "Change the value or the expression")
    check_invertible(model)


def never_finite(term: Term, values: Values, met: dict[Term, Term | None]) -> Term | None:
    """Return the part of a term that makes it infinite or NaN for all states; None if none does.

    Parameters
    ----------
    term : Term
    values : mapping of str to float
        Values of the parameters.
    met : dict
        Subtrees met before; filled on the way.
    """
    if not term.args:
        return None
    if term not in met:
        met[term] = _never_finite(term, values, met)
    return met[term]


def _never_finite(term: Term, values: Values, met: dict[Term, Term | None]) -> Term | None:
    if term.op in _CHOOSING:  # an argument that is not chosen does no harm
        return None
    for arg in term.args:
        culprit = never_finite(arg, values, met)
        if culprit is not None and (
            term.op in _SPREADING or (term.op == "div" and arg is term.args[0])
        ):
            return culprit
    fixed = [_fixed(arg, values) for arg in term.args]
    if term.op == "div" and fixed[1] == 0.0:
        return term
    if all(value is not None for value in fixed):
        result = _fixed(term, values)
        if result is not None and not math.isfinite(result):
            return term
    return None


def _fixed(term: Term, values: Values) -> float | None:
    """Return the value of a term of constants and parameters; None of any other."""
    if term.is_constant:
        return term.value
    if not term.variables <= values.keys():
        return None
    with np.errstate(all="ignore"):
        try:
            return float(evaluate(term, {n: np.float64(values[n]) for n in term.variables}))
        except (ZeroDivisionError, OverflowError, ValueError):
            return math.nan


def _given(term: Term, values: Values) -> str:
    """Return the values of the parameters in a term, in words for a message."""
    names = [name for name in values if name in term.variables]
    listed = ", ".join(f"{name} = {values[name]:g}" for name in names)
    return f" at {shortened(listed)}" if names else ""
