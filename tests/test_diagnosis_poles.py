"""Laws without a name are finite wherever the motion that they are found on may reach."""

from __future__ import annotations

import pytest

from jaxsr.diagnosis.laws.poles import without_poles
from jaxsr.expressions import Term, parse

RANGES = {"q": (-1.0, 1.0), "v": (-2.0, 2.0)}


def law(text: str) -> Term:
    """A term with the constant a1 as a candidate's template has it."""
    return parse(text).substitute({"a1": Term.variable("{a1}")})


@pytest.mark.parametrize(
    ("text", "a1", "finite"),
    [
        ("v/(q + a1)", 1.5, True),
        ("v/(q + a1)", 1.0, False),
        ("v/(q + a1)", 0.2, False),
        ("v/(q - a1)", 3.0, True),
        ("q**2*(v + a1)**-2", 1.9, False),
        ("q**2*(v + a1)**-2", 2.35, False),  # a tenth of 4 beyond is 2.4
        ("q**2*(v + a1)**-2", 2.45, True),
        ("q/(q**2 + a1*Abs(v) + 0.1)", 1.0, True),
        ("sin(1/(v*q))", 1.0, False),
        ("q/(w + a1)", -1.0, True),  # of what nothing is recorded nothing is known
    ],
)
def test_a_denominator_keeps_its_sign_over_the_motion(text: str, a1: float, finite: bool) -> None:
    tells = without_poles([law("v"), law(text)], RANGES)
    assert tells is not None
    assert tells({"c1": 1.0, "c2": 1.0, "a1": a1}) is finite


@pytest.mark.parametrize(
    ("text", "a1", "finite"),
    [
        ("(a1 - v)**0.7", 2.05, False),  # a fortieth of 4 beyond is 2.1
        ("(a1 - v)**0.7", 2.15, True),
        ("sqrt(v**2 - a1)", 0.1, False),
        ("sqrt(v**2 - a1)", -0.1, True),
        ("log(q + a1)", 1.2, True),
        ("log(q + a1)", 0.9, False),
        ("(v + 2.2)**a1", 1.5, True),
        ("v**a1", 1.5, False),
        ("Abs(v)**a1", 1.5, True),
    ],
)
def test_roots_and_logarithms_are_taken_of_nothing_below_zero(
    text: str, a1: float, finite: bool
) -> None:
    tells = without_poles([law(text)], RANGES)
    assert tells is not None
    assert tells({"c1": 1.0, "a1": a1}) is finite


def test_a_law_without_denominators_is_always_finite() -> None:
    assert without_poles([law("a1*q**3"), law("v/a1"), law("q/2")], RANGES) is None
