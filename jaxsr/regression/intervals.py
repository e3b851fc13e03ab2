"""Intervals of coefficients that stay honest when residuals are correlated in time."""

from __future__ import annotations

import numpy as np
from scipy.special import stdtrit

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
        :math:`L`, 0 for independent rows; by default the larger of
        :math:`\lfloor 4 (N/100)^{2/9} \rfloor` and Andrews' rule for the residual's own
        first autocorrelation :math:`\rho`,
        :math:`1.1447\,(4\rho^2 N / (1 - \rho^2)^2)^{1/3}`, at most a quarter of the rows.

    Returns
    -------
    ndarray, (terms, 2)
        Lower and upper ends; infinite where rows do not outnumber terms or columns depend.

    References
    ----------
    Newey and West (1987), Econometrica 55, 703-708; the lag rule is theirs of 1994. Andrews
    (1991), Econometrica 59, 817-858, Eqs. 6.2 and 6.4. Kiefer and Vogelsang (2005), Econometric
    Theory 21, 1130-1164, Table 1, for the critical value at so many lags.
    """
    rows, terms = theta.shape
    if rows <= terms:
        return np.column_stack([np.full(terms, -np.inf), np.full(terms, np.inf)])
    norms = np.linalg.norm(theta, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    scaled = theta / norms
    scores = scaled * residual[:, None]
    depth = _lags(residual) if lags is None else lags
    middle = scores.T @ scores
    for lag in range(1, min(depth, rows - 1) + 1):
        cross = scores[lag:].T @ scores[:-lag]
        middle += (1.0 - lag / (depth + 1.0)) * (cross + cross.T)
    _, singular, right = np.linalg.svd(scaled, full_matrices=False)
    if singular[-1] <= 1e-12 * singular[0]:
        return np.column_stack([np.full(terms, -np.inf), np.full(terms, np.inf)])
    bread = (right.T / singular**2) @ right
    covariance = bread @ middle @ bread * rows / (rows - terms)
    # the estimate of S is itself uncertain, the more so the more lags enter it
    share = min(depth, rows - 1) / rows if depth else 0.0
    widened = 1.0 + (2.9694 * share + 0.4160 * share**2 - 0.5324 * share**3) / 1.9600
    half = (
        widened
        * stdtrit(rows - terms, 0.975)
        * np.sqrt(np.maximum(np.diag(covariance), 0.0))
        / norms
    )
    return np.column_stack([xi - half, xi + half])


def _lags(residual: Array) -> int:
    rows = len(residual)
    own = float(residual[:-1] @ residual[:-1])
    rho = float(residual[1:] @ residual[:-1]) / own if own > 0.0 else 0.0
    rho = float(np.clip(rho, -0.97, 0.97))
    andrews = 1.1447 * (4.0 * rho**2 * rows / (1.0 - rho**2) ** 2) ** (1.0 / 3.0)
    return int(max(4.0 * (rows / 100.0) ** (2.0 / 9.0), min(andrews, rows / 4.0)))
