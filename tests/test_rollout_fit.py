"""Constants by simulation: least squares, its intervals, and errors held back."""

from __future__ import annotations

import numpy as np
import pytest
from rollout_systems import (
    DRIVEN,
    DRIVEN_TRUE,
    PENDULUM,
    TRUE,
    experiment,
    pendulum,
    solved,
    system_of,
    trace_of,
)

from jaxsr.discovery.rollout import Segments, System, cut, fit_rollout
from jaxsr.discovery.rollout import fit as fitting
from jaxsr.expressions.term import Term


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4))
def test_clean_data_give_the_constants_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 4.0, 41)
    traces, starts = [], rng.uniform(-1.0, 1.0, size=(3, 2))
    for k in range(3):
        u = rng.normal(size=41)
        rates = pendulum(TRUE, lambda s, u=u: float(np.interp(s, t, u)))
        q, v = solved(rates, list(starts[k]), t)
        # only the angle has a sensor; the velocity's start is estimated from a poor guess
        traces.append(trace_of(t, {"q": q, "v": v + 0.1, "u": u}, {"q": q}, 1e-6))
    begin = TRUE * rng.uniform(0.9, 1.1, size=6)
    fitted = fit_rollout(PENDULUM, cut(traces, 41, 3), begin, time="t", substeps=12, iterations=40)
    assert fitted is not None
    np.testing.assert_allclose(fitted.constants, TRUE, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(fitted.starts, starts.T, rtol=0.0, atol=1e-6)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """60 records of 3 stretches: each constant is missed 3 times of 60 on average.

    A right 95 % interval misses ten times or more with probability 0.1 % a constant, and all
    three constants together 24 times or more (of 180, if independent) with about 1e-5.
    """
    errors, inside = [], []
    for seed in range(60):
        segments = cut(experiment(seed, 25, 0.05), 25, 3)
        fitted = fit_rollout(DRIVEN, segments, 1.1 * DRIVEN_TRUE, time="t", substeps=2)
        assert fitted is not None
        low, high = fitted.ci95().T
        inside.append((low <= DRIVEN_TRUE) & (DRIVEN_TRUE <= high))
        errors.append((fitted.constants - DRIVEN_TRUE) / ((high - low) / 3.96))
    missed = 60 - np.sum(inside, axis=0)
    assert np.max(missed) < 10 and np.sum(missed) < 24, missed
    # nor are they wider than need be: errors over standard errors are unit normals, whose
    # standard deviation over 60 is 1 +- 0.09 and whose mean is 0 +- 0.13
    assert np.all(np.abs(np.std(errors, axis=0) - 1.0) < 0.35), np.std(errors, axis=0)
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.5), np.mean(errors, axis=0)


def test_the_loss_is_one_where_only_noise_is_left() -> None:
    losses = []
    for seed in range(12):
        segments = cut(experiment(seed, 40, 0.03), 40, 3)
        fitted = fit_rollout(DRIVEN, segments, DRIVEN_TRUE, time="t", substeps=2)
        assert fitted is not None and fitted.count == 120
        losses.append(fitted.loss)
    # a mean of 12 * 114 squares of unit normals: 1 +- 0.038
    assert abs(np.mean(losses) - 1.0) < 4.0 * 0.038


@pytest.mark.parametrize("damping", [0.0, 1e-3, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_eliminating_the_starts_solves_the_whole_least_squares(damping: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces, rows, free, width = 4, 9, 3, 2
    point = fitting._Point(
        np.zeros(free),
        np.zeros((width, pieces)),
        rng.normal(size=(pieces, rows)),
        rng.normal(size=(pieces, rows, free)),
        rng.normal(size=(pieces, rows, width)),
    )
    step = fitting._solved(point, damping)
    assert step is not None
    jacobian = np.zeros((pieces * rows, free + pieces * width))
    jacobian[:, :free] = point.by_constant.reshape(-1, free)
    for k in range(pieces):
        own = slice(free + k * width, free + (k + 1) * width)
        jacobian[k * rows : (k + 1) * rows, own] = point.by_start[k]
    tall = np.vstack([jacobian, np.diag(np.sqrt(damping * np.sum(jacobian**2, axis=0)))])
    right = np.concatenate([point.residual.ravel(), np.zeros(tall.shape[1])])
    dense = -np.linalg.lstsq(tall, right, rcond=None)[0]
    np.testing.assert_allclose(step[0], dense[:free], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(step[1], dense[free:].reshape(pieces, width).T, rtol=1e-8, atol=1e-9)


def _refitted_without(system: System, segments: Segments, begin: np.ndarray) -> list[float]:
    """Squares of each stretch, its start free, with the constants that the others give."""
    out = []
    for k in range(segments.count):
        rest = np.flatnonzero(np.arange(segments.count) != k)
        others = fit_rollout(system, segments.take(rest), begin, time="t")
        assert others is not None
        parts = system.unpacked(others.constants)
        whole = [
            Term.apply("mul", Term.constant(c), term)
            for rows in parts.values()
            for term, c, _ in rows
        ]
        total = whole[0]
        for term in [*whole[1:], *system.known.values()]:
            total = Term.apply("add", total, term)
        fixed = System({"x": ()}, {"x": total})
        own = fit_rollout(fixed, segments.take(np.array([k])), np.zeros(0), time="t")
        assert own is not None
        out.append(own.loss * (own.count - 1))
    return out


def test_held_back_errors_are_those_of_refits_where_constants_are_linear() -> None:
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 3.0, 20)
    traces = []
    for _ in range(5):
        u, w = rng.normal(size=(2, 20))
        x = np.cumsum(u) * 0.1 + rng.normal(size=20)  # not quite of the class: any data will do
        traces.append(trace_of(t, {"x": x, "u": u, "w": w}, {"x": x}, 0.5))
    system = system_of({"x": ["u", "w", "t"]})
    segments = cut(traces, 20, 5)
    fitted = fit_rollout(system, segments, np.ones(3), time="t")
    assert fitted is not None
    expected = _refitted_without(system, segments, np.ones(3))
    np.testing.assert_allclose(fitted.held_back, expected, rtol=1e-5)
    assert np.sum(fitted.held_back) > fitted.loss * (fitted.count - 8)  # more than what is fitted


def test_held_back_errors_are_those_of_refits_to_first_order() -> None:
    apart = []
    for noise in (0.04, 0.01):
        segments = cut(experiment(3, 30, noise, 5), 30, 5)
        fitted = fit_rollout(DRIVEN, segments, DRIVEN_TRUE, time="t")
        assert fitted is not None
        expected = np.array(_refitted_without(DRIVEN, segments, DRIVEN_TRUE))
        apart.append(np.max(np.abs(fitted.held_back / expected - 1.0)))
    assert apart[0] < 0.05 and apart[1] < 0.5 * apart[0], apart


def test_a_system_that_cannot_be_followed_gives_none() -> None:
    t = np.linspace(0.0, 5.0, 30)
    segments = cut([trace_of(t, {"x": np.ones(30)})], 30, 1)
    assert fit_rollout(system_of({"x": ["x**3"]}), segments, np.array([10.0]), time="t") is None
    assert fit_rollout(system_of({"x": ["log(-x)"]}), segments, np.array([1.0]), time="t") is None


def test_missing_samples_count_for_nothing() -> None:
    trace = experiment(1, 40, 0.02, 1)[0]
    gaps = trace["measured"]["x"].copy()
    gaps[[3, 10, 11, 12, 30]] = np.nan
    with_gaps = cut([{**trace, "measured": {"x": gaps}}], 40, 1)
    fitted = fit_rollout(DRIVEN, with_gaps, DRIVEN_TRUE, time="t", iterations=40)
    # the same with any number in the place of a missing one and no weight on it
    loose = trace["noise"]["x"].copy()
    loose[np.isnan(gaps)] = 1e12
    weighed = cut([{**trace, "noise": {"x": loose}}], 40, 1)
    other = fit_rollout(DRIVEN, weighed, DRIVEN_TRUE, time="t", iterations=40)
    assert fitted is not None and other is not None
    assert (fitted.count, other.count) == (35, 40)
    np.testing.assert_allclose(fitted.constants, other.constants, rtol=1e-5)


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
def test_the_unit_of_a_state_changes_its_constants_unit_alone(unit: float) -> None:
    """A predator and its prey, the prey counted one by one or by the thousand million."""
    true = np.array([1.1, -0.4, 0.1 / unit, -0.4])

    def rates(_: float, x: np.ndarray) -> list[float]:
        both = x[0] * x[1]
        return [true[0] * x[0] + true[1] * both, true[2] * both + true[3] * x[1]]

    t = np.linspace(0.0, 10.0, 81)
    a, b = solved(rates, [10.0 * unit, 5.0], t)
    system = system_of({"a": ["a", "a*b"], "b": ["a*b", "b"]})
    trace = trace_of(t, {"a": a, "b": b})
    trace["noise"] = {"a": np.full(81, 1e-3 * unit), "b": np.full(81, 1e-3)}
    begin = true * np.array([1.05, 0.97, 1.04, 0.95])
    fitted = fit_rollout(system, cut([trace], 41, 2), begin, time="t", substeps=8)
    assert fitted is not None
    np.testing.assert_allclose(fitted.constants, true, rtol=1e-5)
