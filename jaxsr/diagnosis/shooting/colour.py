"""Colour of what a fit leaves: how many independent samples it is worth."""

from __future__ import annotations

import numpy as np

SMOOTH = 0.93
"""Correlation of neighbouring samples from which a residual is motion and not coloured noise."""


def colour(residual: np.ndarray) -> float:
    """Lag-one correlation of a residual, shape (samples, segments), where it is noise; 0 otherwise.

    Correlation of first-order noise falls by rho with every sample. What a model leaves of a
    motion falls more slowly than by `SMOOTH`, whatever white noise lies over it: lags 2 and 4 do
    not see that.
    """
    products = [
        float(np.mean(residual[: residual.shape[0] - lag] * residual[lag:])) for lag in (0, 2, 4)
    ]
    if residual.shape[0] < 3 * 4 or products[1] <= 0.1 * products[0]:
        return 0.0  # also where nothing at all is left
    rho = np.sqrt(max(products[2] / products[1], 0.0))
    return float(rho) if rho < SMOOTH else 0.0


def independent(residual: np.ndarray) -> float:
    """Return how many independent samples a residual is worth, shape (outputs, samples, segments).

    Beside a motion, which is slow, first-order noise of correlation rho is as strong as that of
    (1 - rho)/(1 + rho) as many samples (Bartlett 1946, J. R. Stat. Soc. Suppl. 8).
    """
    counts = np.array([np.count_nonzero(one) for one in residual])
    rho = np.array([colour(one) for one in residual])
    return float(np.sum(counts * (1.0 - rho) / (1.0 + rho)))
