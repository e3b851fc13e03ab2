"""Sizes of columns, and how many neighbouring samples carry one independent residual."""

from __future__ import annotations

import numpy as np


def column_sizes(gram: np.ndarray) -> np.ndarray:
    """Square roots of the diagonal, 1 for columns without effect."""
    diagonal = np.diag(gram)
    return np.sqrt(np.where(diagonal > 1e-200, diagonal, 1.0))


def correlation_length(residual: np.ndarray) -> float:
    """Return how many neighbouring samples carry one independent residual."""
    total = 0.0
    lags = min(residual.shape[1] - 1, 400)
    r = residual.transpose(0, 2, 1).reshape(-1, residual.shape[1])
    size = float(np.abs(r).max(initial=0.0))
    if not 0.0 < size < np.inf:
        return 1.0
    r = r / size  # what escaped has squares that are no numbers
    power = float(np.mean(r**2))
    for lag in range(1, lags):
        rho = float(np.mean(r[:, :-lag] * r[:, lag:])) / power
        if rho < 0.05:
            break
        total += rho
    return 1.0 + 2.0 * total
