"""Least squares with coefficients of known sign."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import lsq_linear

from jaxsr._result import InputError
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array

Signs = Mapping[Term, int]


def checked_signs(signs: Signs | None) -> dict[Term, int]:
    """Return the signs, each 1 (not negative) or -1 (not positive).

    Raises
    ------
    InputError
        A sign is something else.
    """
    for term, sign in (signs or {}).items():
        if sign not in (1, -1):
            raise InputError(f"a sign must be 1 or -1, got {sign!r} for {term.op}", "signs")
    return dict(signs or {})


def signs_of(terms: Sequence[Term], signs: Signs) -> Array:
    """Return 1, -1 or 0 (free) for each term."""
    return np.array([signs.get(term, 0) for term in terms], dtype=float)


def wrong(xi: Array, sign: Array) -> bool:
    """Tell whether a coefficient has the sign it must not have."""
    return bool(np.any(xi * sign < 0.0))


def signed_least_squares(theta: Array, y: Array, sign: Array) -> tuple[Array, float]:
    r"""Minimise :math:`\|y - \Theta\xi\|` with :math:`s_k \xi_k \ge 0` where :math:`s_k \ne 0`.

    Parameters
    ----------
    theta : ndarray, (rows, terms)
    y : ndarray, (rows,)
    sign : ndarray, (terms,)
        1, -1, or 0 for a free coefficient.

    Returns
    -------
    xi : ndarray, (terms,)
    rss : float

    References
    ----------
    Stark and Parker (1995), Computational Statistics 10, 129-141 (BVLS).
    """
    norms = np.linalg.norm(theta, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    low, high = np.where(sign > 0, 0.0, -np.inf), np.where(sign < 0, 0.0, np.inf)
    found = lsq_linear(theta / norms, y, bounds=(low, high), method="bvls", tol=1e-15)
    xi = np.asarray(found.x, np.float64) / norms
    residual = y - theta @ xi
    return xi, float(residual @ residual)


def signed_normal_equations(matrix: Array, moment: Array, sign: Array) -> Array:
    """Return the constrained solution of normal equations in columns of unit norm."""
    # the factor's rows stand in for the data's: |L^T x - L^-1 b|^2 differs by a constant
    factor = np.asarray(np.linalg.cholesky(matrix), np.float64)
    short = np.asarray(np.linalg.solve(factor, moment), np.float64)
    return signed_least_squares(factor.T, short, sign)[0]
