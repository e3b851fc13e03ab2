"""Primitives that a user defines, and integrals of columns."""

from __future__ import annotations

import pickle
import subprocess
import sys
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import sympy
from scipy.special import erf

from jaxsr._result import InputError
from jaxsr.evaluation import ColumnCache, compile_terms
from jaxsr.evolution import PrimitiveSet, SearchConfig, search
from jaxsr.evolution.create import random_term
from jaxsr.expressions import (
    PRIMITIVES,
    Term,
    define_primitive,
    evaluate,
    from_sympy,
    is_identifier,
    parse,
    to_numpy,
    to_sympy,
    to_text,
)
from jaxsr.expressions.editing import edit, simplify
from jaxsr.expressions.postfix import compile_postfix
from jaxsr.regression import RegressionProblem

NAMES = ["t", "x"]


def bump(x):
    return 1.0 / (1.0 + x * x)


def numpy_only(x):
    return np.where(np.asarray(x) > 0.0, np.tanh(np.asarray(x)), 0.0)


def blend(a, b, c):
    return a * c + b * (1.0 - c)


def moody(x):
    if np.max(np.abs(x)) > 2.0:
        raise RuntimeError("too far\nout")
    return x


def touchy(x):
    return moody(x)


def short_by_one(x):
    return x if np.max(np.abs(x)) <= 2.0 else x[:-1]


define_primitive("bump", bump)
define_primitive("numpy_only", numpy_only)
define_primitive("blend", blend)
define_primitive("moody", moody)
define_primitive("short_by_one", short_by_one)
define_primitive("touchy", touchy)


def test_a_defined_function_is_part_of_the_language() -> None:
    term = parse("3.0*bump(x - 1) + blend(x, t, 0.25)", NAMES)
    assert parse(to_text(term), NAMES) == term
    env = {"x": np.linspace(-1.0, 1.0, 7), "t": np.arange(7.0)}
    x, t = env["x"], env["t"]
    expected = 3.0 / (1.0 + (x - 1.0) ** 2) + 0.25 * x + 0.75 * t
    np.testing.assert_allclose(to_numpy(term)(env), expected, rtol=1e-14)
    np.testing.assert_allclose(compile_terms([term], NAMES).evaluate(np.stack([t, x], 1))[:, 0],
                               expected, rtol=1e-14)  # fmt: skip
    with jax.enable_x64(True):
        np.testing.assert_allclose(np.asarray(evaluate(term, env, "jax")), expected, rtol=1e-14)
    assert not is_identifier("bump")
    with pytest.raises(InputError, match="takes 1 arguments"):
        parse("bump(x, t)", NAMES)
    with pytest.raises(InputError, match="no postfix code"):
        compile_postfix([term], NAMES)


def test_constants_fold_through_a_defined_function() -> None:
    assert simplify(parse("bump(3)*x", NAMES)) == simplify(parse("0.1*x", NAMES))
    with pytest.warns(RuntimeWarning, match="primitive touchy raised"):
        assert edit([parse("x*touchy(5)", NAMES), parse("x", NAMES)]) == (parse("x", NAMES),)


def test_sympy_takes_the_meaning_given_or_an_undefined_function() -> None:
    define_primitive("error_function", erf, arity=1, sympy=sympy.erf)
    for text in ("bump(x)*x + 2.0", "error_function(2.0*x)", "blend(x, t, 0.5)"):
        term = parse(text, NAMES)
        back = from_sympy(to_sympy(term))
        env = {"x": 0.3, "t": 1.2}
        assert float(evaluate(back, env)) == pytest.approx(float(evaluate(term, env)))
    expression = to_sympy(parse("error_function(x)", NAMES))
    assert isinstance(expression, sympy.erf)


@pytest.mark.parametrize("text", ["bump(x)*x", "numpy_only(x)*x"])
def test_functions_are_differentiable_in_jax_even_where_jax_cannot_trace_them(text: str) -> None:
    term = parse(text, NAMES)
    at = np.array([0.3, 0.8, 1.5])
    with jax.enable_x64(True):

        def total(x):
            return jnp.sum(evaluate(term, {"x": x}, "jax"))

        value = jax.jit(jax.vmap(lambda x: evaluate(term, {"x": x}, "jax")))(at)
        slope = np.asarray(jax.jit(jax.grad(total))(jnp.asarray(at)))
    np.testing.assert_allclose(np.asarray(value), to_numpy(term)({"x": at}), rtol=1e-14)
    h = 1e-5
    plain = to_numpy(term)
    expected = (plain({"x": at + h}) - plain({"x": at - h})) / (2 * h)
    np.testing.assert_allclose(slope, expected, rtol=1e-8)


def test_functions_written_with_jax_numpy_give_float64() -> None:
    define_primitive("soft_abs", lambda x: jnp.logaddexp(x, -x))
    x = np.linspace(0.0, 1.0, 5)
    column = ColumnCache({"x": x}).column(parse("soft_abs(x)", NAMES))
    np.testing.assert_allclose(column, np.logaddexp(x, -x), rtol=1e-14)


@pytest.mark.parametrize("name", ["moody", "short_by_one"])
def test_a_function_that_fails_makes_its_term_unusable_and_warns_once(name: str) -> None:
    guarded = PRIMITIVES[name].numpy
    guarded.warned = False  # type: ignore[attr-defined]  # another test may have met it
    term = parse(f"{name}(x)", NAMES)
    near, far = np.linspace(0.0, 1.0, 50), np.linspace(0.0, 9.0, 50)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        np.testing.assert_array_equal(ColumnCache({"x": near}).column(term), near)
        assert not caught
        for _ in range(3):
            assert np.all(np.isnan(ColumnCache({"x": far}).column(term)))
    assert len(caught) == 1 and f"primitive {name} " in str(caught[0].message)
    assert "\n" not in str(caught[0].message)
    problem = RegressionProblem(far, {"x": far})
    assert problem.index([term, parse("x", NAMES)])[0] == -1
    assert problem.solve([[term]])[1][0] == np.inf


def test_a_function_cannot_change_the_columns_it_is_given() -> None:
    def greedy(x):
        x[...] = 0.0
        return x

    with pytest.raises(InputError, match="primitive greedy raised"):
        define_primitive("greedy", greedy)
    assert "greedy" not in PRIMITIVES


@pytest.mark.parametrize(
    ("name", "function", "arity", "match"),
    [
        ("sin", bump, None, "taken"),
        ("add", bump, None, "taken"),
        ("integral", bump, None, "taken"),
        ("two words", bump, None, "identifier"),
        ("lambda", bump, None, "identifier"),
        ("bump", numpy_only, None, "taken"),
        ("mean", lambda x: np.mean(x), None, r"returned shape \(\)"),
        ("pair", lambda x: np.stack([x, x]), None, "returned shape"),
        ("fails", lambda x: x.nothing, None, "raised AttributeError"),
        ("imaginary", lambda x: 1j * x, None, "complex"),
        ("words", lambda x: np.array(["a"] * len(x)), None, "real numbers"),
        ("many", lambda *args: args[0], None, "how many"),
        ("none", bump, 0, "at least 1"),
        ("wrong_count", bump, 2, "raised TypeError"),
        ("number", 3.0, 1, "must be a function"),
    ],
)
def test_definitions_that_cannot_work_are_refused_in_one_line(name, function, arity, match) -> None:
    before = set(PRIMITIVES)
    with pytest.raises(InputError, match=match) as caught:
        define_primitive(name, function, arity)
    assert "\n" not in str(caught.value)
    assert set(PRIMITIVES) == before


def test_the_same_definition_again_changes_nothing() -> None:
    first = define_primitive("cell_twice", lambda x: x * 2.0)
    for _ in range(2):  # as when a notebook's cell is run again
        again = define_primitive("cell_thrice", lambda x: x * 3.0)
        assert PRIMITIVES["cell_thrice"] is again
    assert define_primitive("bump", bump) is PRIMITIVES["bump"]
    with pytest.raises(InputError, match="taken"):
        define_primitive("cell_twice", lambda x: x * 2.5)
    assert PRIMITIVES["cell_twice"] is first


@pytest.mark.long
def test_terms_travel_to_another_process_with_their_functions(tmp_path) -> None:
    terms = {parse("bump(x) + 2*t", NAMES), parse("sin(x)", NAMES), parse("x**2", NAMES)}
    assert pickle.loads(pickle.dumps(terms)) == terms
    (tmp_path / "mine.py").write_text("def cube(x):\n    return x*x*x\n", encoding="utf-8")
    make = (
        "import pickle, mine; from jaxsr.expressions import define_primitive, parse;"
        "define_primitive('cube', mine.cube);"
        "open('terms', 'wb').write(pickle.dumps(parse('cube(x) + sin(t)')))"
    )
    # there neither the name nor the hash of text is known
    use = (
        "import pickle; from jaxsr.expressions import parse, evaluate;"
        "term = pickle.loads(open('terms', 'rb').read());"
        "again = parse('cube(x) + sin(t)');"
        "assert again == term and hash(again) == hash(term);"
        "assert evaluate(term, {'x': 2.0, 't': 0.0}) == 8.0"
    )
    for code in (make, use):
        subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


def test_a_search_finds_a_law_made_of_a_defined_function() -> None:
    rng = np.random.default_rng(0)
    x, t = rng.uniform(-3.0, 3.0, 200), np.arange(200.0)
    y = 4.0 * bump(x) - 0.5 * x
    functions = ("add", "mul", "bump", "moody", "short_by_one")
    config = SearchConfig(population=60, primitives=PrimitiveSet(functions=functions), refined=0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        problem = RegressionProblem(y, {"x": x, "t": t})
        state, _ = search(np.random.default_rng(1), problem, config, budget=20.0)
    exact = next(m for m in state.front.members if m.loss < 1e-20)
    assert set(map(to_text, exact.terms)) == {"bump(x)", "x"}


def test_random_terms_take_functions_of_three_arguments() -> None:
    rng = np.random.default_rng(2)
    drawn = [random_term(rng, NAMES, PrimitiveSet(functions=("blend",)), 10) for _ in range(200)]
    assert {term.size for term in drawn} == {4, 7, 10}


def _column(text: str, variables: dict[str, np.ndarray], **options) -> np.ndarray:
    term = parse(text, list(variables), integrals=True)
    return ColumnCache(variables, **options).column(term)


@pytest.mark.parametrize("uniform", [True, False])
def test_integrals_converge_with_order_two(uniform: bool) -> None:
    errors = []
    for n in (200, 400, 800):
        s = np.linspace(0.0, 1.0, n)
        t = 3.0 * (s if uniform else s**2 * (3.0 - 2.0 * s))
        x = np.sin(t)
        over_time = _column("integral(cos(t))", {"t": t, "x": x}) - np.sin(t)
        over_state = _column("integral_over(x, x)", {"t": t, "x": x}) - 0.5 * x**2
        over_other = _column("integral_over(t, x)", {"t": t, "x": x}) - (
            t * np.sin(t) + np.cos(t) - 1.0
        )
        # the trapezium is exact for f df
        assert np.max(np.abs(over_state)) < 1e-13
        errors.append([np.max(np.abs(over_time)), np.max(np.abs(over_other))])
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.05)


def test_integrals_begin_anew_in_each_recording() -> None:
    t = np.concatenate([np.linspace(0.0, 2.0, 100), np.linspace(5.0, 9.0, 300)])
    group = np.repeat([7, 3], [100, 300])
    column = _column("integral(2*t) + 1", {"t": t}, group=group)
    start = np.where(group == 7, 0.0, 5.0)
    np.testing.assert_allclose(column, t**2 - start**2 + 1.0, rtol=1e-12)
    inner = _column("integral(integral(1))", {"t": t}, group=group)
    np.testing.assert_allclose(inner, 0.5 * (t - start) ** 2, atol=1e-12)


def test_the_instants_may_be_no_variable() -> None:
    tau = np.linspace(0.0, 1.0, 50)
    x = np.full(50, 3.0)
    np.testing.assert_allclose(_column("integral(x)", {"x": x}, time=tau), 3.0 * tau)
    np.testing.assert_allclose(_column("integral(x)", {"x": x, "s": tau}, time="s"), 3.0 * tau)
    with pytest.raises(InputError, match="instants"):
        _column("integral(x)", {"x": x})
    with pytest.raises(InputError, match="group"):
        _column("integral(x)", {"x": x}, time=tau, group=np.zeros(3))
    with pytest.raises(InputError, match="together"):
        _column("integral(x)", {"x": x}, time=tau, group=np.arange(50) % 2)


def test_integrals_are_for_columns_alone() -> None:
    term = Term.apply("integral", Term.variable("x"))
    assert "integral" not in PrimitiveSet().functions
    assert parse(to_text(term), ["x"], integrals=True) == term
    with pytest.raises(InputError, match=r"not part of the grammar.*state"):
        parse("integral(x)", ["x"])
    assert parse("2*integral", ["integral"]).variables == {"integral"}  # still a name
    with pytest.raises(InputError, match="single sample"):
        evaluate(term, {"x": 1.0})
    with pytest.raises(InputError, match="postfix"):
        compile_postfix([term], ["x"])
    assert from_sympy(to_sympy(term)) == term


def test_an_integral_term_is_found_by_a_search() -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 10.0, 400)
    x = np.cos(1.7 * t) + 0.3 * rng.normal(size=400)
    charge = np.concatenate([[0.0], np.cumsum(0.5 * (x[1:] + x[:-1]) * np.diff(t))])
    problem = RegressionProblem(2.0 * x - 3.0 * charge, {"t": t, "x": x})
    primitives = PrimitiveSet(functions=("add", "mul", "integral"))
    config = SearchConfig(population=60, primitives=primitives, refined=0)
    state, _ = search(np.random.default_rng(4), problem, config, budget=20.0)
    exact = next(m for m in state.front.members if m.loss < 1e-20)
    assert set(map(to_text, exact.terms)) == {"integral(x)", "x"}
