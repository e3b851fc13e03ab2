"""A search can be run again: no choice of it hangs on the last digits of a sum."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.search_reruns import same
from jaxsr.evolution.individual import Individual
from jaxsr.evolution.polish import shortened
from jaxsr.expressions import Term, parse
from jaxsr.regression import RegressionProblem
from jaxsr.regression.digits import LOSS_BITS, rounded


@pytest.mark.long
def test_other_last_digits_lead_to_the_same_laws() -> None:
    """Where nine of ten searches are the same, fewer than five of eight are in one set of 200."""
    assert sum(map(same, range(8))) >= 5


def test_constants_have_the_digits_that_data_tell() -> None:
    """Rounding moves no constant by a tenth of its deviation, and drops what nothing tells."""
    rng = np.random.default_rng(6)
    x = rng.normal(size=400)
    law = Term.apply("sin", Term.apply("mul", Term.constant(1.2345678901), Term.variable("x")))
    for noise, bits in ((0.1, 24), (1e-6, 53)):
        y = 2.0 * np.sin(1.2345678901 * x) + noise * rng.normal(size=400)
        problem = RegressionProblem(y, {"x": x})
        (refined,) = problem.refine_many([(law,)])
        ((terms, loss),) = shortened(problem, [refined])
        before, after = (
            next(c.value for c in t.walk() if c.is_constant) for t in (refined[0][0], terms[0])
        )
        deviation = noise / (2.0 * np.sqrt(np.sum((x * np.cos(1.2345678901 * x)) ** 2)))
        assert abs(after - before) < 0.1 * deviation
        assert loss == pytest.approx(refined[1], rel=1e-5)
        assert after == rounded(after, bits)


def test_what_columns_of_the_model_make_is_no_term() -> None:
    """What is left of it beside them is rounding, which explained chance at unit size."""
    rng = np.random.default_rng(8)
    x, v = rng.normal(size=(2, 200))
    y = np.sin(v) + 0.1 * rng.normal(size=200)
    problem = RegressionProblem(y, {"x": x, "v": v}, fixed=np.stack([3.0 * x, x - v**2], axis=1))
    terms = [parse(text) for text in ("x", "v", "v**2", "sin(v)", "x*v")]
    (largest, _), *_ = problem.eliminate(terms, 5)
    assert set(largest) == {terms[1], terms[3], terms[4]}
    found = problem.beam(terms, 5)
    assert found and not any(t in (terms[0], terms[2]) for some in found for t in some)


def test_rounding_keeps_what_is_told() -> None:
    rng = np.random.default_rng(4)
    values = rng.normal(size=2000) * 10.0 ** rng.uniform(-300.0, 300.0, 2000)
    short = rounded(values)
    assert (np.abs(short / values - 1.0) <= 2.0**-LOSS_BITS).all()
    np.testing.assert_array_equal(rounded(short), short)
    assert len(np.unique(rounded(3.7 * (1.0 + 1e-13 * rng.normal(size=500))))) == 1
    np.testing.assert_array_equal(rounded(np.array([0.0, np.inf, np.nan])), [0.0, np.inf, np.nan])


def test_sets_whose_losses_differ_by_rounding_are_equals() -> None:
    terms = (Term.variable("x"),)
    assert Individual.of(terms, 0.1) == Individual.of(terms, 0.1 * (1.0 + 1e-12))
