"""Seeds of a search: best subsets and thinned bases against brute force."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from brute_force import relative_loss

from jaxsr.evolution import (
    SearchConfig,
    best_subsets,
)
from jaxsr.evolution.seeds import bases, complete, thinned_bases
from jaxsr.expressions import parse
from jaxsr.expressions.editing import edit
from jaxsr.regression import RegressionProblem


@pytest.mark.parametrize("seed", range(20))
def test_the_true_set_is_among_the_best_subsets(seed: int) -> None:
    rng = np.random.default_rng([16, seed])
    data = {n: rng.uniform(-2.0, 2.0, size=300) for n in ("x", "v")}
    basis = [p for d in range(4) for p in _powers(d)]
    size = int(rng.integers(1, 5))
    true = [basis[k] for k in rng.choice(len(basis), size, replace=False)]
    columns = np.column_stack([data["x"] ** a * data["v"] ** b for a, b in true])
    columns /= np.linalg.norm(columns, axis=0) / np.sqrt(300.0)
    y = columns @ (rng.choice([-1.0, 1.0], size) * rng.uniform(0.5, 2.0, size))
    y += 0.1 * np.std(y) * rng.normal(size=300) + 0.05 * rng.normal(size=300)
    problem = RegressionProblem(y, data)
    found = {frozenset(s) for s in best_subsets(problem, SearchConfig())}
    words = ["*".join(["1.0", *["x"] * a, *["v"] * b]) for a, b in true]
    assert frozenset(edit([parse(w, ["x", "v"]) for w in words])) in found


def _powers(degree: int) -> list[tuple[int, int]]:
    return [(a, degree - a) for a in range(degree + 1)]


def test_the_best_subset_of_every_size_is_brute_forces() -> None:
    rng = np.random.default_rng(17)
    x = rng.uniform(0.5, 2.0, size=100)
    problem = RegressionProblem(np.exp(x) + 0.1 * rng.normal(size=100), {"x": x})
    powers = [parse(w, ["x"]) for w in ("1.0", "x", "x**2", "x**3", "x**4", "x**5")]
    columns = x[:, None] ** np.arange(6)
    found = {frozenset(s) for s in best_subsets(problem, SearchConfig())}
    for size in (1, 2, 3, 4):
        best = min(
            itertools.combinations(range(6), size),
            key=lambda s: relative_loss(columns[:, s], problem.y),
        )
        assert frozenset(powers[k] for k in best) in found


def test_a_polynomial_without_noise_is_in_the_chain_of_its_basis() -> None:
    for seed in range(20):
        rng = np.random.default_rng([20, seed])
        data = {n: rng.uniform(-2.0, 2.0, size=200) for n in ("x", "v")}
        basis = [p for d in range(5) for p in _powers(d)]
        true = [basis[k] for k in rng.choice(len(basis), int(rng.integers(1, 7)), replace=False)]
        columns = np.column_stack([data["x"] ** a * data["v"] ** b for a, b in true])
        coefficients = rng.choice([-1.0, 1.0], len(true)) * rng.uniform(0.2, 5.0, len(true))
        problem = RegressionProblem(columns @ coefficients, data)
        words = ["*".join(["1.0", *["x"] * a, *["v"] * b]) for a, b in true]
        chains = {frozenset(s) for s in thinned_bases(problem, SearchConfig())}
        assert frozenset(edit([parse(w, ["x", "v"]) for w in words])) in chains, seed


@pytest.mark.parametrize(("count", "rows"), [(1, 300), (2, 300), (2, 20), (5, 300), (12, 600)])
def test_bases_hold_every_monomial_and_leave_rows_to_spare(count: int, rows: int) -> None:
    rng = np.random.default_rng(21)
    data = {f"x{k}": rng.normal(size=rows) for k in range(count)}
    problem = RegressionProblem(rng.normal(size=rows), data)
    found = bases(problem, SearchConfig())
    sizes = [math.comb(count + degree, degree) for degree in range(1, 6)]
    assert [len(b) for b in found] == [n for n in sizes if n <= min(130, rows // 3)]
    assert all(set(a) < set(b) for a, b in itertools.pairwise(found))
    assert all(len(b) <= 12 for b in complete(problem, SearchConfig()))
