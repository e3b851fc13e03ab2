"""Offers to a front: what they hold, how often they are made, and for whom."""

from __future__ import annotations

import numpy as np
import pytest
from brute_force import relative_loss

from jaxsr.evolution import (
    Front,
    Individual,
    PrimitiveSet,
    SearchConfig,
)
from jaxsr.evolution.library import small_terms
from jaxsr.evolution.offers import (
    Offer,
    few,
    frequencies_of,
    small_offers,
    with_beam,
    with_frequencies,
    with_quotients,
    with_shapes,
)
from jaxsr.expressions import Term, evaluate, parse
from jaxsr.expressions.printing import kind
from jaxsr.regression import RegressionProblem


def _front(problem: RegressionProblem, sets: list[list[Term]]) -> Front:
    _, losses = problem.solve(sets)
    pairs = zip(sets, losses, strict=True)
    return Front().with_(Individual.of(terms, loss) for terms, loss in pairs)


def test_small_offers_are_those_that_gain_most() -> None:
    rng = np.random.default_rng(22)
    x, v = rng.uniform(0.5, 2.0, size=(2, 150))
    data = {"x": x, "v": v}
    problem = RegressionProblem(3.0 * x - np.sin(x) * v**2 + 0.3 * rng.normal(size=150), data)
    config = SearchConfig()
    terms = small_terms(["x", "v"], config.primitives)
    with np.errstate(all="ignore"):
        columns = [np.broadcast_to(evaluate(t, data), 150) for t in terms]
    held = (Term.variable("x"),)
    before = relative_loss(x[:, None], problem.y)
    best = -np.inf
    for column in columns:
        pair = np.column_stack([x, column])
        if np.all(np.isfinite(pair)) and np.any(column):
            best = max(best, before - relative_loss(pair, problem.y))
    offered = small_offers(problem, config, held, 5)
    gains = [before - relative_loss(problem.columns([*held, t]), problem.y) for t in offered]
    assert gains[0] == pytest.approx(best, rel=1e-4)
    assert np.all(np.diff(gains) < 1e-6)


def test_shapes_offered_to_whole_bases_hold_the_form_of_the_law() -> None:
    config = SearchConfig()
    for seed in range(10):
        rng = np.random.default_rng([23, seed])
        x = rng.uniform(0.0, 4.0, size=200)
        y = 1.0 + 0.5 * x - 2.0 * x / (x + rng.uniform(0.2, 3.0))
        problem = RegressionProblem(y, {"x": x})
        front = _front(problem, [[Term.variable("x")], [Term.constant(1.0), Term.variable("x")]])
        offered = with_shapes(problem, front, Offer(1, 1, 0, 0.0), config)
        assert offered == with_shapes(problem, front, Offer(1, 1, 0, 0.0), config)
        # from one of them a refinement of constants arrives at the law
        forms = {t for terms in offered for t in terms if kind(t).startswith("div(1,add(")}
        linear = (Term.constant(1.0), Term.variable("x"))
        ended = problem.refine_many([(*linear, t) for t in forms if "exp" not in kind(t)])
        assert min(loss for _, loss in ended) < 1e-15
        again = with_shapes(problem, front, Offer(9, 1, 1, 0.0), config)
        assert set(again) != set(offered)  # the next population has its own grid


def test_pairs_and_triples_are_weighed_once_and_not_where_all_is_explained() -> None:
    rng = np.random.default_rng(24)
    x, v = rng.uniform(0.5, 2.0, size=(2, 120))
    problem = RegressionProblem(np.sin(x) - v / x, {"x": x, "v": v})
    poor = _front(problem, [[Term.variable("x")]])
    config = SearchConfig()
    assert with_beam(problem, poor, Offer(1, 1, 0, 1e-12), config) == []
    assert with_beam(problem, poor, Offer(3, 3, 0, 1e-12), config) == []
    sets = with_beam(problem, poor, Offer(2, 2, 0, 1e-12), config)
    law = [parse(w, ["x", "v"]) for w in ("sin(x)", "v/x")]
    assert problem.solve(sets[:1])[1][0] < 1e-20  # sign(x)*sin(x) says the same here
    assert set(law) in list(map(set, sets))
    good = _front(problem, [law])
    assert with_beam(problem, good, Offer(2, 2, 0, 1e-12), config) == []


def test_frequencies_are_offered_where_a_wave_is() -> None:
    t = np.linspace(0.0, 20.0, 400)
    x = np.sin(0.37 * t)
    problem = RegressionProblem(2.0 * x + np.sin(3.3 * t + 1.0), {"t": t, "x": x})
    front = _front(problem, [[Term.variable("x")]])
    sets = with_frequencies(problem, front, Offer(2, 2, 0, 0.0), SearchConfig())
    ended = problem.refine_many(sets)
    assert min(loss for _, loss in ended) < 1e-15
    best = min(ended, key=lambda pair: pair[1])[0]
    (w,) = frequencies_of(_front(problem, [list(best)]), "t")
    assert w == pytest.approx(3.3, rel=1e-6)
    no_waves = SearchConfig(primitives=PrimitiveSet(functions=("add", "mul")))
    assert with_frequencies(problem, front, Offer(2, 2, 0, 0.0), no_waves) == []


@pytest.mark.parametrize("beside", ["", " + 0.6*w"])
def test_waves_times_a_variable_are_offered_where_they_are(beside: str) -> None:
    """A ripple of the angle in proportion to a speed, as of friction: ten draws, ten found.

    As well as the law itself beside a tenth of noise; waves alone leave most of it.
    """
    for seed in range(10):
        rng = np.random.default_rng(seed)
        t = np.linspace(0.0, 10.0, 400)
        angles = [np.outer(t, rng.uniform(0.5, 6.0, 4)) + rng.uniform(0.0, 6.0, 4) for _ in "qwi"]
        q, w, i = (np.sin(angle) @ rng.uniform(0.3, 1.0, 4) for angle in angles)
        n, phase = rng.uniform(3.0, 12.0), rng.uniform(0.0, 6.0)
        ripple = w * np.cos(n * q + phase)
        y = ripple + (0.6 * w if beside else 0.0) + 0.1 * np.std(ripple) * rng.normal(size=t.size)
        problem = RegressionProblem(y, {"q": q, "w": w, "i": i})
        law = [parse(text, ["q", "w"]) for text in ("w", f"w*cos({n}*q + {phase})")]
        noise = problem.solve([law])[1][0]
        turn = Offer(9, 2, 0, 0.0)  # of q
        sets = with_frequencies(problem, _front(problem, [law[:1]]), turn, SearchConfig())
        alone = [terms for terms in sets if terms[-1].op == "sin"]
        assert 0 < len(alone) < len(sets)
        assert min(loss for _, loss in problem.refine_many(sets)) < 1.02 * noise
        assert min(loss for _, loss in problem.refine_many(alone)) > 50.0 * noise


def test_frequencies_of_a_front_are_told_once() -> None:
    words = ["sin(3.0*t)", "cos(3.001*t)", "sin(-7.5*t + 0.3)", "sin(2.0*x)", "t*sin(9.1*t)"]
    terms = tuple(parse(w, ["t", "x"]) for w in words)
    front = Front().with_([Individual.of(terms, 0.5)])
    np.testing.assert_allclose(frequencies_of(front, "t"), [3.0, 7.5], rtol=1e-3)


def test_quotients_are_offered_in_generations_that_double() -> None:
    rng = np.random.default_rng(25)
    x = rng.uniform(0.5, 2.0, size=100)
    problem = RegressionProblem(x / (x + 1.3), {"x": x})
    front = _front(problem, [[Term.variable("x")]])
    offered = [
        bool(with_quotients(problem, front, Offer(g, g, 0, 0.0), SearchConfig()))
        for g in range(1, 9)
    ]
    assert offered == [True, *[False] * 7]  # later ones wait for waves of time


@pytest.mark.parametrize("generation", range(8))
def test_few_of_a_front_are_its_ends_and_two_between(generation: int) -> None:
    x = Term.variable("x")
    front = Front(tuple(Individual((x,) * (k + 1), 2.0**-k, k, 0) for k in range(9)))
    picked = few(front, 7, generation)
    assert {picked[0].size, picked[-1].size} == {0, 6} and len(picked) <= 4
    assert all(len(m.terms) <= 7 for m in picked)
    # within as many generations as there are members everyone has had a turn
    turns = {m.size for g in range(7) for m in few(front, 7, g)}
    assert turns == set(range(7))
