"""Data and primitives that are no good: a clear error or an infinite loss, never a crash."""

import warnings

import numpy as np
import pytest

import jaxsr
from jaxsr._result import InputError
from jaxsr.evolution import PrimitiveSet, SearchConfig, search
from jaxsr.expressions import define_primitive, parse
from jaxsr.recordings import Recording
from jaxsr.regression import RegressionProblem

QUICK = SearchConfig(population=20, refined=2, generations=3, restarts=0, patience=2)


def _found(y, variables, config=QUICK):
    state, _ = search(np.random.default_rng(0), RegressionProblem(y, variables), config)
    members = [*state.population, *state.front.members]
    assert all(np.isfinite(m.loss) and m.loss >= 0.0 for m in members)
    return state


def test_a_constant_target_is_a_constant():
    x = np.random.default_rng(0).normal(size=50)
    state = _found(np.full(50, 3.0), {"x": x})
    assert [t for t in state.front.members[0].terms] == [parse("1.0")]
    _found(np.zeros(50), {"x": x})


def test_a_constant_derivative_is_discovered_as_one():
    t = np.linspace(0.0, 1.0, 60)
    record = Recording("a", t, {"x": 3.0 * t, "dx": np.full(60, 3.0)})
    (equation,) = jaxsr.discover([record], states=["x"], derivatives=["dx"], config=QUICK).equations
    assert equation.term.is_constant and equation.term.value == pytest.approx(3.0)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_target_that_is_not_finite_is_refused_and_a_variable_left_out(value):
    rng = np.random.default_rng(0)
    x, z = rng.normal(size=(2, 50))
    bad = x.copy()
    bad[7] = value
    with pytest.raises(InputError, match="not finite"):
        RegressionProblem(bad, {"x": x})
    state = _found(2.0 * z, {"x": bad, "z": z})
    assert all("x" not in t.variables for m in state.front.members for t in m.terms)
    assert state.front.best_loss < 1e-20


def test_a_recording_of_nothing_but_gaps_is_refused():
    t = np.linspace(0.0, 1.0, 50)
    record = Recording("a", t, {"x": np.sin(t), "dx": np.full(50, np.nan)})
    with pytest.raises(InputError) as error:
        jaxsr.discover([record], states=["x"], derivatives=["dx"], config=QUICK)
    assert "\n" not in str(error.value)


@pytest.mark.long
@pytest.mark.parametrize("rows", [1, 2, 3, 5])
def test_so_few_samples_that_there_are_more_terms_than_rows(rows):
    rng = np.random.default_rng(rows)
    variables = dict(zip("xvw", rng.normal(size=(3, rows)), strict=True))
    problem = RegressionProblem(rng.normal(size=rows), variables)
    terms = [parse(s) for s in ("x", "v", "w", "x*v", "x*w", "v*w", "sin(x)")]
    _, losses = problem.solve([terms])
    assert losses[0] == np.inf or 0.0 <= losses[0] < 1.0
    assert len(problem.independent([terms])[0]) <= rows
    assert np.all(np.isfinite(problem.fit(terms).coefficients))
    _found(problem.y, variables)


@pytest.mark.parametrize("rows", [1, 2, 4])
def test_a_discovery_from_hardly_any_samples_ends(rows):
    t = np.linspace(0.0, 1.0, rows) if rows > 1 else np.zeros(1)
    channels = {"x": np.cos(t), "dx": -np.sin(t) - 0.1}
    try:
        record = Recording("a", t, channels)
        found = jaxsr.discover([record], states=["x"], derivatives=["dx"], config=QUICK, budget=3.0)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(found["x"].train_mse)


def test_a_variable_that_stands_still_or_repeats_another_does_no_harm():
    rng = np.random.default_rng(1)
    x = rng.normal(size=80)
    variables = {"x": x, "twin": x.copy(), "still": np.full(80, 2.0), "zero": np.zeros(80)}
    state = _found(3.0 * x**2 - x, variables)
    assert state.front.best_loss < 1e-20
    problem = RegressionProblem(x, variables)
    terms = [parse(s) for s in ("x*1.5", "twin", "still", "1.0", "x**2", "twin*x")]
    assert len(problem.independent([terms])[0]) == 3


def _shape_of_another(x):
    return x[:3] if len(x) > 9 else x * x


def _raises_on_long_columns(x):
    if len(x) > 9:
        raise RuntimeError("no more\nthan nine")
    return x * x


@pytest.mark.parametrize("function", [_shape_of_another, _raises_on_long_columns])
def test_a_primitive_that_fails_on_the_data_has_an_infinite_loss(function):
    name = function.__name__.strip("_")
    define_primitive(name, function)
    x = np.random.default_rng(2).normal(size=60)
    config = SearchConfig(
        population=20,
        refined=2,
        generations=3,
        patience=2,
        primitives=PrimitiveSet(functions=("add", "mul", name)),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        problem = RegressionProblem(2.0 * x, {"x": x})
        _, losses = problem.solve([[parse(f"{name}(x)")], [parse("x")]])
        assert losses[0] == np.inf and losses[1] < 1e-20
        state = _found(2.0 * x - x**2, {"x": x}, config)
    used = {node.op for m in state.population for term in m.terms for node in term.walk()}
    assert name not in used and state.front.best_loss < 1e-20


@pytest.mark.parametrize("function", [lambda x: x[:2], lambda x: 1 / 0, lambda x: "text"])
def test_a_primitive_that_never_works_is_refused_when_defined(function):
    with pytest.raises(InputError) as error:
        define_primitive("hopeless", function)
    assert "\n" not in str(error.value)
