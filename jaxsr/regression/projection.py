r"""Fits of many sets of terms as functions of their inner constants.

Coefficients enter linearly, so a set's loss is a function of its inner constants alone,
:math:`\| P^\perp_{\Theta(c)}\, y \|^2` (variable projection). Columns without constants are
projected out once (Frisch-Waugh); only the others move.

References
----------
Golub and Pereyra (1973), SIAM J. Numer. Anal. 10, 413-432.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array
from jaxsr.regression.linear import LinearProblem, View
from jaxsr.regression.slopes import ColumnOf, Form, constants_of

Mask = NDArray[np.bool_]
Places = NDArray[np.intp]

# A column that keeps less than this of its norm beside the others depends on them.
_DEPENDENT = 1e-6
_CHUNK_BYTES = 64 * 2**20


@dataclass(frozen=True, slots=True)
class _Group:
    """Moving terms of one form: their set, their place among its moving terms, its constants."""

    form: Form
    sets: Places
    terms: Places
    constants: Places


@dataclass(frozen=True, slots=True)
class Sets:
    """Sets of terms padded to common numbers of moving terms and constants.

    Attributes
    ----------
    start : ndarray, (sets, constants)
    used : ndarray of bool, (sets, terms)
    owner : ndarray of int, (sets, constants)
        The moving term that a constant stands in.
    basis : ndarray, (sets, still terms, rows)
        Orthonormal rows: what does not move.
    target : ndarray, (sets, rows)
        Target without what the basis explains.
    usable : ndarray of bool, (sets,)
    """

    groups: tuple[_Group, ...]
    start: Array
    used: Mask
    owner: Places
    basis: Array
    target: Array
    usable: Mask
    column_of: ColumnOf
    view: View
    samples: int
    threads: int | None

    def seen(self, columns: Array) -> Array:
        """Return columns (..., samples) in the view, without the fixed ones: (..., rows)."""
        flat = columns.reshape(-1, columns.shape[-1])
        if not len(flat):
            return np.zeros((*columns.shape[:-1], self.target.shape[1]))
        with np.errstate(over="ignore", invalid="ignore"):  # finite samples, too large to add
            return self.view(flat.T).T.reshape(*columns.shape[:-1], -1)


@dataclass(slots=True)
class Point:
    """Fits at given constants.

    Attributes
    ----------
    basis : ndarray, (sets, terms, rows)
        Orthonormal rows spanning the moving terms beside the still ones.
    xi : ndarray, (sets, terms)
        Coefficients of the moving terms.
    residual : ndarray, (sets, rows)
    loss : ndarray, (sets,)
        Residual sum of squares; inf where a term is not finite or depends on the others.
    slopes : ndarray, (sets, constants, samples)
        d column / d constant, before the view.
    """

    basis: Array
    xi: Array
    residual: Array
    loss: Array
    slopes: Array

    @property
    def unsure(self) -> Mask:
        """Nothing is: columns are orthogonalised themselves."""
        return np.zeros(len(self.loss), dtype=bool)

    def update(self, where: Places, other: Point, rows: Places) -> None:
        """Take over ``rows`` of another point at ``where``."""
        for name in ("basis", "xi", "residual", "loss", "slopes"):
            getattr(self, name)[where] = getattr(other, name)[rows]


def batches(
    problem: LinearProblem, sets: Sequence[Sequence[Term]], most_constants: int
) -> Iterator[tuple[list[int], Sets]]:
    """Yield positions in ``sets`` and their padded batch: little padding, few passes.

    Sets with more than ``most_constants`` constants are held still.
    """
    counts = [sum(len(constants_of(t)) for t in terms) for terms in sets]
    counts = [count if count <= most_constants else 0 for count in counts]
    buckets: dict[int, list[int]] = {}
    for place, count in enumerate(counts):
        buckets.setdefault((count > 0) + (count > 3), []).append(place)
    widest = max((len(terms) for terms in sets), default=1)
    step = max(1, _CHUNK_BYTES // (8 * problem.rows * (3 * widest + 10)))
    for members in buckets.values():
        for first in range(0, len(members), step):
            problem.check()
            part = members[first : first + step]
            moving = [
                [j for j, term in enumerate(sets[k]) if counts[k] and constants_of(term)]
                for k in part
            ]
            yield part, prepare(problem, [sets[k] for k in part], moving)


def prepare(
    problem: LinearProblem, sets: Sequence[Sequence[Term]], moving: Sequence[Sequence[int]]
) -> Sets:
    """Pad the sets and project out the terms that do not move."""
    count = len(sets)
    most_terms = max((len(m) for m in moving), default=0)
    start_of = [
        [c for k in places for c in constants_of(terms[k])]
        for terms, places in zip(sets, moving, strict=True)
    ]
    most = max(map(len, start_of), default=0)
    start, used = np.zeros((count, most)), np.zeros((count, most_terms), dtype=bool)
    owner = np.zeros((count, most), dtype=np.intp)
    members: dict[Form, list[tuple[int, int, list[int]]]] = {}
    for row, (terms, places) in enumerate(zip(sets, moving, strict=True)):
        position = 0
        start[row, : len(start_of[row])] = start_of[row]
        used[row, : len(places)] = True
        for slot, k in enumerate(places):
            form = Form.of(terms[k])
            span = list(range(position, position + form.constants))
            owner[row, span] = slot
            members.setdefault(form, []).append((row, slot, span))
            position += form.constants
    groups = tuple(
        _Group(form, *(np.array(part, dtype=np.intp) for part in zip(*rows_of, strict=True)))
        for form, rows_of in members.items()
    )
    basis, target, usable = _still(problem, sets, moving)
    return Sets(
        groups,
        start,
        used,
        owner,
        basis,
        target,
        usable,
        problem.evaluator.column,
        problem.seen,
        problem.samples,
        problem.evaluator.threads,
    )


def _still(
    problem: LinearProblem, sets: Sequence[Sequence[Term]], moving: Sequence[Sequence[int]]
) -> tuple[Array, Array, Mask]:
    """Return an orthonormal basis of the terms that do not move, and the target beside it."""
    count, rows = len(sets), problem.rows
    still = [[t for k, t in enumerate(s) if k not in m] for s, m in zip(sets, moving, strict=True)]
    flat = list(dict.fromkeys(term for terms in still for term in terms))
    columns = problem.seen(problem.evaluator.columns(flat)).T if flat else np.zeros((0, rows))
    place = {term: k for k, term in enumerate(flat)}
    width = max(map(len, still), default=0)
    stacked, present = np.zeros((count, width, rows)), np.zeros((count, width), dtype=bool)
    for row, terms in enumerate(still):
        present[row, : len(terms)] = True
        stacked[row, : len(terms)] = columns[[place[t] for t in terms]]
    none = np.zeros((count, 0, rows))
    basis, _, usable = orthonormal(stacked, present, none)
    target = np.broadcast_to(problem.target, (count, rows)).copy()
    return basis, without(target[:, None], basis)[:, 0], usable


def without(columns: Array, basis: Array) -> Array:
    """Project columns (sets, k, rows) off a basis, twice: once leaves rounding behind."""
    for _ in range(2 if basis.shape[1] else 0):
        columns = columns - (columns @ basis.transpose(0, 2, 1)) @ basis
    return columns


def orthonormal(columns: Array, used: Mask, beside: Array) -> tuple[Array, Array, Mask]:
    """Factor columns = upper^T basis by Gram-Schmidt with re-orthogonalisation.

    Parameters
    ----------
    columns : ndarray, (sets, k, rows)
    used : ndarray of bool, (sets, k)
        Unused ones have a zero basis vector and a one on the diagonal of ``upper``.
    beside : ndarray, (sets, p, rows)
        Orthonormal vectors to project off first.

    Returns
    -------
    basis : ndarray, (sets, k, rows)
    upper : ndarray, (sets, k, k)
    usable : ndarray of bool, (sets,)
        Where every column is finite and depends on no other.
    """
    count, width, rows = columns.shape
    size = np.maximum(columns.max(axis=2, initial=0.0), -columns.min(axis=2, initial=0.0))
    good = ~used | ((size < 1e100) & (size > 1e-100))
    asked = used & good
    safe = columns if np.all(asked) else np.where(asked[:, :, None], columns, 0.0)
    norms = np.sqrt(np.vecdot(safe, safe))
    norms = np.where(norms > 0.0, norms, 1.0)
    left = without(safe / norms[:, :, None], beside)
    basis, upper = np.zeros((count, width, rows)), np.zeros((count, width, width))
    usable = np.all(good, axis=1)
    for k in range(width):
        vector = left[:, k]
        for _ in range(2 if k else 0):
            shares = (basis[:, :k] @ vector[:, :, None])[:, :, 0]
            upper[:, :k, k] += shares
            vector = vector - (shares[:, None, :] @ basis[:, :k])[:, 0]
        length = np.linalg.norm(vector, axis=1)
        present = used[:, k] & (length > _DEPENDENT)
        usable &= ~used[:, k] | present
        upper[:, k, k] = np.where(present, length, 1.0)
        basis[:, k] = np.where(present[:, None], vector / upper[:, k, k, None], 0.0)
    return basis, upper * norms[:, None, :], usable


def evaluate(batch: Sets, constants: Array, rows: Places) -> Point:
    """Fit the sets ``rows`` at ``constants`` (rows, constants)."""
    count, most = len(rows), batch.start.shape[1]
    here = np.full(len(batch.start), -1, dtype=np.intp)
    here[rows] = np.arange(count)
    columns = np.zeros((count, batch.used.shape[1], batch.samples))
    slopes = np.zeros((count, most, batch.samples))
    for group in batch.groups:
        asked = here[group.sets] >= 0
        if np.any(asked):
            at, places = here[group.sets[asked]], group.constants[asked]
            form, own = group.form, constants[at[:, None], places]
            pieces = form.pieces(own, batch.column_of, batch.samples, batch.threads)
            for part, value, tangents in pieces:
                columns[at, group.terms[asked], part] = value
                for place, slope in tangents.items():
                    slopes[at, places[:, place], part] = slope
    seen = batch.seen(columns)
    basis, upper, usable = orthonormal(seen, batch.used[rows], batch.basis[rows])
    target = batch.target[rows]
    shares = (basis @ target[:, :, None])[:, :, 0]
    residual = without(target[:, None], basis)[:, 0]
    xi = np.asarray(np.linalg.solve(upper, shares[:, :, None])[:, :, 0], np.float64)
    loss = np.einsum("br,br->b", residual, residual)
    return Point(basis, xi, residual, np.where(usable & batch.usable[rows], loss, np.inf), slopes)
