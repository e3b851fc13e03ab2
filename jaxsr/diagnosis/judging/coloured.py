"""Coloured noise: how much more likely one set makes the readings, by their innovations."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.judging.innovations import Autoregression
from jaxsr.models.arrow import products, schur
from jaxsr.models.least_squares import Fit


def likelihood_ratio(null: Fit, chosen: Fit) -> float:
    r"""Twice the log likelihood ratio of two fits where every sensor's noise is an autoregression.

    With :math:`e_k` the innovations (`innovations`), the predictors of every output from the
    residual of the chosen fit, it is :math:`n \log(\sum e_0^2 / \sum e_1^2)`. Both fits, which
    least squares made, are moved to the best innovations by one Gauss-Newton step.

    References
    ----------
    Ljung, System Identification (1999), section 7.4 (maximum likelihood, coloured noise).
    """
    seen = chosen.residual != 0.0
    if not seen.any():  # no reading was followed before time ended: nothing tells them apart
        return 0.0
    noise = [Autoregression.of(r, s) for r, s in zip(chosen.residual, seen, strict=True)]

    def whitened(a: np.ndarray) -> np.ndarray:
        parts = [n.innovations(a[..., k, :, :], seen[k]) for k, n in enumerate(noise)]
        return np.stack(parts, axis=-3)

    sizes = np.sqrt(np.sum(whitened(chosen.residual) ** 2, axis=(1, 2)))
    weights = np.sqrt(np.maximum(seen.sum(axis=(1, 2)), 1.0)) / (sizes + 1e-300)

    def cost(fit: Fit) -> float:
        parts = (fit.residual, fit.jacobian, fit.by_start)
        r, j, x = (whitened(a) * weights[:, None, None] for a in parts)
        blocks = products(r, j, x)
        hessian, gradient, inverse, _ = schur(*blocks, damping=0.0)
        total, pull = hessian.sum(0), gradient.sum(0)
        size = np.sqrt(np.maximum(np.diag(total), 1e-200))
        step = np.linalg.lstsq(total / size / size[:, None], pull / size, rcond=1e-10)[0]
        by_start = np.einsum("si,sij,sj->", blocks[4], inverse, blocks[4])
        return float(np.sum(r**2) - step @ (pull / size) - by_start)

    return float(seen.sum() * np.log(cost(null) / cost(chosen)))
