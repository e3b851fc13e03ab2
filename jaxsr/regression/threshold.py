"""Hard thresholding with a check on the residual (paper Eq. 12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jaxsr._result import InputError
from jaxsr.regression.digits import rounded
from jaxsr.regression.gram import Array, GramBatch
from jaxsr.regression.ridge import solve_many

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class HardThreshold:
    r"""Remove the terms whose coefficients are negligible and whose removal costs nothing.

    Candidates for removal are

    .. math:: \mathcal K = \{F_k \mid |\xi_k| \le \sigma\,\max_j |\xi_j|\};

    they go together if the residual sum of squares rises by at most ``tolerance`` of itself, else
    one by one in the order of what they cost, as long as that holds.

    Parameters
    ----------
    sigma : float
        Threshold :math:`\sigma`, in [0, 1).
    tolerance : float
        Relative rise of the residual sum of squares that counts as neglectable.
    floor : float
        Residual, relative to :math:`y^T y`, below which a fit is exact to rounding; a rise that
        stays under it counts as none.

    References
    ----------
    Askari and Crevecoeur, section 4.3. They compare raw coefficients; the columns here have unit
    norm, so a term is judged by its share of the equation whatever its unit.
    """

    sigma: float = 1e-4
    tolerance: float = 1e-3
    floor: float = 1e-14

    def __post_init__(self) -> None:
        if not 0.0 <= self.sigma < 1.0:
            raise InputError(f"sigma must lie in [0, 1), got {self.sigma}", "HardThreshold")
        if self.tolerance < 0.0 or self.floor < 0.0:
            raise InputError("tolerance and floor must not be negative", "HardThreshold")

    def keep(self, matrix: Array, moment: Array, total: float, ridge: float = 1e-10) -> list[int]:
        """Return the positions of the terms that stay, at least one.

        Parameters
        ----------
        matrix : ndarray, (terms, terms)
            Gram matrix of unit-norm columns.
        moment : ndarray, (terms,)
        total : float
            :math:`y^T y`.
        """
        used = np.ones((1, len(moment)), dtype=bool)
        gram = GramBatch(np.asarray(matrix)[None], np.asarray(moment)[None], used, total)
        return np.flatnonzero(self.keep_many(gram, ridge)[0]).tolist()

    def keep_many(self, gram: GramBatch, ridge: float = 1e-10) -> Mask:
        """Return which terms of every individual stay, at least one of each that has any.

        Every round solves all individuals that still lose terms at once; what becomes of one does
        not depend on the others.

        Returns
        -------
        ndarray of bool, (individuals, terms)
        """
        kept = gram.used.copy()
        size, rss = _solve(gram, np.arange(len(kept)), kept, ridge)
        allowed = np.maximum(rss * (1.0 + self.tolerance), self.floor * gram.total)
        rows = np.arange(len(kept))
        while len(rows):
            small = self._small(size, kept[rows])
            going = np.any(small, axis=1)
            rows, small = rows[going], small[going]
            out, cost = _cheapest(gram, rows, kept, small, allowed[rows], ridge)
            loses = cost <= allowed[rows]
            rows = rows[loses]
            kept[rows] &= ~out[loses]
            size, _ = _solve(gram, rows, kept[rows], ridge)
        return kept

    def _small(self, size: Array, kept: Mask) -> Mask:
        """Return the terms that may go: negligible, the last of a set never among them."""
        limit = self.sigma * np.max(size, axis=1, initial=0.0)
        small = kept & (size <= limit[:, None])  # none where a system has no solution
        return small & (np.cumsum(small, axis=1) < np.sum(kept, axis=1)[:, None])


def _cheapest(
    gram: GramBatch, rows: NDArray[np.intp], kept: Mask, small: Mask, allowed: Array, ridge: float
) -> tuple[Mask, Array]:
    """Return what each individual loses, and the residual without it.

    That is all its small terms at once; where that costs too much, the one that costs least.
    """
    out = small.copy()
    _, cost = _solve(gram, rows, kept[rows] & ~small, ridge)
    many = np.flatnonzero((cost > allowed) & (np.sum(small, axis=1) > 1))
    at, term = np.nonzero(small[many])
    single = np.zeros((len(at), small.shape[1]), dtype=bool)
    single[np.arange(len(at)), term] = True
    _, costs = _solve(gram, rows[many][at], kept[rows[many]][at] & ~single, ridge)
    least = np.full(small[many].shape, np.inf)
    least[at, term] = costs
    best = np.argmin(rounded(least), axis=1)  # the first of equals
    out[many] = np.arange(small.shape[1]) == best[:, None]
    cost[many] = least[np.arange(len(many)), best]
    return out, cost


def _solve(
    gram: GramBatch, rows: NDArray[np.intp], kept: Mask, ridge: float
) -> tuple[Array, Array]:
    """Return sizes of coefficients (rows, terms), 0 where not kept, and residual sums of squares.

    A system without a solution has NaN for its coefficients and an infinite residual.
    """
    size, rss = np.zeros(kept.shape), np.full(len(rows), gram.total)
    counts = np.sum(kept, axis=1)
    for count in np.unique(counts[counts > 0]).tolist():
        who = np.flatnonzero(counts == count)
        places = np.nonzero(kept[who])[1].reshape(-1, count)
        own = rows[who][:, None]
        block = gram.matrix[own[:, :, None], places[:, :, None], places[:, None, :]]
        b = gram.moment[own, places]
        xi = solve_many(block + ridge * np.eye(count), b)
        size[who[:, None], places] = np.abs(xi)
        fitted = (block @ xi[:, :, None])[:, :, 0]
        rss[who] = np.maximum(gram.total + np.sum(xi * (fitted - 2.0 * b), axis=1), 0.0)
    return size, np.where(np.isnan(rss), np.inf, rss)
