"""Ridge regression of many individuals in one batched solve (paper section 4.4)."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr.regression.gram import Array, GramBatch, bucket

_BATCH = 256  # individuals solved together: one compilation for each width


@functools.cache
def _solver() -> Any:
    def solve(matrix: jax.Array, moment: jax.Array, ridge: jax.Array) -> jax.Array:
        damped = matrix + ridge * jnp.eye(matrix.shape[-1], dtype=matrix.dtype)
        return jnp.linalg.solve(damped, moment[..., None])[..., 0]

    return jax.jit(solve)


def solve_ridge(gram: GramBatch, ridge: float = 1e-10) -> Array:
    r"""Solve :math:`(G + \lambda I)\,\xi = b` for every individual in float64.

    Parameters
    ----------
    gram : GramBatch
        Normal equations in columns of unit norm, so one ``ridge`` suits all terms.
    ridge : float
        :math:`\lambda`, relative to a squared column norm of one.

    Returns
    -------
    ndarray, (individuals, terms)
        Coefficients of the unit-norm columns; zero in unused slots. A singular system whose
        solution is not finite comes back as NaN, for the caller to reject.

    References
    ----------
    Askari and Crevecoeur, Eqs. 17 and 18 with :math:`J = \|\xi\|_2^2`.
    """
    individuals, terms = gram.moment.shape
    width = bucket(terms)
    xi = np.empty((individuals, terms))
    for start in range(0, individuals, _BATCH):
        part = slice(start, min(start + _BATCH, individuals))
        matrix = np.zeros((_BATCH, width, width))
        matrix[:, np.arange(width), np.arange(width)] = 1.0
        matrix[: part.stop - start, :terms, :terms] = gram.matrix[part]
        moment = np.zeros((_BATCH, width))
        moment[: part.stop - start, :terms] = gram.moment[part]
        with jax.enable_x64(True):
            solved = np.asarray(_solver()(matrix, moment, np.float64(ridge)))
        xi[part] = solved[: part.stop - start, :terms]
    return xi


def compiled_shapes() -> int:
    """Return how many shapes the batched solve has been compiled for."""
    return int(_solver()._cache_size())


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
