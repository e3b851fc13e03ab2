"""Models that can never run: rates that are no numbers, and mass matrices without an inverse."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.expressions import PRIMITIVES, Term
from jaxsr.expressions.printing import excerpt
from jaxsr.models.mass_matrix import check_invertible
from jaxsr.models.model import Model

Values = Mapping[str, float]
# What stays without a finite value whatever the finite value of another argument is.
_SPREADING = frozenset({"add", "sub", "mul", "neg", "abs"})


def check_solvable(model: Model) -> None:
    """Refuse a model whose rates or readings are no numbers whatever its states are.

    What depends on states, inputs or time is left to the simulation; what constants and given
    parameter values decide is decided here.

    Raises
    ------
    InputError
        An expression is infinite or NaN at the given values, or the mass matrix is singular.
    """
    # Where a recording has its own value, that of [parameters] may never be used.
    own = model.per_recording
    values = {name: p.value for name, p in model.parameters.items() if name not in own}
    places = [(f"[equations] {s}", e) for s, e in model.equation_terms.items()]
    places += [
        (f"[inertia] {i}.{j}", e) for i, row in model.inertia_terms.items() for j, e in row.items()
    ]
    places += [(f"[readings] {y}", e) for y, e in model.reading_terms.items()]
    met: dict[Term, _Known] = {}
    for where, term in places:
        culprit = never_finite(term, values, met)
        if culprit is not None:
            what = f"{excerpt(culprit)!r} has no finite value{_given(culprit, values)}"
            raise InputError(what, where, "Change the value or the expression")
    _check_clocks(model, values, met)
    check_invertible(model)


def _check_clocks(model: Model, values: Values, met: dict[Term, _Known]) -> None:
    for output, text in model.clock.items():
        where = f"[clock] {output}"
        term = model.term(text, where)
        never_finite(term, values, met)
        rate = _of(term, values, met).value
        if rate is not None and not 0.0 < rate < math.inf:
            what = f"{excerpt(term)!r} is {rate:g}{_given(term, values)}"
            raise InputError(what, where, "Write the rate of the clock: 1 for one that is right")


class _Known(NamedTuple):
    """What constants and parameters decide of a term: its value, or what leaves it without."""

    value: float | None = None
    culprit: Term | None = None


def never_finite(term: Term, values: Values, met: dict[Term, _Known] | None = None) -> Term | None:
    """Return the part of a term that makes it infinite or NaN for all states; None if none does.

    Parameters
    ----------
    term : Term
    values : mapping of str to float
        Values of the parameters.
    met : dict, optional
        Subtrees met before; filled on the way.
    """
    met = {} if met is None else met
    with np.errstate(all="ignore"):
        for node in term.upward(met):
            met[node] = _known(node, [_of(arg, values, met) for arg in node.args])
    return _of(term, values, met).culprit


def _of(term: Term, values: Values, met: Mapping[Term, _Known]) -> _Known:
    if term.args:
        return met[term]
    if term.is_variable:
        return _Known(values.get(term.name))
    return _Known(term.value)


def _known(term: Term, args: Sequence[_Known]) -> _Known:
    first = next((arg.culprit for arg in args if arg.culprit is not None), None)
    fixed = [np.float64(arg.value) for arg in args if arg.value is not None]
    if len(fixed) == len(args):
        value = float(PRIMITIVES[term.op].numpy(*fixed))
        return _Known(value, None if math.isfinite(value) else first or term)
    if term.op == "div":
        if args[1].value == 0.0:
            return _Known(culprit=term)
        return _Known(culprit=args[0].culprit)
    # An argument that is not chosen, as of Piecewise, does no harm, nor does infinity in a tanh.
    return _Known(culprit=first if term.op in _SPREADING else None)


def _given(term: Term, values: Values) -> str:
    """Return the values of the parameters in a term, in words for a message."""
    names = [name for name in values if name in term.variables]
    listed = ", ".join(f"{name} = {values[name]:g}" for name in names)
    return f" at {shortened(listed)}" if names else ""
