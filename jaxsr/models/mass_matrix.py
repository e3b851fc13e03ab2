"""The mass matrix of a model: where it has an inverse, and in which order its rows give it."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate
from jaxsr.models.model import Model

_POINTS = 64
_ENOUGH = 8  # points with finite entries that a verdict needs
_SINGULAR = 1e-13  # least singular value by the greatest, rows and columns scaled
_NOTHING = -700.0  # logarithm that stands for that of zero
_PREFERRED = 1e-6  # by how much the diagonal is favoured: of equals, no row moves


def check_invertible(model: Model) -> None:
    """Refuse a mass matrix that has no inverse at the given values, whatever the states are.

    Raises
    ------
    InputError
        A row or a column is nothing, or the rows depend on each other.
    """
    rows = tuple(s for s in model.states if s in model.inertia)
    if not rows:
        return
    matrices = _samples(model, rows)
    empty = ~(matrices != 0.0).any(axis=0)  # NaN counts as something
    for i, row in enumerate(rows):
        if empty[i].all():
            what = f"the row has no mass for the rates of {_listed(rows)}{_values(model, row)}"
            raise InputError(what, f"[inertia] {row}", "Give it a mass other than zero")
        if empty[:, i].all():
            what = f"no row has a mass for the rate of {row}"
            raise InputError(what, "[inertia]", f"Write {row} = {{ {row} = ... }}")
    usable = np.isfinite(matrices).all(axis=(1, 2))
    if usable.sum() >= _ENOUGH and _singular(matrices[usable]).all():
        what = f"the rows of {_listed(rows)} make a singular matrix at the given values"
        remedy = "Make the rows independent: every rate must follow from the forces"
        raise InputError(what, "[inertia]", remedy)


def pivoted_rows(model: Model) -> tuple[str, ...]:
    """Return the states with a row in [inertia], in an order in which no pivot vanishes.

    The columns stay in the order of the states. Among all orders this one has the greatest
    product on the diagonal, at random states of many magnitudes: that of a positive definite
    matrix is as it stands.

    References
    ----------
    Duff & Koster, "On algorithms for permuting large entries to the diagonal of a sparse
    matrix", SIAM J. Matrix Anal. Appl. 22 (2001).
    """
    rows = tuple(s for s in model.states if s in model.inertia)
    if _symmetric(model, rows):
        return rows
    with np.errstate(all="ignore"):
        sizes = np.log(np.abs(_samples(model, rows)))
    sizes = sizes[~np.isnan(sizes).any(axis=(1, 2))]
    if not len(sizes):
        return rows
    score = np.clip(sizes, _NOTHING, -_NOTHING).mean(axis=0) + _PREFERRED * np.eye(len(rows))
    row, column = linear_sum_assignment(score, maximize=True)
    return tuple(rows[i] for i in row[np.argsort(column)])


def _symmetric(model: Model, rows: tuple[str, ...]) -> bool:
    """Whether every row has an entry on the diagonal, and entries across it read the same."""
    return all(
        i in model.inertia[i]
        and all(model.inertia[j].get(i) == model.inertia[i].get(j) for j in rows)
        for i in rows
    )


def _samples(model: Model, rows: tuple[str, ...]) -> np.ndarray:
    """Return the matrix at random states, inputs and times, shape (points, rows, rows)."""
    rng = np.random.default_rng(0)
    values = {name: p.value for name, p in model.parameters.items()}
    values |= {name: next(iter(own.values())) for name, own in model.per_recording.items() if own}
    environment = {name: np.full(_POINTS, value) for name, value in values.items()}
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


def _listed(names: tuple[str, ...]) -> str:
    return shortened(", ".join(names))


def _values(model: Model, row: str) -> str:
    """Return the values of the parameters in a row, in words for a message."""
    used = frozenset[str]().union(*(t.variables for t in model.inertia_terms[row].values()))
    values = [f"{n} = {p.value:g}" for n, p in model.parameters.items() if n in used]
    return f" at {shortened(', '.join(values))}" if values else ""
