"""The likeliest width of a corner: the top of a parabola over its logarithm."""

from __future__ import annotations

import math

import pytest

from jaxsr.diagnosis.likelihood.widths import likeliest_width


def parabola(width: float) -> float:
    """Log evidence whose top lies at 0.3."""
    return 7.0 - 2.0 * (math.log(width) - math.log(0.3)) ** 2


@pytest.mark.parametrize("spread", [1.5, 2.0, 4.0])
def test_the_top_of_a_parabola_is_found(spread: float) -> None:
    logs = {w: parabola(w) for w in (0.25 / spread, 0.25, 0.25 * spread, 40.0)}
    found = likeliest_width(logs, 0.0)
    assert found == pytest.approx(0.3, rel=1e-9)


def test_no_top_is_looked_for_beyond_the_widths_that_are_known() -> None:
    assert likeliest_width({}, 0.0) is None
    assert likeliest_width({1.0: 3.0, 2.0: 5.0, 4.0: 6.0}, 0.0) is None
    assert likeliest_width({1.0: -math.inf, 2.0: 5.0, 4.0: 4.0}, 0.0) is None


def test_a_top_that_promises_less_is_not_asked_for() -> None:
    logs = {w: parabola(w) for w in (0.15, 0.3, 0.6)}
    assert likeliest_width(logs, 0.1) is None
