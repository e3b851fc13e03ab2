"""Normal distributions cut off at bounds: mode, integral and deviations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.special import log_ndtr
from scipy.stats import truncnorm

from jaxsr.diagnosis.likelihood import truncated
from jaxsr.diagnosis.likelihood.truncated import Truncated


def drawn(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """A precision, its directions far apart in strength, and a right side."""
    columns = rng.normal(size=(n + 3, n)) * 10.0 ** rng.uniform(-1.0, 2.0, n)
    columns += rng.normal(size=(n + 3, 1)) * 10.0 ** rng.uniform(-1.0, 2.0)
    matrix = columns.T @ columns + np.eye(n)
    return matrix, matrix @ rng.normal(size=n)


def log_integral(found: Truncated) -> float:
    """Over 2 pi and the density at the mode: of the second constant in closed form, then summed."""
    (own, across), (_, other) = found.matrix
    z, (low, least), (high, most) = found.mode, found.low, found.high
    top = -0.5 * z @ found.matrix @ z + found.right @ z
    steps = np.geomspace(1e-12, 30.0, 40_000)
    at = np.unique(np.clip(np.concatenate([z[0] - steps, z[:1], z[0] + steps]), low, high))
    mean, root = (found.right[1] - across * at) / other, np.sqrt(other)
    below, above = (least - mean) * root, (most - mean) * root
    turned = below > 0.0
    below, above = np.where(turned, -above, below), np.where(turned, -below, above)
    with np.errstate(divide="ignore"):
        inner = log_ndtr(above) + np.log1p(-np.exp(log_ndtr(below) - log_ndtr(above)))
    log = inner + 0.5 * other * mean**2 - 0.5 * own * at**2 + found.right[0] * at - top
    whole = np.trapezoid(np.exp(log), at)
    return float(np.log(whole / np.sqrt(2.0 * np.pi) / root))


def test_the_mode_is_that_of_bounded_least_squares() -> None:
    rng = np.random.default_rng(0)
    touched = 0
    for _ in range(200):
        n = int(rng.integers(1, 9))
        matrix, right = drawn(rng, n)
        low = np.where(rng.random(n) < 0.3, -np.inf, -rng.random(n))
        high = np.where(rng.random(n) < 0.3, np.inf, rng.random(n))
        found = Truncated.of(matrix, right, low, high)
        factor = np.linalg.cholesky(matrix)
        args = factor.T, np.linalg.solve(factor, right), (low, high)
        wanted = lsq_linear(*args, tol=1e-14).x
        touched += found.held.any()
        assert ((found.mode >= low) & (found.mode <= high)).all()

        def cost(z: np.ndarray, matrix: np.ndarray = matrix, right: np.ndarray = right) -> float:
            return float(0.5 * z @ matrix @ z - right @ z)

        assert cost(found.mode) <= cost(wanted) + 1e-6 * (1.0 + abs(cost(wanted)))
        # what stands in where active sets go round
        mode, held = truncated._by_library(right, low, high, factor)  # pyright: ignore[reportPrivateUsage]
        assert (held == found.held).all()
        np.testing.assert_allclose(mode, found.mode, rtol=1e-5, atol=1e-6)
    assert touched > 100


def test_one_constant_has_its_own_truncated_normal_distribution() -> None:
    for right in (-300.0, -30.0, -3.0, 0.0, 1.0, 20.0):
        found = Truncated.of(np.array([[9.0]]), np.array([right]), np.zeros(1), np.full(1, 4.0))
        mean, spread = right / 9.0, 1.0 / 3.0
        known = (0.0 - mean) / spread, (4.0 - mean) / spread, mean, spread
        whole = -truncnorm.logpdf(found.mode[0], *known) - 0.5 * np.log(2.0 * np.pi)
        assert found.log_integral == pytest.approx(whole, abs=1e-6)
        if found.held.any():  # the interval that starts at the bound
            reach = 1.959964 * found.deviation[0]
            assert truncnorm.cdf(reach, *known) == pytest.approx(0.95, abs=1e-3)


def test_the_integral_beside_one_bound_is_exact() -> None:
    """However the two hang together, where the other one is free."""
    rng = np.random.default_rng(1)
    for _ in range(10):
        matrix, right = drawn(rng, 2)
        edge = np.linalg.solve(matrix, right)[0] + rng.uniform(0.1, 3.0) / np.sqrt(matrix[0, 0])
        low, high = np.array([edge, -np.inf]), np.full(2, np.inf)
        found = Truncated.of(matrix, right, low, high)
        assert found.held.tolist() == [True, False]
        assert found.log_integral == pytest.approx(log_integral(found), abs=1e-4)


@pytest.mark.parametrize("strong", [1e2, 1e4, 1e6])
def test_what_only_both_could_be_is_not_inside_because_each_could(strong: float) -> None:
    """Their sum is told to be -1, and neither is ever below zero.

    Each by itself may well be above zero, as far below as the other then is: the share of each
    marginal inside is about a half, and what is inside of both is nothing.
    """
    matrix = np.eye(2) + strong * np.ones((2, 2))
    right = -strong * np.ones(2)
    found = Truncated.of(matrix, right, np.zeros(2), np.full(2, np.inf))
    assert (found.mode == 0.0).all()
    assert found.log_integral == pytest.approx(log_integral(found), abs=0.1)
    assert (found.deviation <= 1.54 / strong).all()


def test_a_free_constant_is_as_wide_as_those_that_are_held_leave_it() -> None:
    """Its sum with the other is told: held at zero, the other one leaves no doubt of it."""
    matrix = np.array([[1e4 + 1.0, 1e4], [1e4, 1e4 + 1.0]])
    right = np.array([1e4, 0.0])  # the second would be near -1
    found = Truncated.of(matrix, right, np.array([-np.inf, 0.0]), np.full(2, np.inf))
    assert found.held.tolist() == [False, True]
    apart = np.random.default_rng(2).exponential(1.0 / found.slope, 200_000)
    assert found.deviation[0] == pytest.approx(np.hypot(1e-2, apart.std()), rel=0.05)
