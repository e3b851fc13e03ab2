"""Scaled Gram matrices of many individuals at once.

Squaring a library into its Gram matrix squares the condition number, so columns are scaled to
unit norm first and every product is taken in float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Bytes of gathered columns held at once; keeps a population of long recordings inside the cache
# of a laptop rather than in its swap.
_CHUNK_BYTES = 64 * 2**20


@dataclass(frozen=True, slots=True)
class GramBatch:
    r"""Normal equations of a batch of individuals, in columns of unit norm.

    Attributes
    ----------
    matrix : ndarray, (individuals, terms, terms)
        :math:`G_{jk} = \theta_j^T \theta_k`; an unused slot has a one on its diagonal.
    moment : ndarray, (individuals, terms)
        :math:`b_j = \theta_j^T y`; zero in an unused slot.
    used : ndarray of bool, (individuals, terms)
        Which slots hold a term.
    total : float
        :math:`y^T y`.
    """

    matrix: Array
    moment: Array
    used: NDArray[np.bool_]
    total: float

    def loss(self, xi: Array) -> Array:
        """Return the residual sum of squares of every individual, never below zero.

        Terms are summed in order, so that unused slots behind them change no bit.
        """
        fitted = np.zeros(xi.shape)
        for k in range(xi.shape[1]):
            fitted += xi[:, k, None] * self.matrix[:, :, k]
        explained = np.cumsum(xi * (2.0 * self.moment - fitted), axis=1)[:, -1]
        return np.maximum(self.total - explained, 0.0)


def scale_columns(columns: Array) -> tuple[Array, Array]:
    """Divide each row of ``columns`` (terms, rows) by its Euclidean norm.

    Returns
    -------
    scaled : ndarray, (terms, rows)
        Columns of unit norm; a zero column stays zero.
    norms : ndarray, (terms,)
        What they were divided by (1 for a zero column).
    """
    norms = np.linalg.norm(columns, axis=1)
    norms = np.where(norms > 0.0, norms, 1.0)
    return columns / norms[:, None], norms


def bucket(count: int, smallest: int = 4) -> int:
    """Return the power of two at or above ``count``: one compiled shape serves the bucket."""
    size = smallest
    while size < count:
        size *= 2
    return size


def gather_gram(columns: Array, y: Array, index: NDArray[np.intp]) -> GramBatch:
    """Build the normal equations of individuals that share a store of columns.

    Parameters
    ----------
    columns : ndarray, (stored, rows)
        Columns of unit norm, one a row.
    y : ndarray, (rows,)
        Target.
    index : ndarray of int, (individuals, terms)
        Rows of ``columns`` that each individual uses; -1 marks an unused slot.
    """
    individuals, terms = index.shape
    used = index >= 0
    if not len(columns):  # no slot is used; what stands in for a column is masked below
        columns = np.zeros((1, len(y)))
    safe = np.where(used, index, 0)
    matrix, moment = np.empty((individuals, terms, terms)), np.empty((individuals, terms))
    step = max(1, _CHUNK_BYTES // max(1, 8 * terms * columns.shape[1]))
    for start in range(0, individuals, step):
        theta = columns[safe[start : start + step]]
        matrix[start : start + step] = theta @ theta.transpose(0, 2, 1)
        # one product a set: a moment must not depend on what else is stored
        moment[start : start + step] = theta @ y
    matrix *= used[:, :, None] & used[:, None, :]
    matrix[:, np.arange(terms), np.arange(terms)] += ~used
    moment *= used
    return GramBatch(matrix, moment, used, float(y @ y))


def orthonormal_columns(columns: Array) -> Array:
    """Return an orthonormal basis of columns (rows, k), of what they span to rounding."""
    if not columns.shape[1]:
        return columns
    scaled, _ = scale_columns(columns.T)
    left, singular, _ = np.linalg.svd(scaled.T, full_matrices=False)
    return left[:, singular > 1e-12 * singular[0]]
