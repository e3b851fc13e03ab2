"""The spread of blocks tells the variance of an estimate, however few the blocks."""

from __future__ import annotations

import numpy as np

from jaxsr.diagnosis.shooting.uncertainty import spread_over_blocks


def estimate(
    rng: np.random.Generator, x: np.ndarray, blocks: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares on noise of a size for every row: variances by blocks, and the error."""
    e = size * rng.normal(size=len(x))
    error = np.linalg.lstsq(x, e, rcond=None)[0]
    left = e - x @ error
    hessian = np.stack([x[blocks == b].T @ x[blocks == b] for b in np.unique(blocks)])
    gradient = np.stack([x[blocks == b].T @ left[blocks == b] for b in np.unique(blocks)])
    root = np.linalg.cholesky(np.linalg.inv(x.T @ x))
    return spread_over_blocks(root, hessian, gradient), error


def test_the_variance_is_right_on_average_for_equal_errors():
    """Five constants, eight blocks; the mean of 4000 draws scatters by 2 %, four of which pass."""
    rng = np.random.default_rng(0)
    x = rng.normal(size=(80, 5)) * np.array([1.0, 10.0, 0.1, 1.0, 1.0])
    x[:10, 4] *= 10.0  # one block tells most about the last constant
    blocks = np.repeat(np.arange(8), 10)
    found = np.mean([estimate(rng, x, blocks, np.ones(80))[0] for _ in range(4000)], axis=0)
    np.testing.assert_allclose(found, np.diag(np.linalg.inv(x.T @ x)), rtol=0.08)


def test_errors_that_come_with_the_motion_are_seen():
    """Errors three times as large in the rows that tell most: the variance follows."""
    rng = np.random.default_rng(1)
    x = rng.normal(size=(240, 2)) * np.repeat([1.0, 3.0], 120)[:, None]
    blocks = np.tile(np.arange(24), 10)
    size = np.repeat([1.0, 3.0], 120)
    draws = [estimate(rng, x, blocks, size) for _ in range(1500)]
    found = np.mean([spread for spread, _ in draws], axis=0)
    true = np.var([error for _, error in draws], axis=0)
    np.testing.assert_allclose(found, true, rtol=0.15)
