"""Quotients of sums: random laws, noise, waves of time, views."""

from __future__ import annotations

import numpy as np

from jaxsr.expressions import evaluate
from jaxsr.regression import RegressionProblem
from jaxsr.regression.rational import quotients


def _law(rng: np.random.Generator, n: int) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
    """Return samples of x and z, numerator and denominator of a random quotient."""
    variables = {name: rng.uniform(0.5, 2.5, size=n) for name in ("x", "z")}
    x, z = variables["x"], variables["z"]
    base = [np.ones(n), x, z, x * x, x * z, z * z]
    m, k = rng.choice(6, 2, replace=False)
    j, below = rng.choice(6, 2, replace=False)
    a, c = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.5, 3.0, 2)
    d = -rng.uniform(0.3, 3.0)  # a sum of positive parts has no pole
    return variables, a * base[m] + c * base[k], base[j] - d * base[below]


def test_random_quotients_are_recovered() -> None:
    """Every one of 60 draws, to 1e-9 of the target, and on samples not seen."""
    for seed in range(60):
        rng = np.random.default_rng([12, seed])
        variables, top, bottom = _law(rng, 240)
        y = top / bottom
        half = {n: v[:120] for n, v in variables.items()}
        problem = RegressionProblem(y[:120], half)
        found = quotients(problem, [], 8)
        assert len(found) <= 8
        _, losses = problem.solve(found)
        assert np.all(np.diff(losses) >= -1e-9)  # the best first
        assert losses[0] < 1e-18, seed
        fit = problem.fit(found[0])
        columns = [evaluate(t, {n: v[120:] for n, v in variables.items()}) for t in found[0]]
        unseen = np.column_stack(columns) @ fit.coefficients
        np.testing.assert_allclose(unseen, y[120:], rtol=1e-6, atol=1e-8)


def test_quotients_under_noise_keep_the_denominator() -> None:
    right = 0
    for seed in range(20):
        rng = np.random.default_rng([13, seed])
        x = rng.uniform(0.0, 5.0, size=400)
        c = rng.uniform(0.5, 2.0)
        y = 3.0 * x / (x + c)
        problem = RegressionProblem(y + 0.002 * rng.normal(size=400), {"x": x})
        _, losses = problem.solve(quotients(problem, [], 8))
        noise = float(np.sum((problem.y - y) ** 2)) / problem.total
        right += losses[0] < 1.1 * noise
    assert right >= 19


def test_waves_of_time_below_the_line() -> None:
    t = np.linspace(0.0, 4.0, 300)
    y = np.sin(3.0 * t) / (2.0 + np.cos(3.0 * t))
    problem = RegressionProblem(y, {"t": t})
    found = quotients(problem, [3.0], 4)
    assert problem.solve(found)[1][0] < 1e-18
    assert problem.solve(quotients(problem, [2.9], 4))[1][0] > 1e-6


def test_quotients_mean_nothing_in_a_weak_view_but_may_be_weighted() -> None:
    rng = np.random.default_rng(14)
    x = rng.uniform(0.5, 2.0, size=200)
    y = x / (x + 1.3)
    weights = rng.normal(size=(60, 200))
    assert (
        quotients(RegressionProblem(weights @ y, {"x": x}, view=lambda c: weights @ c), [], 5) == []
    )
    mixing = np.eye(200) + 0.1 * rng.normal(size=(200, 200))  # as many rows, and yet no weights
    assert (
        quotients(RegressionProblem(mixing @ y, {"x": x}, view=lambda c: mixing @ c), [], 5) == []
    )
    known = RegressionProblem(y, {"x": x}, fixed=np.ones((200, 1)))
    assert quotients(known, [], 5) == []
    w = rng.uniform(0.5, 2.0, size=200)
    weighted = RegressionProblem(w * y, {"x": x}, view=lambda c: w[:, None] * c)
    assert weighted.solve(quotients(weighted, [], 5))[1][0] < 1e-20
