"""Backward elimination: the chain of sets that lose their least useful term one by one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxsr.expressions.term import Term

if TYPE_CHECKING:
    from jaxsr.regression.problem import RegressionProblem

_DEPENDENT = 1e-11  # diagonal of R, relative to unit columns, below which a column is dependent


def eliminate(
    problem: RegressionProblem, terms: Sequence[Term], most: int
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
    theta = problem.projected(terms, keep=True)
    with np.errstate(all="ignore"):
        norms = np.linalg.norm(theta, axis=0)
    usable = np.isfinite(norms) & (norms > 1e-100) & (norms < 1e100)
    kept = [term for term, ok in zip(terms, usable, strict=True) if ok][: problem.rows]
    columns = (theta[:, usable] / norms[usable])[:, : problem.rows]
    if not kept:
        return []
    basis, upper = np.linalg.qr(columns)
    free = np.abs(np.diag(upper)) > _DEPENDENT
    kept = [term for term, ok in zip(kept, free, strict=True) if ok]
    basis, upper = np.linalg.qr(columns[:, free])
    share = basis.T @ problem.target
    rest = problem.target - basis @ share
    lost = float(rest @ rest)
    total = problem.total or 1.0
    chain: list[tuple[tuple[Term, ...], float]] = []
    while kept:
        if len(kept) <= most:
            chain.append((tuple(kept), lost / total))
        if len(kept) == 1:
            break
        inverse = np.linalg.inv(upper)
        cost = (inverse @ share) ** 2 / np.sum(inverse**2, axis=1)
        out = int(np.argmin(cost))
        del kept[out]
        turn, upper = np.linalg.qr(np.delete(upper, out, axis=1))
        before = float(share @ share)
        share = turn.T @ share
        lost += max(before - float(share @ share), 0.0)
    return _signed(problem, chain)


def _signed(
    problem: RegressionProblem, chain: list[tuple[tuple[Term, ...], float]]
) -> list[tuple[tuple[Term, ...], float]]:
    """Weigh again, within the signs, the sets that have some."""
    if not any(term in problem.signs for terms, _ in chain for term in terms):
        return chain
    _, losses = problem.solve([terms for terms, _ in chain])
    pairs = zip(chain, losses, strict=True)
    return [(terms, max(float(loss), free)) for (terms, free), loss in pairs]
