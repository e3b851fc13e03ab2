"""Measures of fitness against their equations, and the schedule of alpha against the text."""

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.evolution import FitnessRule, Individual, SearchConfig, search
from jaxsr.evolution.fitness import FitnessState, fitness, next_state
from jaxsr.expressions import Term, parse
from jaxsr.regression import HardThreshold, Judge, RegressionProblem, aic, bic
from jaxsr.regression.digits import rounded

NAMES = ["t", "x", "v"]


def _data(rng, n, noise=0.0):
    t = np.linspace(0.0, 10.0, n)
    x, v = rng.normal(size=(2, n))
    y = 3.0 * x - 2.0 * v + noise * rng.normal(size=n)
    return {"t": t, "x": x, "v": v}, y


def _problem(n=120, noise=0.0, judged=40, **options):
    rng = np.random.default_rng(0)
    variables, y = _data(rng, n, noise)
    return RegressionProblem(y, variables, judge=Judge(*_data(rng, judged, noise)), **options)


def _terms(*texts):
    return tuple(parse(text, NAMES) for text in texts)


def test_adaptive_fitness_is_eq_9():
    individual = Individual.of(_terms("x", "sin(x)", "x*sin(v)"), 0.2)
    assert individual.operators == 3
    state = FitnessState(alpha=1.5, max_loss=0.4, max_terms=6.0, max_operators=2.0)
    expected = 0.2 / 0.4 * (3 / 6) ** 1.5 * (1.0 / 2.0) ** 0.1
    measured = fitness([individual], state, FitnessRule(tau=0.1), _problem())
    assert measured[0] == pytest.approx(expected)


def test_of_two_fits_alike_the_one_with_fewer_operators_wins_by_tau():
    state = FitnessState(alpha=1.0)
    long, short = (Individual.of(_terms(s), 0.1) for s in ("sin(x)*cos(v) + x", "sin(x)"))
    problem = _problem()
    first, second = fitness([long, short], state, FitnessRule(tau=0.1), problem)
    assert first > second
    first, second = fitness([long, short], state, FitnessRule(tau=0.0), problem)
    assert first == second


@pytest.mark.parametrize(("measure", "criterion"), [("aic", aic), ("bic", bic)])
def test_criteria_rank_as_eqs_10_and_11_on_the_residual_itself(measure, criterion):
    problem = _problem(noise=0.5)
    sets = [_terms("x"), _terms("x", "v"), _terms("x", "v", "t"), _terms("x", "v", "t", "x*v")]
    _, relative = problem.solve(sets)
    people = [Individual.of(s, loss) for s, loss in zip(sets, relative, strict=True)]
    found = fitness(people, FitnessState(), FitnessRule(measure=measure), problem)
    total = problem.total
    left = [total * rounded(problem.fit(s).loss * problem.rows / total) for s in sets]
    exact = [criterion(rss, problem.rows, len(s)) for rss, s in zip(left, sets, strict=True)]
    # a relative residual shifts every individual by the same N log(total)
    np.testing.assert_allclose(np.diff(found), np.diff(exact), rtol=1e-6)
    assert np.argmin(found) == 1


def test_validation_fitness_judges_coefficients_of_the_training_rows():
    problem = _problem(noise=0.3)
    sets = [_terms("x"), _terms("x", "v"), _terms("x", "v", "sin(3.0*t)*x", "t")]
    judge = problem.judging
    assert judge is not None
    expected = []
    for terms in sets:
        fit = problem.fit(terms)
        columns = RegressionProblem(judge.y, judge.variables).columns(terms)
        error = judge.y - columns @ fit.coefficients
        expected.append(error @ error / (judge.y @ judge.y))
    people = [Individual.of(s, 0.123) for s in sets]
    rule = FitnessRule(data="validation", tau=0.0)
    found = fitness(people, FitnessState(), rule, problem)
    # ridge of 1e-10 against plain least squares
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    np.testing.assert_allclose(fitness(people, FitnessState(), rule, problem), found)
    unusable = Individual.of(_terms("sqrt(x)"), 0.1)
    assert np.isinf(fitness([unusable], FitnessState(), rule, problem)[0])
    criterion = fitness(people, FitnessState(), replace(rule, measure="bic"), problem)
    assert criterion[0] == pytest.approx(bic(expected[0], 40, 1), rel=1e-6)


def test_judging_takes_view_and_fixed_columns_along():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(50, 120)), rng.normal(size=(20, 40))
    (train, y), (unseen, z) = _data(rng, 120), _data(rng, 40)
    fixed, beside = rng.normal(size=(50, 1)), rng.normal(size=(20, 1))
    judge = Judge(unseen, b @ z + 4.0 * beside[:, 0], lambda c: b @ c, beside)
    target = a @ y + 4.0 * fixed[:, 0]
    problem = RegressionProblem(target, train, view=lambda c: a @ c, fixed=fixed, judge=judge)
    exact, short = problem.judge([_terms("x", "v"), _terms("x")])
    assert exact < 1e-18 < short


def test_few_rows_overfit_on_training_and_not_on_validation():
    rng = np.random.default_rng(2)
    config = SearchConfig(population=60, generations=6, refined=0)
    sizes = {}
    for data in ("training", "validation"):
        rule = FitnessRule(data=data, generations=100, tau=0.0)
        variables, y = _data(np.random.default_rng(3), 12, 0.5)
        judge = Judge(*_data(np.random.default_rng(4), 40, 0.5))
        problem = RegressionProblem(y, variables, judge=judge)
        state, _ = search(rng, problem, replace(config, fitness=rule))
        sizes[data] = len(state.population[0].terms)
    assert sizes["validation"] < sizes["training"]


def _best(loss):
    return [Individual.of((Term.variable("x"),), loss)]


def test_alpha_waits_for_n_threshold_then_is_one_then_grows_below_e_threshold():
    problem = _problem()
    rule = FitnessRule(generations=5, error=1e-2, increment=0.2, highest=2.0)
    state = FitnessState(increment=0.2)
    for generation in range(1, 5):  # a small residual does not bring it forward
        state = next_state(state, rule, _best(1e-3), generation, problem)
        assert state.alpha == 0.0
    state = next_state(state, rule, _best(0.02), 5, problem)
    assert state.alpha == 1.0
    state = next_state(state, rule, _best(0.011), 6, problem)  # still above E_threshold
    assert state.alpha == 1.0
    state = next_state(state, rule, _best(1e-3), 7, problem)
    assert state.alpha == pytest.approx(1.2)
    for generation in range(8, 30):
        state = next_state(state, rule, _best(1e-3), generation, problem)
    assert state.alpha == 2.0


def test_an_abrupt_rise_of_the_residual_halves_the_growth_and_a_small_one_does_not():
    problem = _problem()
    rule = FitnessRule(generations=1, error=1e-2, increment=0.2)
    state = next_state(FitnessState(increment=0.2), rule, _best(1e-3), 1, problem)
    state = next_state(state, rule, _best(1.5e-3), 2, problem)
    assert state.increment == 0.2
    before = state.alpha
    state = next_state(state, rule, _best(5e-3), 3, problem)
    assert state.increment == pytest.approx(0.1)
    assert state.alpha == pytest.approx(before + 0.1)


def test_the_maxima_are_those_of_the_last_best_set():
    best = [Individual.of(_terms("x"), 0.5), Individual.of(_terms("x*v", "sin(t)*x"), 0.1)]
    lost = Individual.of(_terms("x", "v", "t"), np.inf)
    state = next_state(FitnessState(), FitnessRule(), [*best, lost], 1, _problem())
    assert (state.max_loss, state.max_terms, state.max_operators) == (0.5, 2, 1.5)
    assert next_state(state, FitnessRule(), [lost], 2, _problem()) == state


def test_the_schedule_reads_the_rows_that_the_rule_names():
    problem = _problem(noise=0.0)
    rule = FitnessRule(generations=1, error=1e-2, data="validation")
    exact = [Individual.of(_terms("x", "v"), 0.9)]  # the loss it carries is not asked
    assert next_state(FitnessState(), rule, exact, 1, problem).alpha > 1.0


def test_paper_settings_are_those_of_section_6():
    config = SearchConfig.paper()
    assert (config.population, SearchConfig.paper(800).population) == (600, 800)
    assert (config.fitness.generations, config.fitness.highest, config.vartheta) == (50, 2.0, 5.0)
    assert config.primitives.constants == (-100.0, 100.0)
    assert (config.sizes.at_birth, config.sizes.later, config.sizes.terms) == (5, 15, 20)
    assert config.elite + config.reproduction == pytest.approx(0.2)
    assert config.threshold == HardThreshold(sigma=1e-4)
    assert config.fitness.measure == "adaptive" and config.refined == 0


@pytest.mark.parametrize("wrong", [{"measure": "mdl"}, {"data": "held_out"}])
def test_unknown_measures_and_rows_are_refused(wrong):
    with pytest.raises(InputError, match="must be"):
        FitnessRule(**cast(Any, wrong))


def test_a_problem_without_judge_says_so():
    with pytest.raises(InputError, match="judge"):
        RegressionProblem(np.ones(3), {"x": np.arange(3.0)}).judge([_terms("x")])
    with pytest.raises(InputError, match="Judge"):
        Judge({"x": np.ones(3)}, np.ones(2))
