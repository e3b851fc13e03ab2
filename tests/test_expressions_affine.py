"""Slopes of lines read off terms, against SymPy."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from jaxsr.expressions import Term, affine_slope, evaluate, parse, to_sympy, to_text

LINES = [
    "u",
    "a*u",
    "(u - c*v)/m",
    "a*(u + b) - (3*u - v)/m",
    "-(u/2)*sin(q)*2",
    "(u*a + u*b)/(m + cos(q)**2)",
    "u**1*q",
    "u**2/u",
    "sqrt(q)*(2 - u)",
    "Piecewise((u, q > 0), (2*u + 1, True))",
    "exp(q)*a + 1",
]
CURVES = ["u**3", "u*u", "sin(u)", "Abs(u)", "a/u", "u*tanh(u)", "Max(u, 0)", "q**u", "sign(u)*u"]
NAMES = ["a", "b", "c", "m", "q", "v", "u"]


@pytest.mark.parametrize("text", LINES)
def test_slopes_are_those_of_sympy(text: str) -> None:
    term, slope = parse(text), affine_slope(parse(text), "u")
    assert slope is not None and "u" not in slope.variables
    right = sympy.diff(to_sympy(term), sympy.Symbol("u", real=True))
    values = np.random.default_rng(0).uniform(0.5, 2.0, size=(7, 20))
    found = np.broadcast_to(evaluate(slope, dict(zip(NAMES, values, strict=True))), (20,))
    numeric = sympy.lambdify([sympy.Symbol(n, real=True) for n in NAMES], right, "numpy")
    np.testing.assert_allclose(found, np.broadcast_to(numeric(*values), (20,)), rtol=1e-12)
    assert affine_slope(parse(to_text(slope)), "u") is not None  # it reads back


@pytest.mark.parametrize("text", CURVES)
def test_curves_are_no_lines(text: str) -> None:
    assert affine_slope(parse(text), "u") is None


def test_a_condition_on_the_variable_stays_in_the_slope() -> None:
    slope = affine_slope(parse("Piecewise((u, u > 0), (2*u, True))"), "u")
    assert slope is not None and slope.variables == {"u"}


def test_shared_definitions_cost_no_more_than_they_are_many() -> None:
    """A tree of 2**60 nodes that are 60 different ones."""
    term = parse("1 + q")
    for _ in range(60):
        term = Term.apply("mul", Term.constant(0.5), Term.apply("add", term, term))
    line = Term.apply("add", Term.apply("mul", term, parse("u")), term)
    slope = affine_slope(line, "u")
    assert slope is not None and slope.variables == {"q"}
