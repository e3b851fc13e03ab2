"""The mass matrix of a model: where it has an inverse, and in which order its rows give it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import (
    connected_components,
    maximum_bipartite_matching,
    min_weight_full_bipartite_matching,
)

from jaxsr._quoting import shortened
from jaxsr._result import InputError
from jaxsr.expressions import Term, evaluate
from jaxsr.models.model import Model

_POINTS = 64
_ENOUGH = 8  # points with finite entries that a verdict needs
_SINGULAR = 1e-13  # least singular value by the greatest, rows and columns scaled
_LARGEST = 60  # rows of a block of which singular values are taken
_NOTHING = -700.0  # logarithm that stands for that of zero
_PREFERRED = 1e-6  # by how much the diagonal is favoured: of equals, no row moves

Samples = dict[tuple[int, int], np.ndarray]
"""Entries by row and column, each at random points; entries that are nothing are absent."""


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
    entries = _samples(model, rows)
    with_mass = [{pair[axis] for pair in entries} for axis in (0, 1)]
    for i, row in enumerate(rows):
        if i not in with_mass[0]:
            what = f"the row has no mass for the rates of {_listed(rows)}{_values(model, row)}"
            raise InputError(what, f"[inertia] {row}", "Give it a mass other than zero")
        if i not in with_mass[1]:
            what = f"no row has a mass for the rate of {row}"
            raise InputError(what, "[inertia]", f"Write {row} = {{ {row} = ... }}")
    pattern = _sparse(dict.fromkeys(entries, 1.0), len(rows))
    _, block_of = connected_components(pattern, directed=False)
    unmatched = np.flatnonzero(maximum_bipartite_matching(pattern) < 0)
    singular = set(block_of[unmatched])
    for block, size in enumerate(np.bincount(block_of)):
        if 1 < size <= _LARGEST and _without_inverse(entries, np.flatnonzero(block_of == block)):
            singular.add(block)
    if singular:
        own = tuple(r for r, b in zip(rows, block_of, strict=True) if b == min(singular))
        what = f"the rows of {_listed(own)} make a singular matrix at the given values"
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
    if _symmetric(model):
        return rows
    scores = {}
    for (i, j), values in _samples(model, rows).items():
        with np.errstate(all="ignore"):
            sizes = np.log(np.abs(values[~np.isnan(values)]))
        mean = np.clip(sizes, _NOTHING, -_NOTHING).mean() if sizes.size else _NOTHING
        # Every order takes as many entries, so that a shift keeps the best; none may be zero.
        scores[i, j] = 1.0 - 2.0 * _NOTHING + mean + _PREFERRED * (i == j)
    try:
        row, column = min_weight_full_bipartite_matching(_sparse(scores, len(rows)), maximize=True)
    except ValueError:  # no order has entries all along the diagonal
        return rows
    return tuple(rows[i] for i in row[np.argsort(column)])


def _symmetric(model: Model) -> bool:
    """Whether every row has an entry on the diagonal, and entries across it read the same."""
    inertia = model.inertia
    return all(
        i in row and all(j not in inertia or inertia[j].get(i) == text for j, text in row.items())
        for i, row in inertia.items()
    )


def _sparse(entries: dict[tuple[int, int], float], count: int) -> csr_array:
    rows, columns = zip(*entries, strict=True) if entries else ((), ())
    return csr_array((list(entries.values()), (rows, columns)), shape=(count, count))


def _samples(model: Model, rows: tuple[str, ...]) -> Samples:
    """Return the entries of the matrix at random states, inputs and times."""
    rng = np.random.default_rng(0)
    values = {name: p.value for name, p in model.parameters.items()}
    values |= {name: next(iter(own.values())) for name, own in model.per_recording.items() if own}
    environment = {name: np.full(_POINTS, value) for name, value in values.items()}
    for name in (model.time, *model.states, *model.inputs):
        size = 10.0 ** rng.uniform(-3.0, 3.0, _POINTS)
        environment[name] = size * rng.choice([-1.0, 1.0], _POINTS)
    place = {row: i for i, row in enumerate(rows)}
    found: Samples = {}
    shared: dict[Term, np.ndarray] = {}
    with np.errstate(all="ignore"):
        for row in rows:
            for column, term in model.inertia_terms[row].items():
                if column in place:
                    value = np.full(_POINTS, evaluate(term, environment, "numpy", shared))
                    if (value != 0.0).any():  # NaN counts as something
                        found[place[row], place[column]] = value
    return found


def _without_inverse(entries: Samples, block: np.ndarray) -> bool:
    """Tell whether a block of the matrix has no inverse at any point."""
    place = {int(row): i for i, row in enumerate(block)}
    matrices = np.zeros((_POINTS, len(block), len(block)))
    for i, a in place.items():
        for j, b in place.items():
            if (i, j) in entries:
                matrices[:, a, b] = entries[i, j]
    scaled = matrices[np.isfinite(matrices).all(axis=(1, 2))]
    if len(scaled) < _ENOUGH:
        return False
    for axis in (2, 1, 2):
        size = np.abs(scaled).max(axis=axis, keepdims=True)
        scaled = scaled / np.where(size > 0.0, size, 1.0)
    values = np.linalg.svd(scaled, compute_uv=False)
    return bool((values[:, -1] <= _SINGULAR * values[:, 0]).all())


def _listed(names: tuple[str, ...]) -> str:
    return shortened(", ".join(names))


def _values(model: Model, row: str) -> str:
    """Return the values of the parameters in a row, in words for a message."""
    used = frozenset[str]().union(*(t.variables for t in model.inertia_terms[row].values()))
    values = [f"{n} = {p.value:g}" for n, p in model.parameters.items() if n in used]
    return f" at {shortened(', '.join(values))}" if values else ""
