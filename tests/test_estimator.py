"""SymbolicSparseRegressor: scikit-learn's protocol, its forms, several outputs, bad input."""

import pickle
import warnings

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pandas as pd
import pytest
import sympy
from sklearn.base import clone
from sklearn.model_selection import cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils.estimator_checks import parametrize_with_checks

import jaxsr
from jaxsr._result import StoppedBy
from jaxsr.expressions import parse, to_numpy, to_text

matplotlib.use("Agg")

# Every check passes; a check that must fail would be named here, with its reason.
EXPECTED_FAILURES: dict[str, str] = {}


@pytest.mark.long
@parametrize_with_checks(
    [jaxsr.SymbolicSparseRegressor(population=20, generations=1, random_state=0)],
    expected_failed_checks=lambda estimator: EXPECTED_FAILURES,
)
def test_scikit_learn_protocol(estimator, check):
    check(estimator)


def _law(rng, n=150, noise=0.0):
    X = rng.uniform(-2.0, 2.0, size=(n, 3))
    y = 2.0 * X[:, 0] ** 2 - 3.0 * X[:, 1] + 0.5
    return X, y + noise * rng.normal(size=n)


def _quick(**options):
    options = {"population": 60, "generations": 25, "random_state": 0, **options}
    return jaxsr.SymbolicSparseRegressor(**options)


@pytest.fixture(scope="module")
def fitted():
    X, y = _law(np.random.default_rng(0))
    return _quick().fit(X, y), X, y


@pytest.fixture(scope="module")
def two():
    X, y = _law(np.random.default_rng(1))
    Y = pd.DataFrame({"lift": y, "drag": X[:, 2] * np.abs(X[:, 2])})
    frame = pd.DataFrame(X, columns=["alpha", "beta", "v"])
    return _quick().fit(frame, Y), frame, Y


@pytest.mark.long
def test_law_is_found_with_intervals_that_hold_it(fitted):
    model, _, _ = fitted
    terms = dict(zip(map(to_text, model.terms_), model.coef_, strict=True))
    assert terms == pytest.approx({"x0**2": 2.0, "x1": -3.0, "1.0": 0.5}, rel=1e-9)
    noisy = _quick().fit(*_law(np.random.default_rng(2), n=300, noise=0.3))
    low, high = noisy.intervals_.T
    assert np.all(low < noisy.coef_) and np.all(noisy.coef_ < high)


def test_forms_agree_with_predict(fitted):
    model, X, y = fitted
    symbols = sympy.symbols("x0 x1 x2", real=True)
    by_sympy = sympy.lambdify(symbols, model.sympy())(*X.T)
    np.testing.assert_allclose(model.predict(X), by_sympy, rtol=1e-12)
    np.testing.assert_array_equal(model.to_numpy()(X), model.predict(X))
    with jax.enable_x64(True):
        by_jax = model.to_jax()
        np.testing.assert_allclose(jax.jit(by_jax)(jnp.asarray(X)), y, rtol=1e-10)
        slopes = jax.vmap(jax.grad(by_jax))(jnp.asarray(X))
        expected = np.column_stack([4.0 * X[:, 0], np.full(len(X), -3.0), np.zeros(len(X))])
        np.testing.assert_allclose(slopes, expected, atol=1e-9)
    assert model.latex(2) == "2.0 x_{0}^{2} - 3.0 x_{1} + 0.5"


def test_front_has_one_pick_and_every_row_can_be_asked_for(fitted):
    model, X, y = fitted
    table = model.equations_
    names = ["complexity", "size", "loss", "validation_loss", "score", "equation", "picked"]
    assert list(table.columns) == names and table is model.pareto_
    assert table.picked.sum() == 1 and table["size"].is_monotonic_increasing
    for index, row in table.iterrows():
        assert np.mean((y - model.predict(X, index=index)) ** 2) == pytest.approx(
            row.loss, rel=0.5, abs=1e-20
        )
        text = parse(row.equation)
        values = to_numpy(text)({f"x{k}": X[:, k] for k in range(3)})
        np.testing.assert_allclose(
            np.broadcast_to(values, len(X)), model.predict(X, index=index), atol=1e-3, rtol=1e-4
        )
        assert str(model.sympy(index)) and model.latex(index=index)
    # the score is the slope of log loss against the best smaller candidate
    falls = table[table.score > 0.0]
    k, last = falls.index[1], falls.index[0]
    slope = np.log(table.loss[last] / table.loss[k]) / (table["size"][k] - table["size"][last])
    assert falls.score[k] == pytest.approx(slope)
    with pytest.raises(ValueError, match="equation 99"):
        model.predict(X, index=99)


def test_names_come_from_the_frame_or_the_call():
    X, y = _law(np.random.default_rng(0))
    model = _quick().fit(X, y, variable_names=["q", "w", "u"])
    assert {str(s) for s in model.sympy().free_symbols} == {"q", "w"}
    odd = pd.DataFrame(X, columns=["a b", "sin", "c"])
    assert _quick(generations=1).fit(odd, y).names_ == ["x0", "x1", "x2"]
    for names in (["q", "w"], ["q", "q", "u"], ["q", "w", "lambda"]):
        with pytest.raises(ValueError, match="variable_names"):
            _quick().fit(X, y, variable_names=names)


@pytest.mark.long
def test_several_outputs_have_an_equation_each(two):
    model, X, Y = two
    assert model.target_names_ == ["lift", "drag"]
    assert [e.state for e in model.found_] == ["lift", "drag"]
    lift, drag = model.sympy()
    v = sympy.Symbol("v", real=True)
    assert drag.free_symbols == {v} and len(lift.free_symbols) == 2
    np.testing.assert_allclose(model.predict(X), Y, rtol=1e-8, atol=1e-10)
    assert len(model.equations_) == len(model.coef_) == len(model.latex()) == 2
    with jax.enable_x64(True):
        np.testing.assert_allclose(model.to_jax()(jnp.asarray(X)), Y, rtol=1e-8, atol=1e-10)
    assert model.score(X, Y) == pytest.approx(1.0)


def test_it_pickles_clones_and_works_in_a_pipeline(two, fitted):
    model, X, _ = two
    back = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(back.predict(X), model.predict(X))
    assert back.latex() == model.latex()
    assert pickle.loads(pickle.dumps(model.to_numpy()))(X.to_numpy()).shape == (len(X), 2)
    again = clone(model)
    assert again.get_params() == model.get_params() and not hasattr(again, "found_")
    X = fitted[1]
    pipe = make_pipeline(FunctionTransformer(np.abs), _quick(generations=3))
    assert np.mean(cross_val_score(pipe, X, np.abs(X[:, 0]), cv=2)) == pytest.approx(1.0)


@pytest.mark.slow
def test_same_seed_same_equation_and_a_generator_moves_on():
    X, y = _law(np.random.default_rng(3), noise=0.1)
    options = {"population": 30, "generations": 4}
    first, second = (_quick(**options).fit(X, y) for _ in range(2))
    assert first.equations_.equals(second.equations_)
    state = np.random.RandomState(0)
    _quick(**options, random_state=state).fit(X, y)
    assert state.randint(1 << 30) != np.random.RandomState(0).randint(1 << 30)


LAW = "sin(2.3*x0)*exp(-0.4*x1) + tanh(1.7*x2)*x0"


def test_guesses_are_started_from_and_refined():
    rng = np.random.default_rng(0)
    X = rng.uniform(-2.0, 2.0, size=(200, 3))
    y = to_numpy(parse(LAW))({f"x{k}": X[:, k] for k in range(3)})
    options = {"population": 20, "generations": 2, "functions": ("add", "mul", "sin", "exp")}
    assert _quick(**options).fit(X, y).score(X, y) < 0.999
    near = "sin(2.2*x0)*exp(-0.5*x1) + tanh(1.5*x2)*x0"
    for guesses in ([near], [near.split(" + ")]):
        model = _quick(guesses=guesses, **options).fit(X, y)
        assert model.score(X, y) == pytest.approx(1.0, abs=1e-9)
    for bad, match in ((["x0 + nope"], "nope"), ("x0", "list"), ([["x0", "1 +"]], "cannot read")):
        with pytest.raises(ValueError, match=match):
            _quick(guesses=bad).fit(X, y)


@pytest.mark.slow
def test_warm_start_goes_on_from_the_last_front():
    X, y = _law(np.random.default_rng(4))
    y = y + np.sin(3.0 * X[:, 2]) * X[:, 0]
    model = _quick(population=20, generations=3, warm_start=True)
    losses = [model.fit(X, y).equations_.loss.min() for _ in range(3)]
    assert losses[2] <= losses[1] <= losses[0] and losses[2] < 0.8 * losses[0]
    cold = _quick(population=20, generations=3)
    assert cold.fit(X, y).equations_.equals(cold.fit(X, y).equations_)


@pytest.mark.parametrize("value", [0.0, 3.5, -1e-8])
def test_constant_target_gives_a_constant(value):
    X = np.random.default_rng(0).normal(size=(40, 2))
    model = _quick().fit(X, np.full(40, value))
    np.testing.assert_array_equal(model.predict(X), np.full(40, value))
    assert float(model.sympy()) == pytest.approx(value)
    assert len(model.equations_) == 1 and model.equations_.picked.all()
    assert np.shape(model.to_jax()(jnp.asarray(X))) == (40,)


@pytest.mark.long
@pytest.mark.parametrize("samples", [1, 2, 3, 5, 8])
def test_fewer_samples_than_terms_never_crash_nor_interpolate_noise(samples):
    rng = np.random.default_rng(samples)
    X, y = rng.normal(size=(samples, 4)), rng.normal(size=samples)
    model = _quick(generations=4).fit(X, y)
    assert len(model.terms_) < max(2, samples)
    assert np.all(np.isfinite(model.predict(X)))


@pytest.mark.parametrize(
    ("X", "y", "match"),
    [
        ([[1.0], [np.nan]], [1.0, 2.0], "NaN"),
        ([[1.0], [2.0]], [1.0, np.inf], "infinity"),
        ([[1.0], [2.0]], [1.0], "inconsistent"),
        ([1.0, 2.0], [1.0, 2.0], "2D"),
        (np.zeros((0, 2)), [], "0 sample"),
        ([["a"], ["b"]], [1.0, 2.0], "could not convert|string"),
    ],
)
def test_bad_data_are_refused(X, y, match):
    with pytest.raises(ValueError, match=match):
        _quick().fit(X, y)


@pytest.mark.parametrize(
    "options",
    [{"validation_fraction": 1.0}, {"functions": ("nope",)}, {"population": 3}, {"budget": -1.0},
     {"generations": 0}, {"n_jobs": 0}],
)  # fmt: skip
def test_bad_parameters_are_refused_at_fit(options):
    with pytest.raises(ValueError) as error:
        _quick(**options).fit(*_law(np.random.default_rng(0)))
    assert "\n" not in str(error.value)


def test_a_configuration_stands_for_the_single_settings_and_jobs_change_nothing():
    X, y = _law(np.random.default_rng(0))
    config = jaxsr.SearchConfig(population=60, generations=5)
    single = _quick(generations=5).fit(X, y)
    whole = _quick(population=7, generations=1, config=config, n_jobs=1).fit(X, y)
    assert whole.terms_ == single.terms_
    np.testing.assert_array_equal(whole.coef_, single.coef_)


def test_where_a_term_is_not_finite_the_prediction_is_nan_with_a_warning():
    X = np.random.default_rng(0).uniform(0.1, 4.0, size=(120, 1))
    model = _quick(guesses=["sqrt(x0)"]).fit(X, 2.0 * np.sqrt(X[:, 0]))
    with pytest.warns(UserWarning, match="1 of 3 samples"):
        y = model.predict([[4.0], [-1.0], [1.0]])
    np.testing.assert_allclose(y, [4.0, np.nan, 2.0], rtol=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.predict(X)


def test_a_spent_budget_still_gives_an_equation():
    X, y = _law(np.random.default_rng(0))
    model = _quick(budget=1e-6).fit(X, y)
    assert model.stopped_by_ is StoppedBy.BUDGET
    assert model.score(X, y) > 0.3


def test_plots_draw_on_the_axes_given(fitted, two):
    import matplotlib.pyplot as plt

    for model, output in ((fitted[0], 0), (two[0], 1)):
        for draw in (model.plot_front, model.plot_fit, model.plot_residual):
            figure, (left, right) = plt.subplots(1, 2)
            assert draw(right, output=output) is right
            assert right.has_data() and not left.has_data()
            assert right.get_xlabel() and right.get_ylabel()
            figure.canvas.draw()
            plt.close(figure)
    ax = fitted[0].plot_front()
    assert ax is plt.gca()
    ringed = ax.get_lines()[2].get_xdata()
    table = fitted[0].equations_
    np.testing.assert_array_equal(ringed, table["size"][table.picked])
    plt.close("all")
