"""The evaluator of a search: the compiled machine, and NumPy as its reference."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jaxsr import Recording, discover
from jaxsr.evaluation import ColumnCache, Evaluator, Reference, compile_terms
from jaxsr.evaluation import evaluator as module
from jaxsr.evaluation.engine import Engine
from jaxsr.evaluation.machine import compilations
from jaxsr.evolution import SearchConfig
from jaxsr.expressions import Term, parse
from jaxsr.regression import RegressionProblem, Resources

NAMES = ["t", "x", "z"]
TEXTS = [
    *(
        "x",
        "2.5",
        "x*z",
        "sin(2.5*t + 0.4)*x",
        "exp(x/3)",
        "x**2.5",
        "x/(1 + z**2)",
        "Max(x, z, t)",
    ),
    *(
        "integral(x)",
        "integral(x)*z",
        "Piecewise((x, z > 0), (t, True))",
        "sqrt(x)",
        "sign(x)*x**3",
    ),
]
TERMS = [parse(text, NAMES, integrals=True) for text in TEXTS]
ROWS = 3 * module.PIECE + 77


@pytest.fixture(params=["machine", "NumPy"])
def rule(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Let one of both evaluate everything."""
    always = request.param == "machine"
    monkeypatch.setattr(module, "is_compiled", lambda samples, terms: always)
    return request.param


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "is_compiled", lambda samples, terms: True)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of terms that the one engine was asked for."""
    calls: list[int] = []
    each = Engine.each

    def counted(self: Engine, data: Any, use: Callable[..., Any], **options: Any) -> list[Any]:
        calls.append(len(self))
        return each(self, data, use, **options)

    monkeypatch.setattr(Engine, "each", counted)
    return calls


def _data(rows: int = ROWS) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    x, z = rng.normal(size=(2, rows))
    return {"t": np.linspace(0.0, 10.0, rows), "x": x, "z": z}


def _many(count: int, seed: int = 0) -> list[Term]:
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0.5, 3.0, size=(2, count))
    return [parse(f"sin({p}*t)*x + {q}*z", NAMES) for p, q in zip(a, b, strict=True)]


def test_columns_are_those_of_numpy(rule: str) -> None:
    data = _data()
    terms = [*TERMS, TERMS[3], *_many(5)]
    found = Evaluator(data).columns(terms)
    cache = ColumnCache(data)
    assert found.T.flags.c_contiguous
    for k, term in enumerate(terms):
        np.testing.assert_allclose(found[:, k], cache.column(term), rtol=1e-12, atol=1e-14)


def test_pieces_are_those_of_numpy(rule: str) -> None:
    data = _data()
    columns = Reference(data).columns(TERMS)
    pieces = Evaluator(data).reduced(TERMS, lambda block, part: (part, block.copy()))
    assert [part.start for part, _ in pieces] == list(range(0, ROWS, module.PIECE))
    for part, block in pieces:
        np.testing.assert_allclose(block, columns[part].T, rtol=1e-12, atol=1e-14)


def test_a_column_is_the_same_bits_in_any_company(compiled: None) -> None:
    data, terms = _data(), [*TERMS, *_many(600)]
    every = Evaluator(data).columns(terms)
    alone = Evaluator(data)
    for k in (0, 3, 5, 9, 40, 612):
        np.testing.assert_array_equal(alone.columns([terms[k]])[:, 0], every[:, k])
    part = alone.reduced(terms[300:303], lambda block, part: block.copy())
    np.testing.assert_array_equal(np.hstack(part), every[:, 300:303].T)


def test_kept_columns_are_not_computed_again(compiled: None, asked: list[int]) -> None:
    evaluator, terms = Evaluator(_data()), _many(20)
    first = evaluator.columns(terms)
    again = evaluator.columns([*terms, *_many(3, seed=1)])
    np.testing.assert_array_equal(again[:, :20], first)
    evaluator.columns(_many(2, seed=2), keep=False)
    evaluator.columns(_many(2, seed=2), keep=False)
    assert asked == [20, 3, 2, 2]


def test_batches_of_any_size_and_length_share_one_compilation(compiled: None) -> None:
    Evaluator(_data()).columns(_many(3))
    before = compilations()
    for count, rows in ((1, ROWS), (40, 60_000), (300, 2 * ROWS), (700, ROWS)):
        evaluator = Evaluator(_data(rows))
        evaluator.columns(_many(count))
        evaluator.reduced(_many(min(count, module.TOGETHER)), lambda block, part: None)
    assert compilations() == before


def test_few_samples_and_single_estimates_are_left_to_numpy(asked: list[int]) -> None:
    short, long = _data(2000), _data(100_000)
    Evaluator(short).columns(_many(300))
    Evaluator(long).columns(_many(5))
    assert not asked
    searching = Evaluator(long)
    searching.columns(_many(60), keep=False)
    searching.columns(_many(1, seed=3), keep=False)
    assert asked == [60, 1]


def test_a_search_asks_the_engine_that_compile_terms_asks(asked: list[int]) -> None:
    data = _data(100_000)
    y = data["x"] * data["z"] + 2.0 * np.sin(2.5 * data["t"])
    problem = RegressionProblem(y, data, resources=Resources(limit_bytes=2**26))
    problem.solve([_many(2, seed=k) for k in range(40)])
    assert asked and min(asked) > 1
    asked.clear()
    theta = compile_terms(_many(7), NAMES).evaluate(np.column_stack(list(data.values())))
    assert asked == [7]
    np.testing.assert_allclose(theta, Reference(data).columns(_many(7)), rtol=1e-12, atol=1e-14)


@pytest.mark.long
def test_discovery_goes_through_the_engine_and_finds_the_same(
    rule: str, asked: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.linspace(0.0, 10.0, 400)
    x, v = np.exp(-0.1 * t) * np.cos(2.0 * t), np.exp(-0.1 * t) * np.sin(2.0 * t)
    rates = {"dx": -0.1 * x - 2.0 * v, "dv": -0.1 * v + 2.0 * x}
    found = discover(
        [Recording("a", t, {"x": x, "v": v, **rates})],
        states=["x", "v"],
        derivatives=["dx", "dv"],
        modes=1,
        config=SearchConfig(population=30, generations=4),
    )
    law = {e.state: {str(f.term.name): f.coefficient for f in e.terms} for e in found.equations}
    assert law["x"] == pytest.approx({"x": -0.1, "v": -2.0}, rel=1e-8)
    assert law["v"] == pytest.approx({"v": -0.1, "x": 2.0}, rel=1e-8)
    assert sum(asked) > 500 if rule == "machine" else not asked
