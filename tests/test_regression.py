"""Ridge, threshold, constants, intervals and criteria against closed forms."""

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.expressions import Term, parse
from jaxsr.regression import (
    HardThreshold,
    RegressionProblem,
    aic,
    bic,
    coefficient_ci95,
    constants_of,
    gather_gram,
    least_squares,
    residual_frequencies,
    scale_columns,
    solve_ridge,
    with_constants,
)
from jaxsr.regression.ridge import compiled_shapes


def _problem(rng, n=300, **options):
    t = np.linspace(0.0, 10.0, n)
    x, z = rng.normal(size=(2, n))
    variables = {"t": t, "x": x, "z": z}
    y = 3.0 * x - 2.0 * z + 5.0 * np.sin(2.5 * t + 0.4)
    return RegressionProblem(y, variables, **options), y, variables


def test_batched_ridge_equals_least_squares_for_individuals_of_mixed_size():
    rng = np.random.default_rng(0)
    columns, norms = scale_columns(rng.normal(size=(30, 200)) * np.logspace(-6, 6, 30)[:, None])
    y = rng.normal(size=200)
    index = np.full((7, 6), -1)
    for row in range(7):
        index[row, : row % 6 + 1] = rng.permutation(30)[: row % 6 + 1]
    gram = gather_gram(columns, y, index)
    xi = solve_ridge(gram, ridge=0.0)
    for row in range(7):
        used = index[row][index[row] >= 0]
        exact, rss = least_squares((columns[used] * norms[used, None]).T, y)
        # float64 normal equations of well-conditioned columns: about 1e-12
        np.testing.assert_allclose(xi[row, : len(used)] / norms[used], exact, rtol=1e-10)
        assert gram.loss(xi)[row] == pytest.approx(rss, rel=1e-10)
        assert np.all(xi[row, len(used) :] == 0.0)


def test_ridge_shrinks_an_orthonormal_column_by_one_over_one_plus_lambda():
    columns = np.eye(3)
    gram = gather_gram(columns, np.array([2.0, 1.0, 0.0]), np.array([[0, 1]]))
    np.testing.assert_allclose(solve_ridge(gram, ridge=0.5)[0], [2.0 / 1.5, 1.0 / 1.5])


def test_one_compilation_serves_every_population_of_a_bucket():
    rng = np.random.default_rng(1)
    columns, _ = scale_columns(rng.normal(size=(40, 50)))
    y = rng.normal(size=50)

    def solve(individuals, terms):
        solve_ridge(gather_gram(columns, y, rng.integers(40, size=(individuals, terms))))

    solve(100, 6)
    before = compiled_shapes()
    for individuals, terms in [(65, 5), (128, 8), (90, 7)]:
        solve(individuals, terms)
    assert compiled_shapes() == before


@pytest.mark.parametrize("seed", range(5))
def test_hard_threshold_removes_the_negligible_and_keeps_the_small_that_matters(seed):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(400, 4))
    theta /= np.linalg.norm(theta, axis=0)
    y = theta @ np.array([5.0, -3.0, 2e-4, 0.0])  # 2e-4 is real: the data are exact
    gram, moment = theta.T @ theta, theta.T @ y
    kept = HardThreshold(sigma=1e-3).keep(gram, moment, float(y @ y), ridge=0.0)
    assert kept == [0, 1, 2]
    noisy = y + 0.01 * rng.normal(size=400)  # now it drowns
    kept = HardThreshold(sigma=1e-3).keep(gram, theta.T @ noisy, float(noisy @ noisy), ridge=0.0)
    assert set(kept) >= {0, 1}
    loose = HardThreshold(sigma=0.2, tolerance=0.05)
    assert loose.keep(gram, theta.T @ noisy, float(noisy @ noisy)) == [0, 1]


def test_hard_threshold_keeps_one_term_and_refuses_nonsense():
    assert HardThreshold().keep(np.eye(1), np.zeros(1), 1.0) == [0]
    with pytest.raises(InputError, match="sigma"):
        HardThreshold(sigma=1.0)


def test_constants_are_read_and_written_in_preorder_and_whole_exponents_stay():
    term = parse("sin(2.5*t + 0.5)*x**2.0/(x**1.5 + 3.0)", ["t", "x"])
    values = constants_of(term)
    assert values == [2.5, 0.5, 1.5, 3.0]
    assert with_constants(term, iter(values)) == term
    moved = with_constants(term, iter([1.0, 2.0, 3.5, 4.0]))
    assert constants_of(moved) == [1.0, 2.0, 3.5, 4.0]


@pytest.mark.parametrize("start", ["sin(2.4*t)", "sin(2.6*t + 1.0)"])
def test_variable_projection_finds_frequency_and_phase(start):
    problem, _, _ = _problem(np.random.default_rng(2))
    terms = [parse(s, ["t", "x", "z"]) for s in ("x", "z", start)]
    refined, loss = problem.refine(terms)
    if "+" not in start:
        assert loss > 1e-6  # without a phase the fit cannot be exact
        return
    # zero residual: quadratic convergence down to rounding
    assert loss < 1e-18
    np.testing.assert_allclose(constants_of(refined[2]), [2.5, 0.4], rtol=1e-8)


def test_refinement_never_makes_a_fit_worse():
    rng = np.random.default_rng(3)
    problem, _, _ = _problem(rng)
    for _ in range(20):
        a, b = rng.uniform(-4, 4, size=2)
        terms = [parse(f"sin({a}*t)/(x**2 + {abs(b)})", ["t", "x"]), Term.variable("x")]
        _, before = problem.solve([terms])
        _, after = problem.refine(terms)
        assert after <= before[0] * (1.0 + 1e-9)


def test_spectrum_of_the_residual_shows_the_frequency_on_irregular_samples():
    rng = np.random.default_rng(4)
    t = np.sort(rng.uniform(0.0, 20.0, 400))
    y = 3.0 * t + np.sin(7.3 * t + 1.0)
    problem = RegressionProblem(y, {"t": t})
    found = residual_frequencies(problem, [Term.variable("t"), Term.constant(1.0)], "t", 1)
    assert abs(found[0] - 7.3) < np.pi / 20.0  # within the resolution of the span


def test_fixed_columns_are_projected_out_as_if_fitted_together():
    rng = np.random.default_rng(5)
    x, z = rng.normal(size=(2, 200))
    y = 2.0 * x + 3.0 * z + x * z + 0.1 * rng.normal(size=200)
    problem = RegressionProblem(y, {"x": x, "z": z}, fixed=np.column_stack([x, np.ones(200)]))
    terms = [parse(s, ["x", "z"]) for s in ("z", "x*z")]
    fit = problem.fit(terms)
    full, rss = least_squares(np.column_stack([z, x * z, x, np.ones(200)]), y)
    np.testing.assert_allclose([*fit.coefficients, *fit.fixed], full, rtol=1e-10)
    assert fit.loss == pytest.approx(rss / 200, rel=1e-10)
    assert problem.index([Term.variable("x")]) == [-1]  # in the span of the fixed columns


def test_a_view_is_applied_to_every_column():
    rng = np.random.default_rng(6)
    x = rng.normal(size=100)
    a = rng.normal(size=(30, 100))
    problem = RegressionProblem(a @ (2.0 * x**2), {"x": x}, view=lambda columns: a @ columns)
    fit = problem.fit([parse("x**2", ["x"])])
    assert fit.coefficients[0] == pytest.approx(2.0, rel=1e-12)
    assert fit.loss < 1e-20


def test_terms_that_are_not_finite_on_the_data_are_infinite_loss_not_an_error():
    problem, _, _ = _problem(np.random.default_rng(7))
    bad = [parse(s, ["t", "x", "z"]) for s in ("sqrt(x)", "1/t", "exp(exp(exp(t)))")]
    _, losses = problem.solve([[term] for term in bad])
    assert np.all(np.isinf(losses))
    assert problem.refine([bad[0]])[1] == np.inf


def test_screen_ranks_the_term_that_is_missing_first():
    problem, _, _ = _problem(np.random.default_rng(8))
    library = [parse(s, ["t", "x", "z"]) for s in ("x", "z", "x*z", "t", "sin(2.5*t + 0.4)")]
    problem.index(library)
    assert problem.screen([library[0], library[1]], 1) == [library[4]]


def test_storage_is_bounded_and_forgetting_changes_no_result():
    rng = np.random.default_rng(9)
    small, _, _ = _problem(rng, limit_bytes=2**20)
    terms = [parse(f"sin({k / 100}*t)", ["t"]) for k in range(1, 900)]
    first = small.solve([[terms[5], terms[50]]])[1]
    small.index(terms)
    assert small.solve([[terms[5], terms[50]]])[1] == pytest.approx(first, rel=1e-12)


def test_intervals_cover_the_truth_also_where_noise_is_correlated():
    rng = np.random.default_rng(10)
    covered = {0: 0, None: 0}
    n, trials = 400, 300
    for _ in range(trials):
        noise = np.zeros(n)
        shock = rng.normal(size=n)
        for k in range(1, n):
            noise[k] = 0.7 * noise[k - 1] + shock[k]
        theta = np.column_stack([np.ones(n), np.linspace(-1, 1, n)])
        y = theta @ [1.0, 2.0] + noise
        xi, _ = least_squares(theta, y)
        for lags in covered:
            low, high = coefficient_ci95(theta, y - theta @ xi, xi, lags=lags)[0]
            covered[lags] += low <= 1.0 <= high
    # independent rows assumed: about 60 %; Newey-West at this length is short of 95 % but near
    assert covered[0] / trials < 0.75
    assert covered[None] / trials > 0.82


def test_interval_of_independent_noise_is_the_textbook_one():
    rng = np.random.default_rng(11)
    theta = rng.normal(size=(5000, 1))
    y = 2.0 * theta[:, 0] + 0.5 * rng.normal(size=5000)
    xi, rss = least_squares(theta, y)
    half = 1.96 * np.sqrt(rss / 4999 / np.sum(theta**2))
    low, high = coefficient_ci95(theta, y - theta @ xi, xi, lags=0)[0]
    assert (high - low) / 2.0 == pytest.approx(half, rel=0.05)
    short = coefficient_ci95(theta[:1], y[:1], xi)
    assert np.all(np.isinf(short))


def test_criteria_follow_eqs_10_and_11():
    assert aic(50.0, 100, 3) == pytest.approx(100 * np.log(0.5) + 6)
    assert bic(50.0, 100, 3) == pytest.approx(100 * np.log(0.5) + 3 * np.log(100))
    assert aic(0.0, 10, 1) == -np.inf
    with pytest.raises(InputError):
        bic(-1.0, 10, 1)


@pytest.mark.parametrize(
    ("y", "variables", "match"),
    [
        (np.array([1.0, np.nan]), {"x": np.ones(2)}, "finite"),
        (np.ones(3), {"x": np.ones(2)}, "rows"),
        (np.ones(2), {"x": np.ones(2), "z": np.ones(3)}, "differ"),
        (np.ones((2, 2)), {"x": np.ones(2)}, "vector"),
    ],
)
def test_wrong_arrays_are_refused_in_one_line(y, variables, match):
    with pytest.raises(InputError, match=match):
        RegressionProblem(y, variables)
