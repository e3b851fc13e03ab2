"""Inner constants: exact slopes, and a search that reaches rounding, one set or many."""

import warnings
from typing import Any, cast

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.expressions import Term, parse, to_text
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.regression import (
    Refinement,
    RegressionProblem,
    Rules,
    constant_slopes,
    constants_of,
    with_constants,
)
from jaxsr.regression.descent import descend, descent_shapes
from jaxsr.regression.projection import batches, evaluate
from jaxsr.regression.slopes import Form
from tests.term_texts import TERMS

T = np.linspace(0.0, 10.0, 300)
NAMES = ["t", "x", "z"]


def _variables(rng):
    x, z = rng.normal(size=(2, len(T)))
    return {"t": T, "x": x, "z": z}


def _terms(*texts):
    return [parse(text, NAMES) for text in texts]


TEXTS = [
    *TERMS,
    "Heaviside(t - 3.01)*z*0.5",
    "Piecewise((0.5*x, z > 0), (x*z + 0.1*t, True))",
    "-(0.3*x)",
]


@pytest.mark.parametrize("text", TEXTS)
def test_slopes_are_the_limit_of_differences(text):
    rng = np.random.default_rng(0)
    problem = RegressionProblem(rng.normal(size=len(T)), _variables(rng))
    term = parse(text, NAMES)
    values = np.array(constants_of(term))
    slopes = constant_slopes(problem, [term], np.array([2.0]))
    assert slopes.shape == (len(T), len(values))
    for k, value in enumerate(values):
        step = 1e-6 * max(abs(value), 0.1)
        columns = [
            problem.columns(
                [with_constants(term, iter(values + s * step * np.eye(len(values))[k]))]
            )
            for s in (1.0, -1.0)
        ]
        measured = 2.0 * (columns[0] - columns[1])[:, 0] / (2.0 * step)
        # central differences at this step: truncation and cancellation both below 1e-7
        np.testing.assert_allclose(slopes[:, k], measured, rtol=1e-5, atol=1e-7)


def test_every_primitive_of_a_point_is_known_by_its_slope_or_evaluated_whole():
    for name, primitive in PRIMITIVES.items():
        arity = 2 if primitive.arity == -1 else primitive.arity
        args = [Term.apply("add", Term.constant(0.5), Term.variable("x")) for _ in range(arity)]
        form = Form.of(Term.apply(name, *args))
        assert form.constants == arity
        assert bool(form.nodes) != (form.template is not None)


def test_terms_that_differ_in_constants_alone_share_a_form():
    first, second = (Form.of(t) for t in _terms("sin(2.5*t)*x**2.0", "sin(7.0*t)*x**2.0"))
    assert first == second
    assert first != Form.of(_terms("sin(2.5*t)*x**3.0")[0])  # a whole exponent is part of the form
    # every column that does not move is 2
    columns, tangents = first.columns(
        np.array([[2.5], [7.0]]), lambda term, *, keep=True: np.full(4, 2.0)
    )
    np.testing.assert_allclose(columns[:, 0], [2.0 * np.sin(5.0), 2.0 * np.sin(14.0)])
    np.testing.assert_allclose(tangents[0][:, 0], [4.0 * np.cos(5.0), 4.0 * np.cos(14.0)])


def _perturbed(rng, count):
    """Return sets of one to three moving terms that all hold the true law, constants 1.5 % off."""
    truth = [("sin({}*t + {})", (2.5, 0.4)), ("1/(x**2 + {})", (1.5,)), ("exp({}*z)", (0.3,))]
    extra = [(), ("t",), ("cos(0.7*t)",), ("x*z", "t**2.0")]
    sets = []
    for k in range(count):
        texts = [
            text.format(*(c * (1.0 + 0.015 * rng.normal()) for c in constants))
            for text, constants in truth
        ]
        sets.append(_terms("x", *texts, *extra[k % len(extra)]))
    return sets


def _law(variables):
    t, x, z = (variables[n] for n in NAMES)
    return 3.0 * x + 5.0 * np.sin(2.5 * t + 0.4) - 2.0 / (x**2 + 1.5) + 0.5 * np.exp(0.3 * z)


def test_refinement_reaches_rounding_and_the_true_constants():
    rng = np.random.default_rng(1)
    variables = _variables(rng)
    problem = RegressionProblem(_law(variables), variables)
    for terms, loss in problem.refine_many(_perturbed(rng, 20)):
        assert loss < 1e-20
        found = [c for term in terms[1:4] for c in constants_of(term)]
        np.testing.assert_allclose(found, [2.5, 0.4, 1.5, 0.3], rtol=1e-8)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_many_sets_at_once_come_out_as_one_by_one(noise):
    rng = np.random.default_rng(2)
    variables = _variables(rng)
    y = _law(variables) + noise * rng.normal(size=len(T))
    problem = RegressionProblem(y, variables, fixed=np.column_stack([np.ones(len(T)), T]))
    (t,) = _terms("t")
    # a spurious frequency has many minima: there rounding may choose
    sets = [s for s in _perturbed(rng, 12) if not any("0.7" in to_text(t) for t in s)]
    # t is a fixed column: a set that holds it is unusable
    assert all(
        np.isinf(loss)
        for s, (_, loss) in zip(sets, problem.refine_many(sets), strict=True)
        if t in s
    )
    sets += [_terms("x", "z"), _terms("sqrt(x)", "sin(2.0*t)"), _terms("x")]
    together = problem.refine_many(sets)
    for terms, (moved, loss) in zip(sets, together, strict=True):
        alone, alone_loss = problem.refine(terms)
        if np.isinf(alone_loss):
            assert np.isinf(loss)
            continue
        assert loss == pytest.approx(alone_loss, rel=1e-6, abs=1e-20)
        own = [[c for t in s for c in constants_of(t)] for s in (alone, moved)]
        # equal to rounding; amplified by the condition of the fit where noise hides a constant
        np.testing.assert_allclose(*own, rtol=1e-4)
    assert problem.refine_many([]) == []


def test_view_and_fixed_columns_are_part_of_the_loss():
    rng = np.random.default_rng(3)
    variables = _variables(rng)
    a = rng.normal(size=(80, len(T)))
    fixed = rng.normal(size=(80, 2))
    y = a @ _law(variables) + fixed @ [3.0, -4.0]
    problem = RegressionProblem(y, variables, view=lambda columns: a @ columns, fixed=fixed)
    ((terms, loss),) = problem.refine_many(_perturbed(rng, 1))
    assert loss < 1e-18
    np.testing.assert_allclose(constants_of(terms[1]), [2.5, 0.4], rtol=1e-7)
    exact = problem.fit(terms)
    assert exact.fixed == pytest.approx([3.0, -4.0], rel=1e-6)


def test_a_loss_is_never_made_worse_and_nothing_warns():
    rng = np.random.default_rng(4)
    variables = _variables(rng)
    y = _law(variables) + 0.1 * rng.normal(size=len(T))
    problem = RegressionProblem(y, variables, fixed=np.column_stack([T**2]))
    shapes = [
        "sin({}*t)/(x**2 + {})",
        "log({}*x + 9.0)**{}",
        "sqrt(x + {})*exp({}*t)",
        "1/(x - {})**{}",
        "({}*t)**(x*{})",
    ]
    sets = []
    for k in range(40):
        a, b = rng.uniform(-4.0, 9.0, size=2)
        sets.append(_terms(shapes[k % 5].format(a, b), "x"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        after = problem.refine_many(sets)
    _, before = problem.solve(sets)
    for start, (_, loss) in zip(before, after, strict=True):
        assert loss <= start * (1.0 + 1e-8) or np.isinf(start)


def test_a_constant_without_influence_does_not_hold_the_others_back():
    rng = np.random.default_rng(5)
    variables = _variables(rng)
    problem = RegressionProblem(4.0 * np.sin(2.5 * T + 0.4), variables)
    terms, loss = problem.refine(_terms("sin(2.45*t + 0.5)", "1/(z**2 + 1.5)"))
    assert loss < 1e-18
    np.testing.assert_allclose(constants_of(terms[0]), [2.5, 0.4], rtol=1e-8)


def test_limits_are_kept():
    rng = np.random.default_rng(6)
    variables = _variables(rng)
    terms = _perturbed(rng, 1)[0]
    still = RegressionProblem(
        _law(variables), variables, rules=Rules(refinement=Refinement(most_constants=3))
    )
    assert still.refine(terms)[0] == tuple(terms)
    none = RegressionProblem(
        _law(variables), variables, rules=Rules(refinement=Refinement(iterations=0))
    )
    assert none.refine(terms)[0] == tuple(terms)
    short = RegressionProblem(
        _law(variables), variables, rules=Rules(refinement=Refinement(iterations=1, reach=1e-3))
    )
    moves = np.abs(
        np.array([c for t in short.refine(terms)[0] for c in constants_of(t)])
        - [c for t in terms for c in constants_of(t)]
    )
    assert np.all(moves <= 1.001e-3 * 2.7)
    with pytest.raises(InputError, match="reach"):
        Refinement(reach=0.0)


def test_what_a_coefficient_says_is_no_constant_and_redundant_ones_stay_small():
    (rational,) = _terms("3.0*x/(2.0*(x**2 + 1.5))")
    assert constants_of(rational) == [1.5]
    variables = _variables(np.random.default_rng(7))
    problem = RegressionProblem(np.exp(0.3 * variables["x"]) + 1.0, variables)
    # exp(a x + b) = exp(b) exp(a x): b has no slope beside the coefficient
    (terms, loss) = problem.refine(_terms("exp(0.25*x + 0.7)", "1.0"))
    assert loss < 1e-20
    np.testing.assert_allclose(constants_of(terms[0]), [0.3, 0.7], rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "iterations"), [("adam", 60), ("lbfgs", 100)])
def test_descent_through_the_ridge_solve_lowers_every_loss(method, iterations):
    rng = np.random.default_rng(8)
    variables = {name: column[::6] for name, column in _variables(rng).items()}
    y = _law(variables)
    limits = Refinement(method=method, iterations=iterations)
    problem = RegressionProblem(y, variables, rules=Rules(refinement=limits))
    sets = [*_perturbed(rng, 4), _terms("x", "z"), _terms("sqrt(x)", "sin(2.0*t)")]
    exact = RegressionProblem(y, variables)
    before = exact.solve(sets)[1]
    after = problem.refine_many(sets)
    for start, (_, loss) in zip(before[:4], after, strict=False):
        assert loss < 0.3 * start
    assert after[4] == (tuple(sets[4]), pytest.approx(before[4], rel=1e-6))
    assert np.isinf(after[5][1])
    shapes = descent_shapes(limits)
    # other counts of sets, terms and constants in the same buckets: nothing new is compiled
    problem.refine_many([*_perturbed(rng, 3), _terms("sqrt(x)", "sin(2.0*t)", "z")])
    assert descent_shapes(limits) == shapes


@pytest.mark.slow
def test_gradient_of_a_descent_is_that_of_the_loss():
    rng = np.random.default_rng(9)
    a = rng.normal(size=(60, len(T)))
    variables = _variables(rng)
    view = RegressionProblem(a @ _law(variables), variables, view=lambda c: a @ c)
    terms = _terms("x", "sin(2.4*t + 0.4)", "exp(0.4*z)/(x**2 + 1.5)")
    ((_, batch),) = batches(view, [terms], 10)
    # the first step goes down the gradient in constants relative to their sizes, a length of 1e-6
    limits = Refinement(method="lbfgs", iterations=1, learning_rate=1e-6)
    start = batch.start[0]
    moved = (descend(view, batch, [terms[1:]], limits)[0] - start) / np.abs(start)
    slopes = []
    for k, value in enumerate(start):
        ends = [batch.start + s * 1e-6 * value * np.eye(len(start))[k] for s in (1.0, -1.0)]
        up, down = (evaluate(batch, c, np.array([0])).loss[0] for c in ends)
        slopes.append(up - down)
    # differences of the loss: rounding 1e-16 of it against changes of 1e-6
    np.testing.assert_allclose(moved, -1e-6 * np.array(slopes) / np.linalg.norm(slopes), rtol=1e-4)


def test_terms_without_postfix_code_are_left_to_levenberg_marquardt():
    variables = _variables(np.random.default_rng(10))
    y = np.where(variables["z"] > 0.0, np.sin(2.5 * T), variables["x"])
    problem = RegressionProblem(y, variables, rules=Rules(refinement=Refinement(method="adam")))
    ((term,), loss) = problem.refine(_terms("Piecewise((sin(2.45*t), z > 0), (x, True))"))
    assert loss < 1e-20
    assert constants_of(term)[0] == pytest.approx(2.5, rel=1e-8)
    with pytest.raises(InputError, match="method"):
        Refinement(method=cast(Any, "newton"))
