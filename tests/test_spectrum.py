"""Frequencies at which a residual holds waves, alone and times a variable."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.expressions import Term
from jaxsr.regression import RegressionProblem, residual_frequencies, residual_waves


def test_spectrum_of_the_residual_shows_the_frequency_on_irregular_samples():
    rng = np.random.default_rng(4)
    t = np.sort(rng.uniform(0.0, 20.0, 400))
    y = 3.0 * t + np.sin(7.3 * t + 1.0)
    problem = RegressionProblem(y, {"t": t})
    found = residual_frequencies(problem, [Term.variable("t"), Term.constant(1.0)], "t", 1)
    assert abs(found[0] - 7.3) < np.pi / 20.0  # within the resolution of the span


def test_spectrum_of_the_residual_shows_what_a_wave_is_multiplied_by():
    rng = np.random.default_rng(4)
    t, a, b = np.sort(rng.uniform(0.0, 20.0, 400)), *rng.normal(size=(2, 400))
    y = 3.0 * t + b * np.sin(7.3 * t + 1.0)
    problem = RegressionProblem(y, {"t": t, "a": a, "b": b})
    terms = [Term.variable("t"), Term.constant(1.0)]
    (factor, w), *others = residual_waves(problem, terms, "t", 3, ("", "a", "b"))
    assert factor == "b" and abs(w - 7.3) < np.pi / 20.0 and len(others) == 2
    assert residual_waves(problem, terms, "t", 2) == [
        ("", w) for w in residual_frequencies(problem, terms, "t", 2)
    ]


def test_a_state_has_as_many_waves_over_its_range_as_its_samples_resolve():
    """A rotor that turns seven and a half times, read two thousand times: thirty waves, and ninety.

    Of a hundred samples at random places twenty are looked for.
    """
    rng = np.random.default_rng(4)
    t = np.linspace(0.0, 1.0, 2000)
    angle = 47.0 * np.sin(0.5 * np.pi * t) ** 2
    for cycles in (30.0, 90.0):
        n = 2.0 * np.pi * cycles / 47.0
        problem = RegressionProblem(np.sin(n * angle + 1.0), {"q": angle})
        (w,) = residual_frequencies(problem, [], "q", 1)
        assert abs(w - n) < np.pi / 47.0
    problem = RegressionProblem(rng.normal(size=100), {"q": rng.uniform(0.0, 47.0, 100)})
    waves = problem.waves("q")
    assert waves is not None
    np.testing.assert_allclose(waves.grid[-1], 2.0 * np.pi * 20.0 / 47.0, rtol=0.05)


def test_waves_are_kept_within_a_limit_and_made_alike_again(monkeypatch: pytest.MonkeyPatch):
    rng = np.random.default_rng(6)
    x = dict(zip("abc", rng.normal(size=(3, 300)).cumsum(axis=1), strict=True))
    problem = RegressionProblem(x["a"] * np.sin(x["b"]), x)
    every = [(v, f) for v in "abc" for f in ("", *"abc") if f != v]
    whole = {key: problem.waves(*key) for key in every}
    limit = 3 * max(w.bytes for w in whole.values() if w is not None)
    monkeypatch.setattr("jaxsr.regression.problem._MOST_WAVES", limit)
    problem = RegressionProblem(x["a"] * np.sin(x["b"]), x)
    for key in (*every, *every):
        again, before = problem.waves(*key), whole[key]
        assert again is not None and before is not None
        np.testing.assert_array_equal(again.sines, before.sines)
        assert sum(w.bytes for w in problem._waves.values() if w is not None) <= limit
