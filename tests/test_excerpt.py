"""Orders of merit on an excerpt of long samples, and constants of long columns."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.expressions import parse, to_text
from jaxsr.regression import RegressionProblem
from jaxsr.regression.dictionary import Dictionary
from jaxsr.regression.excerpt import ROWS, Excerpt
from jaxsr.regression.slopes import Form

NAMES = ["t", "x", "z"]
TEXTS = ("x", "z", "x*z", "x**2", "z**3", "sin(x)", "exp(z)", "x*z**2", "Abs(x)", "integral(x)")
TERMS = [parse(text, NAMES, integrals=True) for text in TEXTS]
LONG = 3 * ROWS + 11


def _problem(rows: int = LONG, **options) -> RegressionProblem:
    rng = np.random.default_rng(0)
    x, z = rng.normal(size=(2, rows))
    t = np.linspace(0.0, 20.0, rows)
    y = 3.0 * x - 2.0 * x * z + 0.5 * np.sin(4.0 * t) + 0.1 * rng.normal(size=rows)
    return RegressionProblem(y, {"t": t, "x": x, "z": z}, **options)


def _views(rows: int) -> dict[str, dict]:
    weights = np.linspace(0.5, 2.0, rows)
    rng = np.random.default_rng(1)
    return {
        "plain": {},
        "weighed": {"view": lambda columns: weights[:, None] * columns},
        "beside a known model": {"fixed": rng.normal(size=(rows, 2))},
    }


@pytest.mark.parametrize("kind", _views(1))
def test_candidates_are_ranked_on_few_rows_and_the_missing_one_is_first(kind: str) -> None:
    problem = _problem(**_views(LONG)[kind])
    dictionary = Dictionary(problem, TERMS)
    assert dictionary.columns.shape == (len(TERMS), ROWS)
    assert [to_text(t) for t in dictionary.best([TERMS[0]], 1)] == ["x*z"]


@pytest.mark.parametrize("kind", _views(1))
def test_an_excerpt_holds_the_rows_of_the_problem(kind: str) -> None:
    problem = _problem(**_views(LONG)[kind])
    few = Excerpt(problem, 500)
    whole = problem.projected(TERMS)[few.rows].T
    np.testing.assert_allclose(few.columns(TERMS), whole, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(few.columns(TERMS[:-1]), whole[:-1], rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(few.target, problem.target[few.rows])


def test_short_samples_are_taken_whole() -> None:
    problem = _problem(700)
    assert len(problem.excerpt.rows) == 700
    residual = problem.residual(TERMS[:3])
    np.testing.assert_allclose(problem.excerpt.residual(TERMS[:3]), residual, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("rows", [700, LONG])
def test_waves_are_sines_of_the_grid_and_show_the_frequency(rows: int) -> None:
    problem = _problem(rows)
    waves = problem.waves("t")
    assert waves is not None
    t = problem.variables["t"][problem.excerpt.rows]
    angle = np.outer(waves.grid, t)
    np.testing.assert_allclose(waves.sines, np.sin(angle), atol=1e-6)
    np.testing.assert_allclose(waves.cosines, np.cos(angle), atol=1e-6)
    found = problem.frequencies([TERMS[0], TERMS[2]], "t", 1)
    assert found == pytest.approx([4.0], abs=np.pi / 40.0)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("text", ["sin(2.5*t + 0.4)*x", "Max(1.5*x, z)", "x/(0.3 + z**2)"])
def test_long_columns_have_the_derivatives_of_whole_ones(text: str, threads: int) -> None:
    problem = _problem()
    form = Form.of(parse(text, NAMES))
    rng = np.random.default_rng(2)
    constants = rng.uniform(0.5, 2.0, size=(3, form.constants))
    value, tangents = form.columns(constants, problem.evaluator.column)
    pieces = form.pieces(constants, problem.evaluator.column, LONG, threads)
    assert [part.start for part, *_ in pieces] == sorted(part.start for part, *_ in pieces)
    np.testing.assert_array_equal(np.hstack([own for _, own, _ in pieces]), value)
    for place, slope in tangents.items():
        joined = np.hstack([np.broadcast_to(t[place], own.shape) for _, own, t in pieces])
        np.testing.assert_allclose(joined, np.broadcast_to(slope, value.shape), atol=1e-8)
