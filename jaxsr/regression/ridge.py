"""Ridge regression of many individuals, batched by their number of terms (paper section 4.4)."""

from __future__ import annotations

import numpy as np

from jaxsr.regression.gram import Array, GramBatch


def solve_ridge(gram: GramBatch, ridge: float = 1e-10) -> Array:
    r"""Solve :math:`(G + \lambda I)\,\xi = b` for every individual in float64.

    Individuals with the same number of terms are solved in one call of LAPACK, none padded to a
    larger one, and each by itself: a solution's last bit does not depend on the others.

    Parameters
    ----------
    gram : GramBatch
        Normal equations in columns of unit norm, so one ``ridge`` suits all terms.
    ridge : float
        :math:`\lambda`, relative to a squared column norm of one.

    Returns
    -------
    ndarray, (individuals, terms)
        Coefficients of the unit-norm columns; zero in unused slots. A singular system comes back
        as NaN, for the caller to reject.

    References
    ----------
    Askari and Crevecoeur, Eqs. 17 and 18 with :math:`J = \|\xi\|_2^2`.
    """
    individuals, terms = gram.moment.shape
    xi = np.zeros((individuals, terms))
    slots = np.arange(1, terms + 1)
    width = np.max(np.where(gram.used, slots, 0), axis=1, initial=0)  # to the last slot used
    for size in np.unique(width[width > 0]).tolist():
        rows = np.flatnonzero(width == size)
        xi[rows, :size] = solve_many(
            gram.matrix[rows, :size, :size] + ridge * np.eye(size), gram.moment[rows, :size]
        )
    return xi


def solve_many(matrix: Array, moment: Array) -> Array:
    """Solve systems (systems, n, n) of one size; NaN for a singular one."""
    try:
        return np.asarray(np.linalg.solve(matrix, moment[:, :, None])[:, :, 0], np.float64)
    except np.linalg.LinAlgError:  # one is exactly singular: the others are solved without it
        if len(matrix) == 1:
            return np.full(moment.shape, np.nan)
        half = len(matrix) // 2
        parts = (slice(None, half), slice(half, None))
        return np.concatenate([solve_many(matrix[part], moment[part]) for part in parts])


def least_squares(theta: Array, y: Array) -> tuple[Array, float]:
    """Solve one individual by QR on scaled columns: the accurate path, for the few that matter.

    Parameters
    ----------
    theta : ndarray, (rows, terms)
    y : ndarray, (rows,)

    Returns
    -------
    xi : ndarray, (terms,)
        Coefficients of the columns as given; the smallest-norm ones where columns depend.
    rss : float
        Residual sum of squares, from the residual itself.
    """
    if theta.shape[1] == 0:
        return np.zeros(0), float(y @ y)
    norms = np.linalg.norm(theta, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    xi = np.linalg.lstsq(theta / norms, y, rcond=1e-13)[0] / norms
    residual = y - theta @ xi
    return xi, float(residual @ residual)
