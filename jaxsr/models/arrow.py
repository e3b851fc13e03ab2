"""Arrow-shaped normal equations: starts of segments eliminated, common parameters kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxsr.models.least_squares import Fit


def products(
    residual: np.ndarray, jacobian: np.ndarray, by_start: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Products per segment: Jt J, Jt X, Xt X, Jt r, Xt r."""
    segments = residual.shape[-1]
    rows = residual.size // segments
    j = jacobian.reshape(jacobian.shape[0], rows, segments).transpose(2, 1, 0)
    x = by_start.reshape(by_start.shape[0], rows, segments).transpose(2, 1, 0)
    r = residual.reshape(-1, segments).T[:, :, None]
    jt, xt = j.transpose(0, 2, 1), x.transpose(0, 2, 1)
    return jt @ j, jt @ x, xt @ x, (jt @ r)[..., 0], (xt @ r)[..., 0]


def schur(
    jj: np.ndarray, jx: np.ndarray, xx: np.ndarray, jr: np.ndarray, xr: np.ndarray, damping: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    scale = np.sqrt(np.einsum("sii->si", xx))
    # A start that no sensor sees (zero column) is left where it is.
    seen = scale > 1e-150
    scale = np.where(seen, scale, 1.0)
    scaled = xx / scale[:, :, None] / scale[:, None, :]
    scaled += (damping + 1e-10) * np.eye(xx.shape[1])
    inverse = np.linalg.inv(scaled) / scale[:, :, None] / scale[:, None, :]
    inverse = inverse * seen[:, :, None] * seen[:, None, :]
    projected = jj - jx @ inverse @ jx.transpose(0, 2, 1)
    gradient = jr - (jx @ inverse @ xr[..., None])[..., 0]
    return projected, gradient, inverse, jx


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
