"""Constants on the one evaluator: derivatives on the machine, fits from products of columns."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jaxsr.evaluation import Evaluator, Reference
from jaxsr.evaluation import evaluator as module
from jaxsr.evaluation.engine import Engine
from jaxsr.evaluation.machine import compilations
from jaxsr.evaluation.open import mark, written
from jaxsr.expressions import Term, parse
from jaxsr.expressions.derivatives import derivative
from jaxsr.regression import RegressionProblem, Resources, constants_of, with_constants
from jaxsr.regression import constants as constants_module
from jaxsr.regression.marquardt import ExactFits
from jaxsr.regression.projection import batches
from jaxsr.regression.slopes import Form, with_leaves
from jaxsr.regression.streamed_projection import fits, opened
from tests.term_texts import TERMS

NAMES = ("t", "x", "z")
ROWS = 5000
TEXTS = [
    *TERMS,
    "1/(x**2 + 1.5) + x/(z**2 + 0.3)",
    "(t + 1.0)**(0.3*x)",
]


@pytest.fixture(autouse=True)
def always(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "worth" not in request.node.name:
        monkeypatch.setattr(module, "are_slopes_compiled", lambda samples, sets: True)


def _data() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    x, z = rng.normal(size=(2, ROWS))
    return {"t": np.linspace(0.0, 10.0, ROWS), "x": x, "z": z}


def _terms(*texts: str) -> list[Term]:
    return [parse(text, NAMES) for text in texts]


def _problem(noise: float = 0.3, **options: Any) -> RegressionProblem:
    data = _data()
    t, x, z = data.values()
    law = 3.0 * x + 5.0 * np.sin(2.5 * t + 0.4) - 2.0 / (x**2 + 1.5) + 0.5 * np.exp(0.3 * z)
    y = law + noise * np.random.default_rng(1).normal(size=ROWS)
    return RegressionProblem(y, data, **options)


def _sets(count: int) -> list[list[Term]]:
    rng = np.random.default_rng(2)
    shapes = [
        ("sin({}*t + {})", (2.5, 0.4)),
        ("1/(x**2 + {})", (1.5,)),
        ("exp({}*z)", (0.3,)),
        ("sin({}*t + {})*exp({}*z)", (2.5, 0.4, 0.1)),
    ]
    still = [("x",), ("x", "t"), ("x", "z", "x*z"), ()]
    out = []
    for k in range(count):
        own = [shapes[(k + j) % len(shapes)] for j in range(1 + k % 3)]
        texts = [
            text.format(*(c * (1.0 + 0.02 * rng.normal()) for c in constants))
            for text, constants in own
        ]
        out.append(_terms(*still[k % len(still)], *texts))
    return out


def _open(term: Term) -> tuple[Term, int]:
    return with_leaves(term, map(mark, itertools.count())), len(constants_of(term))


@pytest.mark.parametrize("text", TEXTS)
def test_derivatives_are_those_of_the_reference(text: str):
    (term,), data = _terms(text), _data()
    form, count = _open(term)
    values = {mark(k).name: np.full(ROWS, c) for k, c in enumerate(constants_of(term))}
    reference = Form.of(term).columns(np.array([constants_of(term)]), Reference(data).column)[1]
    with np.errstate(all="ignore"):
        for k in range(count):
            slope = derivative(form, mark(k).name)
            assert slope is not None
            found = Reference(data | values).column(slope)
            wanted = np.broadcast_to(reference[k], (1, ROWS))[0]
            # the reference takes differences of Max and Min
            exact = "Max" not in text
            np.testing.assert_allclose(found, wanted, rtol=1e-10 if exact else 1e-6, atol=1e-9)


def test_an_unknown_primitive_has_no_derivative():
    (term,) = _terms("Piecewise((0.5*x, z > 0), (x*z, True))")
    form, count = _open(term)
    assert written(form, count, NAMES) is None
    assert derivative(_terms("x*z")[0], "t") == Term.constant(0.0)


def test_one_program_serves_every_value_of_the_constants():
    evaluator = Evaluator(_data(), threads=1)
    terms = _terms(*TEXTS[:6])
    codes = [evaluator.opens(*_open(term)) for term in terms]
    assert all(code is not None for code in codes)
    starts = np.cumsum([0, *(len(constants_of(term)) for term in terms)])
    run = evaluator.opened([code for code in codes if code], starts[:-1].tolist())
    for scale in (1.0, 1.1):
        constants = scale * np.concatenate([constants_of(term) for term in terms])
        blocks = np.concatenate(run(constants, lambda block, _: block.copy()), axis=1)
        row = 0
        for term in terms:
            values = [scale * c for c in constants_of(term)]
            moved = with_constants(term, iter(values))
            value, slopes = Form.of(moved).columns(np.array([values]), Reference(_data()).column)
            for wanted in (value, *(slopes[k] for k in range(len(values)))):
                wanted = np.broadcast_to(wanted, (1, ROWS))[0]
                np.testing.assert_allclose(blocks[row], wanted, rtol=1e-9, atol=1e-9)
                row += 1


def test_products_give_the_losses_and_the_curvature_of_the_columns():
    problem = _problem(fixed=np.ones((ROWS, 1)))
    sets = _sets(12)
    opens = [own for terms in sets if (own := opened(problem, terms, 10))]
    assert len(opens) == len(sets)
    for places, streamed in fits(problem, opens):
        every = np.arange(len(places))
        point = streamed.evaluate(streamed.start, every)
        assert not np.any(point.unsure)
        matrix, moment = streamed.curvature(point, every)
        for row, place in enumerate(places):
            ((_, batch),) = batches(problem, [sets[place]], 10)
            exact = ExactFits(batch)
            other = exact.evaluate(batch.start, np.arange(1))
            assert point.loss[row] == pytest.approx(other.loss[0], rel=1e-9)
            j, g = (part[0] for part in exact.curvature(other, np.arange(1)))
            size = len(g)
            scale = np.sqrt(np.diag(j))
            np.testing.assert_allclose(
                matrix[row, :size, :size] / np.outer(scale, scale),
                j / np.outer(scale, scale),
                atol=1e-7,
            )
            np.testing.assert_allclose(
                moment[row, :size] / scale, g / scale, atol=1e-7 * np.sqrt(other.loss[0])
            )


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_constants_come_out_as_by_the_reference(noise: float):
    sets = [
        *_sets(9),
        _terms("x", "z"),
        _terms("sqrt(x)", "sin(2.0*t)"),
        _terms("exp(0.2*z + 0.7)"),
    ]
    # two columns that a small constant keeps apart: products cannot tell them
    sets += [_terms("x", "x + 1e-7*sin(2.4*t)"), _terms("sin(2.4*t)", "sin(2.4000001*t)")]
    results = [
        _problem(noise, resources=Resources(kind)).refine_many(sets)
        for kind in (Evaluator, Reference)
    ]
    for (terms, loss), (wanted, least) in zip(*results, strict=True):
        assert loss == pytest.approx(least, rel=1e-6, abs=1e-20)
        if np.isfinite(loss):
            own, theirs = ([c for t in s for c in constants_of(t)] for s in (terms, wanted))
            np.testing.assert_allclose(own, theirs, rtol=1e-4, atol=1e-10)


def test_an_exact_fit_is_found_exact():
    terms = _terms("x", "sin(2.48*t + 0.42)", "1/(x**2 + 1.47)", "exp(0.31*z)")
    found, loss = _problem(0.0).refine(terms)
    assert loss < 1e-20
    own = [c for term in found for c in constants_of(term)]
    np.testing.assert_allclose(own, [2.5, 0.4, 1.5, 0.3], rtol=1e-8)


def test_a_search_over_constants_asks_the_one_engine_and_compiles_once(
    monkeypatch: pytest.MonkeyPatch,
):
    calls: list[int] = []
    each = Engine.each

    def counted(self: Engine, data: Any, use: Callable[..., Any], **options: Any) -> list[Any]:
        calls.append(len(self))
        return each(self, data, use, **options)

    monkeypatch.setattr(Engine, "each", counted)
    problem = _problem()
    problem.refine_many(_sets(2))
    assert calls
    shapes = compilations()
    for count in (1, 5, 12):  # other counts of sets, terms and constants, and fewer as they settle
        problem.refine_many(_sets(count))
    assert compilations() == shapes


def test_few_samples_or_sets_are_not_worth_a_compilation():
    assert not module.are_slopes_compiled(1_000, 10_000)
    assert not module.are_slopes_compiled(10_000, 1)
    assert module.are_slopes_compiled(10_000, 30)
    assert module.are_slopes_compiled(100_000, 2)
    assert not Reference(_data()).differentiates(1_000)
    assert not Evaluator({}).differentiates(1_000)


@pytest.mark.parametrize(
    "texts",
    [
        ("1/(x**2 + 549012555.0)", "1/(z**2 + 182.4)"),
        ("x", "sin(t/2.0e9)", "exp(0.2*z)"),
        ("1/(x**2 + 1.3)", "x/(z**2 + 1.0e9)"),
    ],
)
def test_a_constant_without_influence_is_held_by_either_engine(texts: tuple[str, ...]):
    """A slope of rounding alone once sent such a constant away, and the others' steps with it."""
    sets, found = [_terms(*texts)], {}
    for kind in (Evaluator, Reference):
        ((terms, loss),) = _problem(resources=Resources(kind)).refine_many(sets)
        found[kind] = [c for term in terms for c in constants_of(term)], loss
    assert found[Evaluator][1] == pytest.approx(found[Reference][1], rel=1e-6)
    assert found[Evaluator][0] == pytest.approx(found[Reference][0], rel=1e-2)


def test_sets_whose_constants_stay_are_weighed_by_their_products(monkeypatch: pytest.MonkeyPatch):
    gone: list[int] = []

    def counted(problem: Any, sets: Any, most: int) -> Any:
        gone.extend(range(len(sets)))
        return batches(problem, sets, most)

    monkeypatch.setattr(constants_module, "batches", counted)
    problem, many = _problem(), [parse(f"sin({k}.3*t)", NAMES) for k in range(11)]
    sets = [_terms("x", "z", "x*z"), _terms("x", "t", "t**2", "t**3"), many]
    for terms, (kept, loss) in zip(sets, problem.refine_many(sets), strict=True):
        theta = problem.columns(terms)
        residual = problem.y - theta @ np.linalg.lstsq(theta, problem.y, rcond=None)[0]
        assert loss == pytest.approx(residual @ residual / problem.total, rel=1e-8)
        assert list(kept) == terms
    assert not gone
    # one that depends on the others, and one of which a column is none, are as they were
    losses = [loss for _, loss in problem.refine_many([_terms("x", "2*x"), _terms("log(x)", "z")])]
    assert losses == [np.inf, np.inf] and len(gone) == 1
