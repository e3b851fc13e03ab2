"""Weighing many sets: shared products, thresholds in batch, samples too long to be held."""

import numpy as np
import pytest

from benchmarks.generations import Interpreted, memory
from jaxsr.expressions import parse
from jaxsr.regression import (
    GramBatch,
    HardThreshold,
    RegressionProblem,
    Resources,
    Rules,
    least_squares,
    scale_columns,
)
from jaxsr.regression.products import ROWS, PairProducts, dot, gathered, slots_of
from jaxsr.regression.store import refined_loss

NAMES = ["t", "x", "z"]
POOL = [
    *("x", "z", "t", "x*z", "x**2", "z**2", "sin(2.5*t + 0.4)", "cos(t)", "exp(x/3)", "x*cos(z)"),
    *("t*x", "tanh(x)", "1", "x**3", "Abs(z)", "sign(x)", "sin(x*z)", "x/(1 + z**2)", "t**2"),
]
TERMS = [parse(text, NAMES) for text in POOL]


def _problem(n=500, noise=0.1, **options):
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 10.0, n)
    x, z = rng.normal(size=(2, n))
    y = 3.0 * x - 2.0 * z + 5.0 * np.sin(2.5 * t + 0.4) + noise * rng.normal(size=n)
    return RegressionProblem(y, {"t": t, "x": x, "z": z}, **options)


def _sets(rng, count=60, most=8):
    sizes = rng.integers(1, most + 1, size=count)
    return [[TERMS[k] for k in rng.permutation(len(TERMS))[:size]] for size in sizes]


def test_a_product_is_the_same_bits_wherever_its_columns_lie():
    rng = np.random.default_rng(1)
    for rows in (1, 7, 1000, ROWS, ROWS + 1, 3 * ROWS + 5):
        a, b = rng.normal(size=(2, rows))
        exact = dot(a, b)
        assert exact == pytest.approx(float(np.sum(a * b)), rel=1e-12, abs=1e-10)
        for shift in range(5):  # of the first byte: memory may be aligned or not
            moved = np.zeros((2, rows + 5))
            moved[:, shift : shift + rows] = a, b
            assert dot(*moved[:, shift : shift + rows]) == exact
            assert dot(*moved[::-1, shift : shift + rows]) == exact


@pytest.mark.parametrize("seed", range(5))
def test_losses_are_the_same_bits_whatever_was_asked_before_and_beside(seed):
    rng = np.random.default_rng(seed)
    sets = _sets(rng)
    together, losses = _problem().solve(sets)
    busy = _problem()
    busy.solve(_sets(rng))  # other places in the store, products known already
    for row in rng.permutation(len(sets))[:20]:
        shares, loss = busy.solve([sets[row]])
        np.testing.assert_array_equal(shares[0], together[row])
        assert loss[0] == losses[row]


def test_losses_are_those_of_least_squares():
    problem = _problem()
    sets = problem.independent(_sets(np.random.default_rng(2)))
    _, losses = problem.solve(sets)
    for terms, loss in zip(sets, losses, strict=True):
        rss = least_squares(problem.columns(terms), problem.y)[1]
        assert loss == pytest.approx(rss / problem.total, rel=1e-6)


def test_a_product_is_taken_once_for_all_who_use_the_pair():
    asked = []

    def compute(first, second):
        asked.extend(zip(first.tolist(), second.tolist(), strict=True))
        return first + 1000.0 * second

    products = PairProducts(compute, bits=12)
    rng = np.random.default_rng(3)
    first, second = rng.integers(12, size=(2, 400))
    values = products.of(first, second)
    low, high = np.minimum(first, second), np.maximum(first, second)
    np.testing.assert_array_equal(values, low + 1000.0 * high)
    np.testing.assert_array_equal(products.of(second, first), values)
    assert len(asked) == len(set(asked)) == len(set(zip(low.tolist(), high.tolist(), strict=True)))
    products.forget()
    products.of(first, second)
    assert products.computed == 2 * len(set(asked))


def test_a_table_too_small_for_its_pairs_is_slow_and_right():
    products = PairProducts(lambda i, j: i + 1000.0 * j, bits=3)
    rng = np.random.default_rng(4)
    for _ in range(20):
        first, second = rng.integers(200, size=(2, 100))
        low, high = np.minimum(first, second), np.maximum(first, second)
        np.testing.assert_array_equal(products.of(first, second), low + 1000.0 * high)


def test_gathered_equations_are_the_products_written_out():
    rng = np.random.default_rng(5)
    columns, y = rng.normal(size=(30, 40)), rng.normal(size=40)
    sets = [rng.permutation(30)[: rng.integers(0, 7)].tolist() for _ in range(50)]
    table = PairProducts(lambda i, j: np.einsum("pr,pr->p", columns[i], columns[j]))
    gram = gathered(table, columns @ y, float(y @ y), slots_of(sets))
    for row, places in enumerate(sets):
        n = len(places)
        np.testing.assert_allclose(gram.matrix[row, :n, :n], columns[places] @ columns[places].T)
        np.testing.assert_allclose(gram.moment[row, :n], columns[places] @ y)
        rest = gram.matrix.shape[1] - n
        np.testing.assert_array_equal(gram.matrix[row, n:, n:], np.eye(rest))
        assert not np.any(gram.matrix[row, n:, :n]) and not np.any(gram.used[row, n:])


def _kept_one_by_one(rule, matrix, moment, total, ridge):
    """Eq. 12 as it is written, one individual, one removal after the other."""

    def rss_of(kept):
        block, b = matrix[np.ix_(kept, kept)], moment[kept]
        try:
            xi = np.linalg.solve(block + ridge * np.eye(len(kept)), b)
        except np.linalg.LinAlgError:
            return np.full(len(kept), np.nan), np.inf
        return xi, max(float(total + np.sum(xi * (block @ xi - 2.0 * b))), 0.0)

    kept = list(range(len(moment)))
    xi, rss = rss_of(kept)
    allowed = max(rss * (1.0 + rule.tolerance), rule.floor * total)
    while len(kept) > 1:
        limit = rule.sigma * np.max(np.abs(xi))
        small = [k for k, v in zip(kept, xi, strict=True) if abs(v) <= limit][: len(kept) - 1]
        if not small:
            break
        trials = [small, *([k] for k in small)]
        costs = [rss_of([k for k in kept if k not in trial])[1] for trial in trials]
        best = 0 if costs[0] <= allowed else int(np.argmin(costs))
        if costs[best] > allowed:
            break
        kept = [k for k in kept if k not in trials[best]]
        xi, _ = rss_of(kept)
    return kept


@pytest.mark.parametrize("ridge", [0.0, 1e-10])
@pytest.mark.parametrize("seed", range(15))
def test_thresholds_in_batch_decide_as_one_by_one(seed, ridge):
    rng = np.random.default_rng(seed)
    rule = HardThreshold(
        sigma=float(rng.choice([1e-4, 0.1, 0.5, 0.9])), tolerance=float(rng.choice([0, 1e-3, 0.3]))
    )
    count, width, rows = 40, 8, 30
    y = rng.normal(size=rows)
    y /= np.linalg.norm(y)
    matrix = np.tile(np.eye(width), (count, 1, 1))
    moment, used = np.zeros((count, width)), np.zeros((count, width), dtype=bool)
    for k in range(count):
        n = int(rng.integers(1, width + 1))
        theta = rng.normal(size=(n, rows)) + rng.choice([0.0, 3.0]) * rng.normal(size=rows)
        if k % 4 == 1:  # most of the target in two columns
            theta[0] = y + 1e-3 * theta[0]
        if k % 5 == 2:  # orthonormal columns of equal shares: ties
            theta = np.eye(rows)[:n]
        theta /= np.linalg.norm(theta, axis=1, keepdims=True)
        own = y if k % 5 != 2 else np.full(rows, rows**-0.5)
        if k % 7 == 3 and n > 1:
            theta[-1] = 0.0  # singular without a ridge
        matrix[k, :n, :n], moment[k, :n], used[k, :n] = theta @ theta.T, theta @ own, True
    gram = GramBatch(matrix, moment, used, 1.0)
    kept = rule.keep_many(gram, ridge)
    lost = 0
    for k in range(count):
        n = int(used[k].sum())
        expected = _kept_one_by_one(rule, matrix[k, :n, :n], moment[k, :n], 1.0, ridge)
        assert np.flatnonzero(kept[k]).tolist() == expected
        assert rule.keep(matrix[k, :n, :n], moment[k, :n], 1.0, ridge) == expected
        lost += n - len(expected)
    assert lost or rule.sigma * rule.tolerance < 1e-3  # the rule had something to decide


def test_pruning_many_is_pruning_each():
    problem = _problem(rules=Rules(threshold=HardThreshold(sigma=0.3, tolerance=0.01)))
    sets = problem.independent(_sets(np.random.default_rng(6)))
    pruned = problem.prune_many(sets)
    assert pruned == [problem.prune(terms) for terms in sets]
    assert sum(map(len, pruned)) < sum(map(len, sets))


@pytest.mark.parametrize("noise", [0.1, 0.0])
def test_samples_in_pieces_are_weighed_as_samples_held(noise):
    n = 2 * ROWS + 137
    held, streamed = _problem(n, noise), _problem(n, noise, resources=Resources(limit_bytes=2**20))
    assert type(held._weighing.store) is not type(streamed._weighing.store)
    rng = np.random.default_rng(7)
    sets = held.independent([*_sets(rng), TERMS[:3], [TERMS[0], TERMS[1], TERMS[6]]])
    assert streamed.independent([list(terms) for terms in sets]) == sets
    for one, other in zip(held.solve(sets), streamed.solve(sets), strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-10)
    exact = held.solve(sets)[1][-1], streamed.solve(sets)[1][-1]
    assert noise or max(exact) < 1e-24
    assert streamed.prune_many(sets) == held.prune_many(sets)
    shares = np.ones(len(sets[0]))
    np.testing.assert_allclose(
        streamed.in_units(sets[0], shares), held.in_units(sets[0], shares), rtol=1e-12
    )


def test_products_in_pieces_are_the_same_bits_in_any_company():
    sets = _sets(np.random.default_rng(8), count=20)
    n = 3 * ROWS + 11
    together = _problem(n, resources=Resources(limit_bytes=2**18)).solve(sets)[1]
    alone = _problem(n, resources=Resources(limit_bytes=2**18))
    assert [alone.solve([terms])[1][0] for terms in reversed(sets)] == together[::-1].tolist()


def test_pieces_know_what_cannot_be_used_and_integrals():
    n = ROWS + 50
    problem, held = _problem(n, resources=Resources(limit_bytes=2**20)), _problem(n)
    texts = ("sqrt(x)", "1/t", "0*x", "integral(x)", "x*integral_over(x, z)")
    terms = [parse(s, NAMES, integrals=True) for s in texts]
    assert problem.index(terms)[:3] == [-1, -1, -1]
    sets = [[term] for term in terms]
    np.testing.assert_allclose(problem.solve(sets)[1], held.solve(sets)[1], rtol=1e-9)


def test_a_problem_forgets_and_finds_the_same_again():
    sets = _sets(np.random.default_rng(9))
    problem = _problem()
    before = problem.solve(sets)[1]
    problem.forget()
    np.testing.assert_array_equal(problem.solve(sets)[1], before)


@pytest.mark.parametrize("rows", [400, 2 * ROWS])
def test_another_evaluator_gives_the_same_losses(rows):
    sets = _sets(np.random.default_rng(10), count=10)
    limit = 192 * 2**20 if rows == 400 else 2**20
    own = _problem(rows, resources=Resources(limit_bytes=limit)).solve(sets)[1]
    other = _problem(rows, resources=Resources(Interpreted, limit)).solve(sets)[1]
    np.testing.assert_allclose(own, other, rtol=1e-9)


@pytest.mark.parametrize("degree", [2, 4, 6])
@pytest.mark.parametrize("noise", [0.0, 1e-12, 1e-7, 1e-5])
def test_a_refined_loss_is_that_of_an_orthogonal_factorisation(degree, noise):
    rng = np.random.default_rng(degree)
    x = rng.uniform(0.5, 1.5, size=400)
    theta = np.array([x**k for k in range(degree + 1)])  # ill-conditioned for the higher ones
    theta, _ = scale_columns(theta)
    y = rng.normal(size=degree + 1) @ theta
    y = y / np.linalg.norm(y) + noise * rng.normal(size=400)
    gram = theta @ theta.T
    damped = np.linalg.solve(gram + 1e-10 * np.eye(len(gram)), theta @ y)
    least = least_squares(theta.T, y)[1]
    refined = refined_loss(theta, gram, y, damped)
    assert refined == pytest.approx(least, rel=1e-6, abs=1e-26)


def test_a_refined_loss_of_columns_that_depend_is_still_a_loss():
    rng = np.random.default_rng(11)
    theta, _ = scale_columns(rng.normal(size=(3, 100)))
    theta = np.array([*theta, theta[1], theta[0]])
    y = theta[0] - 2.0 * theta[1]
    xi = np.array([0.5, -1.0, 0.0, -1.0, 0.5]) + 1e-6
    assert refined_loss(theta, theta @ theta.T, y, xi) < 1e-24


@pytest.mark.slow
def test_memory_stays_far_below_that_of_the_columns_weighed():
    told = memory(100_000, 60, 32 * 2**20)
    library = 8 * 100_000 * 1000  # small terms alone are more than a thousand columns
    assert told["peak_bytes"] - told["before_bytes"] < library / 2
