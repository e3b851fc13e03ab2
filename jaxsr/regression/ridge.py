"""Ridge regression of many individuals in batched solves by size (paper section 4.4)."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxsr.regression.gram import Array, GramBatch, bucket

_BATCH = 128  # individuals solved together: one compilation for each bucket of sizes


@functools.cache
def _solver() -> Any:
    def solve(matrix: jax.Array, moment: jax.Array, ridge: jax.Array) -> jax.Array:
        damped = matrix + ridge * jnp.eye(matrix.shape[-1], dtype=matrix.dtype)
        return jnp.linalg.solve(damped, moment[..., None])[..., 0]

    return jax.jit(solve)


def solve_ridge(gram: GramBatch, ridge: float = 1e-10) -> Array:
    r"""Solve :math:`(G + \lambda I)\,\xi = b` for every individual in float64.

    Individuals are solved beside others of their size (up to 4 terms, 8, 16, ...), none padded to
    the largest of all, and each by itself: a solution's last bit does not depend on the others.

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
    last = np.max(np.where(gram.used, np.arange(1, terms + 1), 0), axis=1, initial=0)
    sizes = np.array([bucket(int(n)) if n else 0 for n in range(terms + 1)])[last]
    for size in np.unique(sizes[sizes > 0]).tolist():
        rows, width = np.flatnonzero(sizes == size), min(size, terms)
        for start in range(0, len(rows), _BATCH):
            part = rows[start : start + _BATCH]
            xi[part, :width] = _solved(gram, part, width, size, ridge)
    return xi


def _solved(gram: GramBatch, rows: NDArray[np.intp], width: int, size: int, ridge: float) -> Array:
    """Solve up to ``_BATCH`` individuals in a batch padded to one shape."""
    matrix = np.broadcast_to(np.eye(size), (_BATCH, size, size)).copy()
    moment = np.zeros((_BATCH, size))
    matrix[: len(rows), :width, :width] = gram.matrix[rows, :width, :width]
    moment[: len(rows), :width] = gram.moment[rows, :width]
    with jax.enable_x64(True):
        solved = np.asarray(_solver()(matrix, moment, np.float64(ridge)))[: len(rows), :width]
    whole = np.all(np.isfinite(solved), axis=1, keepdims=True)
    return np.where(whole, solved, np.nan)


def compiled_shapes() -> int:
    """Return how many shapes the batched solve has been compiled for."""
    return int(_solver()._cache_size())


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
