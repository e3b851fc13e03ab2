"""A step of Levenberg and Marquardt, inside the bounds of the parameters."""

from __future__ import annotations

import numpy as np

from jaxsr.models.arrow import products, schur
from jaxsr.models.least_squares import Fit


def levenberg_step(
    fit_: Fit, damping: float, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    blocks = products(fit_.residual, fit_.jacobian, fit_.by_start)
    hessian, gradient, inverse, jx = schur(*blocks, damping=damping)
    step = np.zeros(fit_.active.size)
    if fit_.active.size:
        total, right = hessian.sum(0), gradient.sum(0)
        value = fit_.theta[fit_.active]
        held = ((value <= low[fit_.active]) & (right < 0)) | (
            (value >= high[fit_.active]) & (right > 0)
        )
        step = _bounded_solve(total, right, damping, ~held)
    x_step = np.einsum("sij,sj->si", inverse, blocks[4] - np.einsum("spi,p->si", jx, step))
    return step, x_step.T


def _bounded_solve(
    hessian: np.ndarray, gradient: np.ndarray, damping: float, free: np.ndarray
) -> np.ndarray:
    step = np.zeros(gradient.size)
    index = np.flatnonzero(free)
    part = hessian[np.ix_(index, index)]
    if index.size == 0 or not (np.isfinite(part).all() and np.isfinite(gradient[index]).all()):
        return step  # at an unstable point products overflow: the starts alone may still help
    # What the starts reproduce entirely leaves nothing, or a rounding error below it: no step.
    diagonal = np.diag(part)
    scale = np.where(diagonal > 1e-200, np.sqrt(np.maximum(diagonal, 1e-200)), np.inf)
    scaled = part / scale[:, None] / scale[None, :] + (damping + 1e-12) * np.eye(index.size)
    step[index] = np.linalg.lstsq(scaled, gradient[index] / scale, rcond=1e-13)[0] / scale
    return step
