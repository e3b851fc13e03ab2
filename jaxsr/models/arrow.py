"""Arrow-shaped normal equations: starts of segments eliminated, common parameters kept."""

from __future__ import annotations

import numpy as np


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
