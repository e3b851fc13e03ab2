"""Intervals of coefficients that stay honest when residuals are correlated in time."""

from __future__ import annotations

import numpy as np
from scipy import stats

from jaxsr.regression.gram import Array


def coefficient_ci95(theta: Array, residual: Array, xi: Array, *, lags: int | None = None) -> Array:
    r"""Return 95 % intervals of least-squares coefficients.

    The covariance is the Newey-West sandwich
    :math:`(\Theta^T\Theta)^{-1} S (\Theta^T\Theta)^{-1}` with
    :math:`S = \sum_{|l| \le L} (1 - |l|/(L+1)) \sum_i g_i g_{i+l}^T`,
    :math:`g_i = \theta_i r_i`: neighbouring samples of a recording do not err independently, and
    the textbook formula would call such a fit far too certain.

    Parameters
    ----------
    theta : ndarray, (rows, terms)
        Rows in the order of time. For coefficients and inner constants together, pass the
        Jacobian of the fitted values and all of them in ``xi``.
    residual : ndarray, (rows,)
    xi : ndarray, (terms,)
    lags : int, optional
        :math:`L`; by default :math:`\lfloor 4 (N/100)^{2/9} \rfloor`, 0 for independent rows.

    Returns
    -------
    ndarray, (terms, 2)
        Lower and upper ends; infinite where rows do not outnumber terms or columns depend.

    References
    ----------
    Newey and West (1987), Econometrica 55, 703-708; the lag rule is theirs of 1994.
    """
    rows, terms = theta.shape
    if rows <= terms:
        return np.column_stack([np.full(terms, -np.inf), np.full(terms, np.inf)])
    norms = np.linalg.norm(theta, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    scaled = theta / norms
    scores = scaled * residual[:, None]
    depth = int(4.0 * (rows / 100.0) ** (2.0 / 9.0)) if lags is None else lags
    middle = scores.T @ scores
    for lag in range(1, min(depth, rows - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        middle += (1.0 - lag / (depth + 1.0)) * (cross + cross.T)
    _, singular, right = np.linalg.svd(scaled, full_matrices=False)
    if singular[-1] <= 1e-12 * singular[0]:
        return np.column_stack([np.full(terms, -np.inf), np.full(terms, np.inf)])
    bread = (right.T / singular**2) @ right
    covariance = bread @ middle @ bread * rows / (rows - terms)
    half = stats.t.ppf(0.975, rows - terms) * np.sqrt(np.maximum(np.diag(covariance), 0.0)) / norms
    return np.column_stack([xi - half, xi + half])
