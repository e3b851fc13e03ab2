"""Models that can never run: rates that are no numbers, and mass matrices without an inverse."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate
from jaxsr.expressions.printing import excerpt
from jaxsr.models.model import Model

Values = Mapping[str, float]
_POINTS = 64
_ENOUGH = 8  # points with finite entries that a verdict on a mass matrix needs
_SINGULAR = 1e-13  # least singular value by the greatest, rows and columns scaled
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
    if model.inertia:
        _check_inertia(model, values)


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


def _check_inertia(model: Model, values: Values) -> None:
    rows = tuple(s for s in model.states if s in model.inertia)
    matrices = inertia_samples(model, rows)
    empty = ~(matrices != 0.0).any(axis=0)  # NaN counts as something
    for i, row in enumerate(rows):
        if empty[i].all():
            terms = model.inertia_terms[row]
            given = next((_given(t, values) for j, t in terms.items() if j in rows), "")
            what = f"the row multiplies no rate of {', '.join(rows)} by anything but zero{given}"
            raise InputError(what, f"[inertia] {row}", "Give it a mass other than zero")
        if empty[:, i].all():
            what = f"no row holds the rate of {row}"
            raise InputError(what, "[inertia]", f"Write {row} = {{ {row} = ... }}")
    usable = np.isfinite(matrices).all(axis=(1, 2))
    if usable.sum() >= _ENOUGH and _singular(matrices[usable]).all():
        what = f"the rows of {shortened(', '.join(rows))} make a singular matrix"
        remedy = "Make the rows independent: every rate must follow from the forces"
        raise InputError(what, "[inertia]", remedy)


def inertia_samples(model: Model, rows: Sequence[str]) -> np.ndarray:
    """Return the mass matrix at random states, inputs and times of many magnitudes.

    Parameters
    ----------
    model : Model
    rows : sequence of str
        States with a row in [inertia], which are the rows and the columns.

    Returns
    -------
    ndarray, shape (points, rows, rows)
    """
    rng = np.random.default_rng(0)
    environment = {name: np.float64(p.value) for name, p in model.parameters.items()}
    for name in (model.time, *model.states, *model.inputs):
        size = 10.0 ** rng.uniform(-3.0, 3.0, _POINTS)
        environment[name] = size * rng.choice([-1.0, 1.0], _POINTS)
    found = np.zeros((_POINTS, len(rows), len(rows)))
    shared: dict[Term, np.ndarray] = {}
    with np.errstate(all="ignore"):
        for i, row in enumerate(rows):
            for column, term in model.inertia_terms[row].items():
                if column in rows:
                    found[:, i, rows.index(column)] = evaluate(term, environment, "numpy", shared)
    return found


def _singular(matrices: np.ndarray) -> np.ndarray:
    """Tell which of some finite matrices, shape (count, n, n), have no inverse."""
    scaled = matrices
    for axis in (2, 1, 2):
        size = np.abs(scaled).max(axis=axis, keepdims=True)
        scaled = scaled / np.where(size > 0.0, size, 1.0)
    values = np.linalg.svd(scaled, compute_uv=False)
    return values[:, -1] <= _SINGULAR * values[:, 0]
