"""Ridge, threshold, constants, intervals and criteria against closed forms."""

from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import lfilter

from jaxsr._result import InputError
from jaxsr.expressions import Term, parse
from jaxsr.regression import (
    ElasticNetRule,
    GramBatch,
    HardThreshold,
    RegressionProblem,
    Resources,
    Rules,
    aic,
    bic,
    coefficient_ci95,
    constants_of,
    elastic_net,
    gather_gram,
    least_squares,
    scale_columns,
    signed_least_squares,
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


def test_a_solution_is_the_same_bits_whoever_is_solved_beside_it():
    rng = np.random.default_rng(1)
    columns, _ = scale_columns(rng.normal(size=(40, 50)))
    y = rng.normal(size=50)
    index = np.array([[*rng.permutation(40)[:n], *[-1] * (20 - n)] for n in range(1, 21)] * 20)
    gram = gather_gram(columns, y, index)
    together = solve_ridge(gram)
    for row in rng.permutation(len(index))[:60]:
        n = int(np.sum(index[row] >= 0))
        part = GramBatch(
            gram.matrix[[row], :n, :n], gram.moment[[row], :n], gram.used[[row], :n], gram.total
        )
        np.testing.assert_array_equal(solve_ridge(part)[0], together[row, :n])


def test_a_singular_system_is_nan_and_harms_no_other():
    rng = np.random.default_rng(2)
    columns, _ = scale_columns(rng.normal(size=(9, 30)))
    columns[3] = 0.0
    index = np.array([[0, 1], [2, 3], [3, 3], [4, 5], [6, -1]])
    gram = gather_gram(columns, rng.normal(size=30), index)
    xi = solve_ridge(gram, 0.0)
    assert np.all(np.isnan(xi[[1, 2]]))
    alone = GramBatch(gram.matrix[[3]], gram.moment[[3]], gram.used[[3]], gram.total)
    np.testing.assert_array_equal(xi[3], solve_ridge(alone, 0.0)[0])
    np.testing.assert_allclose(xi[3], np.linalg.solve(gram.matrix[3], gram.moment[3]), rtol=1e-13)
    assert np.all(np.isfinite(xi[[0, 4]]))


def test_one_compilation_serves_every_population_of_a_bucket():
    rng = np.random.default_rng(1)
    columns, _ = scale_columns(rng.normal(size=(40, 50)))
    y = rng.normal(size=50)

    def solve(individuals, terms):
        solve_ridge(gather_gram(columns, y, rng.integers(40, size=(individuals, terms))))

    solve(100, 6)
    before = compiled_shapes()
    for individuals, terms in [(65, 5), (300, 8), (90, 7)]:
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


def test_storage_is_bounded_and_forgetting_changes_no_result():
    rng = np.random.default_rng(9)
    small, _, _ = _problem(rng, resources=Resources(limit_bytes=2**20))
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


@pytest.mark.parametrize("mix", [1.0, 0.5])
@pytest.mark.parametrize("seed", range(5))
def test_elastic_net_meets_the_kkt_conditions(mix, seed):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(150, 8)) @ (np.eye(8) + 0.3 * rng.normal(size=(8, 8)))
    theta *= np.logspace(-3, 3, 8)  # units differ: the penalty must not care
    y = theta[:, [0, 3, 6]] @ [4e3, -2.0, 1e-2] + 0.2 * rng.normal(size=150)
    rule = ElasticNetRule(strength=0.05, mix=mix)
    xi, penalty = elastic_net(theta, y, rule)
    norms = np.linalg.norm(theta, axis=0)
    unit, weights = theta / norms, xi * norms
    # stationarity: theta^T r = lambda (rho sign(xi) + (1 - rho) xi), or less where xi = 0
    slope = unit.T @ (y - unit @ weights) / np.linalg.norm(y)
    scaled, lam = weights / np.linalg.norm(y), penalty / np.linalg.norm(y)
    active = xi != 0.0
    assert 0 < np.count_nonzero(active) < 8
    expected = lam * (mix * np.sign(scaled) + (1.0 - mix) * scaled)
    np.testing.assert_allclose(slope[active], expected[active], atol=float(1e-6 * lam))
    assert np.all(np.abs(slope[~active]) <= lam * mix * (1.0 + 1e-6))


def test_at_full_strength_nothing_is_selected_and_at_little_all_is_least_squares():
    rng = np.random.default_rng(12)
    theta, y = rng.normal(size=(100, 4)), rng.normal(size=100)
    assert not np.any(elastic_net(theta, y, ElasticNetRule(strength=1.0, mix=1.0))[0])
    xi, _ = elastic_net(theta, y, ElasticNetRule(strength=1e-9, mix=1.0))
    np.testing.assert_allclose(xi, least_squares(theta, y)[0], rtol=1e-6)
    with pytest.raises(InputError, match="strength"):
        ElasticNetRule(strength=0.0)


@pytest.mark.parametrize("penalty", ["lasso", "elastic_net"])
def test_a_library_is_thinned_to_the_law_and_refitted_without_bias(penalty):
    problem, _, _ = _problem(np.random.default_rng(13))
    names = ["t", "x", "z"]
    texts = ("x", "z", "sin(2.5*t + 0.4)", "t", "x*z", "x**2.0", "cos(3.0*t)")
    library = [parse(s, names) for s in texts]
    fit = problem.fit(library, penalty=penalty, rule=ElasticNetRule(strength=0.2))
    np.testing.assert_allclose(fit.coefficients, [3.0, -2.0, 5.0, 0, 0, 0, 0], atol=1e-12)
    assert fit.loss < 1e-24
    shrunk = problem.fit(library, penalty=penalty, rule=ElasticNetRule(strength=0.2, refit=False))
    assert np.all(np.abs(shrunk.coefficients[:3]) < [3.0, 2.0, 5.0])
    with pytest.raises(InputError, match="penalty"):
        problem.fit(library, penalty=cast(Any, "subset"))


@pytest.mark.parametrize("seed", range(10))
def test_signed_least_squares_meets_the_kkt_conditions(seed):
    rng = np.random.default_rng(seed)
    theta, y = rng.normal(size=(80, 6)), rng.normal(size=80)
    sign = rng.integers(-1, 2, size=6).astype(float)
    xi, rss = signed_least_squares(theta, y, sign)
    slope = theta.T @ (y - theta @ xi)  # minus the gradient
    assert np.all(xi * sign >= 0.0)
    free = (sign == 0.0) | (xi != 0.0)
    np.testing.assert_allclose(slope[free], 0.0, atol=1e-9)
    assert np.all(slope[~free] * sign[~free] <= 1e-9)  # a bound only holds against a pull outward
    assert rss >= least_squares(theta, y)[1] - 1e-12


def test_signs_hold_in_every_way_a_problem_weighs():
    rng = np.random.default_rng(14)
    x, v = rng.normal(size=(2, 200))
    y = -4.0 * x + 0.3 * v + 0.5 * np.sin(2.0 * x) + 0.1 * rng.normal(size=200)
    names = ["x", "v"]
    (tx, tv, wave) = (parse(s, names) for s in ("x", "v", "sin(1.9*x)"))
    problem = RegressionProblem(
        y, {"x": x, "v": v}, rules=Rules(signs={tv: -1, tx: -1})
    )  # damping: against v
    fit = problem.fit([tx, tv])
    assert fit.coefficients[1] == 0.0
    alone = problem.fit([tx])
    assert fit.coefficients[0] == pytest.approx(alone.coefficients[0], rel=1e-10)
    shares, losses = problem.solve([[tx, tv], [tx], [tv, wave]])
    assert shares[0][1] == 0.0 and shares[2][0] == 0.0
    assert losses[0] == pytest.approx(losses[1], rel=1e-6)
    ((_, loss),) = problem.refine_many([[tx, tv, wave]])
    free = RegressionProblem(y, {"x": x, "v": v}).refine([tx, tv, wave])[1]
    assert loss > free
    assert problem.fit([tx, tv], signs={tv: 1}).coefficients[1] > 0.0
    with pytest.raises(InputError, match="sign"):
        RegressionProblem(y, {"x": x, "v": v}, rules=Rules(signs={tv: 2}))


@pytest.mark.parametrize(("correlation", "least"), [(0.0, 0.92), (0.7, 0.90)])
def test_intervals_cover_both_coefficients_over_200_seeds(correlation, least):
    """Coverage of nominal 95 % over 200 seeds and two coefficients.

    White noise: at most 8 % of intervals may miss (binomial: 400 draws of 5 % exceed 8 % with
    probability 0.5 %). AR(1) noise at 0.7 leaves about 70 independent samples of 400, so an
    estimated covariance falls short: at most 10 % may miss, against about 40 % if rows were taken
    as independent.
    """
    covered, naive, n = 0, 0, 400
    for seed in range(200):
        rng = np.random.default_rng(seed)
        noise = lfilter([1.0], [1.0, -correlation], rng.normal(size=n + 50))[50:]
        theta = np.column_stack([np.ones(n), np.sin(np.linspace(0.0, 9.0, n))])
        truth = np.array([1.0, 2.0])
        y = theta @ truth + noise
        xi, _ = least_squares(theta, y)
        ends = coefficient_ci95(theta, y - theta @ xi, xi)
        covered += np.count_nonzero((ends[:, 0] <= truth) & (truth <= ends[:, 1]))
        ends = coefficient_ci95(theta, y - theta @ xi, xi, lags=0)
        naive += np.count_nonzero((ends[:, 0] <= truth) & (truth <= ends[:, 1]))
    assert covered / 400 >= least
    if correlation:
        assert naive / 400 < 0.75
    else:
        assert covered / 400 <= 0.985  # nor are they wide for safety
