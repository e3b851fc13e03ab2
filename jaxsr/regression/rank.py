r"""Independent columns of a library matrix (the editing of paper section 4.2.1, b, by rank).

Columns are taken in order. One stays if what the columns kept before it cannot explain is more
than a small share of its length; that share is the sine of its angle to their span.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jaxsr._result import InputError

_TINY = 1e-300


def independent_columns(
    theta: NDArray[np.floating],
    order: Sequence[float] | None = None,
    tolerance: float = 1e-8,
) -> list[int]:
    """Return the positions of an independent subset of columns, by Gram-Schmidt done twice.

    Parameters
    ----------
    theta : ndarray, (samples, columns)
        Of any scale. A zero column, or one that is not finite, is never kept.
    order : sequence of float, (columns,), optional
        Complexity of each column: the simpler of two that say the same stays. As given when None.
    tolerance : float
        Share of its length below which a column is dependent; rounding makes about 1e-15 of
        columns that agree.

    Returns
    -------
    list of int
        Positions in ``theta``, increasing.

    Raises
    ------
    InputError
        ``theta`` is no matrix, or ``order`` has another length.
    """
    theta = np.asarray(theta, dtype=np.float64)
    if theta.ndim != 2:
        raise InputError(f"theta must be (samples, columns), got shape {theta.shape}", "theta")
    count = theta.shape[1]
    places = _ordered(order, count)
    basis = np.empty((min(theta.shape), theta.shape[0]))
    kept: list[int] = []
    for place in places:
        if len(kept) == len(basis):
            break
        column = theta[:, place]
        largest = np.max(np.abs(column), initial=0.0)
        if not np.isfinite(largest) or largest < _TINY:
            continue
        column = column / largest
        unit = column / np.linalg.norm(column)
        rest = unit - basis[: len(kept)].T @ (basis[: len(kept)] @ unit)
        rest -= basis[: len(kept)].T @ (basis[: len(kept)] @ rest)
        length = np.linalg.norm(rest)
        if length > tolerance:
            basis[len(kept)] = rest / length
            kept.append(int(place))
    return sorted(kept)


def independent_in_grams(grams: NDArray[np.floating], tolerance: float = 1e-5) -> NDArray[np.bool_]:
    r"""Return which columns of many sets are independent, by a Cholesky factor of each Gram matrix.

    A pivot :math:`G_{jj} - \sum_k L_{jk}^2` is the square of a unit column's share outside the
    span of those before it; where it is small the column is passed over.

    Parameters
    ----------
    grams : ndarray, (sets, columns, columns)
        Of unit-norm columns, the simplest first. A set with fewer columns is padded by rows and
        columns of zeros, which count as dependent.
    tolerance : float
        As in :func:`independent_columns`; the Gram matrix squares it, so that below 1e-6 it is
        lost in rounding.

    Returns
    -------
    ndarray of bool, (sets, columns)
    """
    grams = np.asarray(grams, dtype=np.float64)
    if grams.ndim != 3 or grams.shape[1] != grams.shape[2]:
        raise InputError(
            f"grams must be (sets, columns, columns), got shape {grams.shape}", "grams"
        )
    factor = np.zeros_like(grams)
    kept = np.zeros(grams.shape[:2], dtype=bool)
    for j in range(grams.shape[1]):
        row = factor[:, j, :j]
        pivot = grams[:, j, j] - np.einsum("sk,sk->s", row, row)
        kept[:, j] = pivot > tolerance**2  # false for NaN too
        root = np.sqrt(np.where(kept[:, j], pivot, 1.0))
        below = grams[:, j + 1 :, j] - np.einsum("smk,sk->sm", factor[:, j + 1 :, :j], row)
        # the factor of a column passed over stays zero, as if it were not there
        factor[:, j + 1 :, j] = np.where(kept[:, j, None], below / root[:, None], 0.0)
    return kept


def _ordered(order: Sequence[float] | None, count: int) -> NDArray[np.intp]:
    if order is None:
        return np.arange(count)
    if len(order) != count:
        raise InputError(f"order has {len(order)} entries, theta {count} columns", "order")
    return np.argsort(np.asarray(order, dtype=float), kind="stable")
