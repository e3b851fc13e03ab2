"""Backward elimination: the chain of sets that lose their least useful term one by one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jaxsr.expressions.term import Term
from jaxsr.regression.digits import rounded
from jaxsr.regression.gram import Array
from jaxsr.regression.linear import LinearProblem
from jaxsr.regression.store import DEPENDENT

_ROWS = 8192  # factored at once
_DEPENDENT = 1e-11  # diagonal of R, relative to unit columns, below which a column is dependent


def eliminate(
    problem: LinearProblem, terms: Sequence[Term], most: int
) -> list[tuple[tuple[Term, ...], float]]:
    r"""Remove the terms of a set one by one, each time the one that is missed least.

    With :math:`\Theta = QR` in columns of unit norm, leaving out term j raises the residual sum
    of squares by :math:`\xi_j^2 / \|(R^{-1})_{j\cdot}\|^2`; the condition number is never squared.

    Parameters
    ----------
    terms : sequence of Term
        At most as many as there are rows; those without finite columns, or not
        admitted, are left out.
    most : int
        Sets of at most so many terms are returned.

    Returns
    -------
    list of (terms, loss)
        Largest first, down to one term; the loss is relative to the target's.
    """
    terms = [term for term in terms if problem.admitted([term])]
    theta = problem.columns(terms, keep=True)
    with np.errstate(all="ignore"):
        least = DEPENDENT * np.linalg.norm(theta, axis=0)
        theta = problem.project(theta)
        norms = np.linalg.norm(theta, axis=0)
    usable = np.flatnonzero((norms > np.maximum(least, 1e-100)) & (norms < 1e100))
    usable = usable[: problem.rows]
    if not len(usable):
        return []
    triangle = _triangle(theta, usable, norms, problem.target)
    free = np.abs(np.diag(triangle)[:-1]) > _DEPENDENT
    kept = [terms[k] for k in usable[free]]
    triangle = _upper(triangle[:, [*np.flatnonzero(free), len(usable)]])
    upper, share = triangle[:-1, :-1], triangle[:-1, -1]
    lost = float(triangle[-1, -1] ** 2)
    total = problem.total or 1.0
    chain: list[tuple[tuple[Term, ...], float]] = []
    while kept:
        if len(kept) <= most:
            chain.append((tuple(kept), lost / total))
        if len(kept) == 1:
            break
        inverse = np.linalg.inv(upper)
        cost = (inverse @ share) ** 2 / np.sum(inverse**2, axis=1)
        out = int(np.argmin(rounded(cost)))
        del kept[out]
        turn, upper = np.linalg.qr(np.delete(upper, out, axis=1))
        before = float(share @ share)
        share = turn.T @ share
        lost += max(before - float(share @ share), 0.0)
    return _signed(problem, chain)


def _triangle(theta: Array, places: NDArray[np.intp], norms: Array, target: Array) -> Array:
    """Return the triangular factor of some columns at unit norm and of the target behind them.

    Rows are taken in pieces, so that no other matrix as long as ``theta`` is made.
    """
    count = len(places) + 1
    factor = np.zeros((count, count))  # a target in the columns' span has a zero at the end
    for first in range(0, len(target), _ROWS):
        part = slice(first, first + _ROWS)
        columns = theta[part][:, places] / norms[places]
        rows = np.vstack([factor, np.column_stack([columns, target[part]])])
        factor = _upper(rows)
    return factor


def _upper(matrix: Array) -> Array:
    return np.asarray(np.linalg.qr(matrix, mode="r"), np.float64)


def _signed(
    problem: LinearProblem, chain: list[tuple[tuple[Term, ...], float]]
) -> list[tuple[tuple[Term, ...], float]]:
    """Weigh again, within the signs, the sets that have some."""
    if not any(term in problem.signs for terms, _ in chain for term in terms):
        return chain
    _, losses = problem.solve([terms for terms, _ in chain])
    pairs = zip(chain, losses, strict=True)
    return [(terms, max(float(loss), free)) for (terms, free), loss in pairs]
