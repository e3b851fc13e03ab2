"""Coloured noise: how much more likely one set makes the readings, by their innovations."""

from __future__ import annotations

import numpy as np

from jaxsr.models.arrow import products, schur
from jaxsr.models.least_squares import Fit

LONGEST_MEMORY = 0.98
"""Largest lag-one correlation that is taken out."""


def likelihood_ratio(null: Fit, chosen: Fit) -> float:
    r"""Twice the log likelihood ratio of two fits where every sensor's noise is AR(1).

    With :math:`e_k = r_k - \rho r_{k-1}` the innovations, :math:`\rho` of every output from the
    residual of the chosen fit, it is :math:`n \log(\sum e_0^2 / \sum e_1^2)`. Both fits, which
    least squares made, are moved to the best innovations by one Gauss-Newton step.

    References
    ----------
    Ljung, System Identification (1999), section 7.4 (maximum likelihood, coloured noise).
    """
    seen = chosen.residual != 0.0
    rho = np.array([_memory(r) for r in chosen.residual])
    sizes = np.sqrt(np.sum(_innovations(chosen.residual, rho, seen) ** 2, axis=(1, 2)))
    weights = np.sqrt(np.maximum(seen.sum(axis=(1, 2)), 1.0)) / (sizes + 1e-300)

    def cost(fit: Fit) -> float:
        parts = (fit.residual, fit.jacobian, fit.by_start)
        r, j, x = (_innovations(a, rho, seen) * weights[:, None, None] for a in parts)
        blocks = products(r, j, x)
        hessian, gradient, inverse, _ = schur(*blocks, damping=0.0)
        total, pull = hessian.sum(0), gradient.sum(0)
        size = np.sqrt(np.maximum(np.diag(total), 1e-200))
        step = np.linalg.lstsq(total / size / size[:, None], pull / size, rcond=1e-10)[0]
        by_start = np.einsum("si,sij,sj->", blocks[4], inverse, blocks[4])
        return float(np.sum(r**2) - step @ (pull / size) - by_start)

    return float(seen.sum() * np.log(cost(null) / cost(chosen)))


def _memory(residual: np.ndarray) -> float:
    """Lag-one correlation of a residual, shape (samples, segments)."""
    power = float(np.sum(residual**2)) + 1e-300
    return float(np.clip(np.sum(residual[1:] * residual[:-1]) / power, 0.0, LONGEST_MEMORY))


def _innovations(a: np.ndarray, rho: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """What the sample before does not tell; arrays (..., outputs, samples, segments)."""
    before = rho[:, None, None] * (seen[:, 1:] & seen[:, :-1])
    first = np.sqrt(1.0 - rho**2)[:, None, None]
    result = first * a
    result[..., 1:, :] = np.where(
        before > 0.0, a[..., 1:, :] - before * a[..., :-1, :], result[..., 1:, :]
    )
    return result
