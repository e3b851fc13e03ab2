r"""Lasso and elastic net on columns of unit norm (paper section 4.4).

.. math:: \min_\xi \tfrac12 \|y - \Theta\xi\|^2
          + \lambda\left(\rho\|\xi\|_1 + \tfrac{1 - \rho}{2}\|\xi\|_2^2\right)

by scikit-learn's coordinate descent on the Gram matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from jaxsr._result import InputError
from jaxsr.regression.gram import Array
from jaxsr.regression.ridge import least_squares

Penalty = Literal["ridge", "lasso", "elastic_net"]


@dataclass(frozen=True, slots=True)
class ElasticNetRule:
    r"""Strength and kind of a penalty that selects terms.

    Attributes
    ----------
    strength : float
        :math:`\lambda` relative to the one at which every coefficient is zero, in (0, 1].
    mix : float
        :math:`\rho`, 1 for the lasso.
    tolerance : float
        Of the coordinate descent's duality gap.
    refit : bool
        Whether the selected terms are estimated again by least squares, without the shrinkage.
    """

    strength: float = 1e-3
    mix: float = 0.5
    tolerance: float = 1e-12
    refit: bool = True

    def __post_init__(self) -> None:
        if not 0.0 < self.strength <= 1.0:
            raise InputError(f"strength must lie in (0, 1], got {self.strength}", "ElasticNetRule")
        if not 0.0 < self.mix <= 1.0:
            raise InputError(f"mix must lie in (0, 1], got {self.mix}", "ElasticNetRule")


def elastic_net(theta: Array, y: Array, rule: ElasticNetRule) -> tuple[Array, float]:
    r"""Return penalised coefficients and the penalty :math:`\lambda`.

    Parameters
    ----------
    theta : ndarray, (rows, terms)
        Columns as given; they are weighed at unit norm, so one penalty suits all units.
    y : ndarray, (rows,)

    Returns
    -------
    xi : ndarray, (terms,)
        In the units of the columns; exactly zero for a term that is not selected.
    penalty : float
        :math:`\lambda` for columns of unit norm.
    """
    from sklearn.linear_model import ElasticNet  # slow to load, and rarely asked for

    norms = np.linalg.norm(theta, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    unit = np.asfortranarray(theta / norms)
    scale = float(np.linalg.norm(y)) or 1.0
    rows = len(y)
    # at lambda rho = max |theta^T y| the first coefficient leaves zero
    penalty = rule.strength * float(np.max(np.abs(unit.T @ (y / scale)))) / rule.mix
    gram: Any = unit.T @ unit
    model = ElasticNet(
        alpha=penalty / rows,
        l1_ratio=rule.mix,
        fit_intercept=False,
        precompute=gram,
        max_iter=100_000,
        tol=rule.tolerance,
    )
    model.fit(unit, y / scale)
    return np.asarray(model.coef_, np.float64) * scale / norms, penalty * scale


def selected(theta: Array, y: Array, rule: ElasticNetRule) -> Array:
    """Return coefficients (terms,): zero where not selected, else refitted if the rule says so."""
    xi, _ = elastic_net(theta, y, rule)
    kept = np.flatnonzero(xi)
    if rule.refit:
        xi[kept] = least_squares(theta[:, kept], y)[0]
    return xi
