"""Rounding: constants become whole where the data do not tell them from whole ones."""

from __future__ import annotations

import numpy as np
import pytest

import jaxsr
from jaxsr.discovery.rounding import rounded
from jaxsr.expressions import parse, to_text
from jaxsr.regression import RegressionProblem


def _problem(law: str, noise: float = 0.0, seed: int = 0) -> RegressionProblem:
    rng = np.random.default_rng(seed)
    variables = {"t": np.linspace(0.0, 10.0, 300), "x": rng.uniform(0.2, 2.0, size=300)}
    y = jaxsr.expressions.evaluate(parse(law), variables)
    return RegressionProblem(y + noise * rng.normal(size=300), variables)


@pytest.mark.parametrize(
    ("law", "given", "expected"),
    [
        ("3*x**2", "x**1.9999", "x**2"),
        ("3*x**2", "x**2.015", "x**2"),
        ("2*x**-1", "x**-1.01", "1/x"),
        ("2*sin(x - t)", "sin(x - 1.0000002*t)", "sin(x - t)"),
        ("2*exp(-3*x)", "exp(-2.9999999*x)", "exp(-3*x)"),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_constants_next_to_whole_numbers_become_whole(
    law: str, given: str, expected: str, noise: float
) -> None:
    problem = _problem(law, noise)
    (term,) = rounded(problem, (parse(given),))
    constants = [n.value for n in term.walk() if n.is_constant]
    assert all(c.is_integer() for c in constants), to_text(term)
    x = {"t": np.linspace(0.0, 9.0, 50), "x": np.linspace(0.3, 1.9, 50)}
    column, wanted = (jaxsr.expressions.evaluate(e, x) for e in (term, parse(expected)))
    # a sine's sign is its coefficient's
    np.testing.assert_allclose(np.abs(column), np.abs(wanted), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("law", "near"),
    [
        ("2*sin(5*t + 1.047)", 1.047),  # a phase of pi/3
        ("3*x**2.01", 2.01),  # an exponent that the data tell from 2
        ("2*sin(1.0003*t + x)", 1.0003),  # ten seconds tell it from 1
        ("2*x**0.5", 0.5),
    ],
)
def test_constants_that_the_data_tell_from_whole_ones_stay(law: str, near: float) -> None:
    problem = _problem(law, 1e-5)
    (term,) = rounded(problem, (parse(law[2:]),))
    values = [n.value for n in term.walk() if n.is_constant]
    assert np.min(np.abs(np.array(values) - near)) < 1e-4


@pytest.mark.parametrize("seed", range(8))
def test_a_phase_of_a_third_of_pi_is_no_whole_number_under_noise_either(seed: int) -> None:
    """As much noise as sine leaves its phase open by 5 %, and still 1 is no better than 1.047."""
    (term,) = rounded(_problem("2*sin(5*t + 1.047)", 1.4, seed), (parse("sin(5*t + 1.047)"),))
    phase = max(n.value for n in term.walk() if n.is_constant and n.value < 4.0)
    assert not phase.is_integer() and abs(phase - 1.047) < 0.5


def test_other_terms_are_refined_and_none_is_lost() -> None:
    problem = _problem("3*x**2 + 2*sin(5*t + 1.047) - x", 0.02)
    terms = rounded(problem, [parse(e) for e in ("x**2.01", "sin(4.99*t + 1.1)", "x")])
    assert {to_text(t) for t in terms} > {"x**2", "x"} and len(terms) == 3
    assert problem.fit(terms).loss < 1.1 * 0.02**2
