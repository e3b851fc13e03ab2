"""Smoothing: exactness, gains, choice of the strength, noise models, gaps, the automatic pick."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxsr._result import InputError
from jaxsr.views import (
    SMOOTHERS,
    adaptive_spline,
    choose_smoother,
    fit_adaptive,
    fit_spline,
    noise_by_sample,
    smooth,
    tikhonov,
    total_variation,
)
from jaxsr.views.penalised import CHOICES, PenalisedProblem


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(x))))


def _uneven(rng: np.random.Generator, samples: int, span: float = 10.0) -> np.ndarray:
    return np.sort(rng.uniform(0.0, span, samples))


@pytest.mark.parametrize("order", [2, 3, 4])
def test_the_penalty_is_the_integral_and_the_freedom_the_trace(order):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        t = (_uneven(rng, 60) - 0.0) / 10.0
        problem = PenalisedProblem(t, np.sin(t), rng.uniform(0.5, 1.5, 60), order, 20)
        rigour = rng.uniform(0.5, 2.0, problem.edges.size - 1)
        problem.penalty = problem.penalise(rigour)
        full = [_dense(bands) for bands in (problem.gram, problem.penalty)]
        c = rng.normal(size=20)
        points = np.linspace(0.0, 1.0, 40_001)[:-1] + 1.25e-5
        curve = problem.spline(c).derivative(order)(points) ** 2
        curve *= rigour[np.searchsorted(problem.edges, points, side="right") - 1]
        assert c @ full[1] @ c == pytest.approx(np.mean(curve), rel=2e-3)
        strength = np.trace(full[0]) / np.trace(full[1]) * 10.0 ** rng.uniform(-2.0, 2.0)
        trace = np.trace(np.linalg.solve(full[0] + strength * full[1], full[0]))
        assert problem.freedom(strength) == pytest.approx(trace, rel=1e-4)


def _dense(bands: np.ndarray) -> np.ndarray:
    lower = sum(np.diag(b[: b.size - d], -d) for d, b in enumerate(bands))
    return lower + np.tril(lower, -1).T


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    order=st.sampled_from([2, 3, 4]),
    strength=st.floats(-8.0, 4.0),
)
def test_polynomials_below_the_order_are_exact_on_any_grid(seed, order, strength):
    rng = np.random.default_rng(seed)
    t = _uneven(rng, 70)
    p = np.polynomial.Polynomial(rng.normal(size=order), domain=[0.0, 10.0])
    y = p(t)
    y[rng.random(t.size) < 0.1] = np.nan
    sigma = rng.uniform(0.5, 2.0, t.size)
    for derivative in (0, 1):
        x = tikhonov(t, y, derivative, order, strength=10.0**strength, noise=sigma)
        expected = p.deriv(derivative)(t) if derivative else p(t)
        np.testing.assert_allclose(x, expected, atol=1e-5 * np.max(np.abs(p(t))))


@pytest.mark.parametrize("order", [2, 3])
def test_the_gain_on_a_sine_is_the_closed_form(order):
    t = np.linspace(0.0, 20.0, 1001)
    for frequency in (0.3, 0.6, 1.2):
        strength = (2.0 * np.pi * 0.6) ** (-2 * order)
        x = tikhonov(t, np.sin(2.0 * np.pi * frequency * t), 0, order, strength=strength)
        middle = slice(300, 700)
        gain = x[middle] @ np.sin(2 * np.pi * frequency * t[middle])
        gain /= np.sum(np.sin(2 * np.pi * frequency * t[middle]) ** 2)
        exact = 1.0 / (1.0 + (frequency / 0.6) ** (2 * order))
        assert gain == pytest.approx(exact, rel=0.02, abs=2e-3)


@pytest.mark.parametrize("method", [tikhonov, adaptive_spline])
def test_errors_fall_with_the_noise_at_the_rate_of_theory(method):
    """At fixed samples, error of a smooth signal ~ noise^(2k/(2k+1)), nearly the noise itself."""
    t = np.linspace(0.0, 10.0, 400)
    truth = np.sin(2.0 * t) + 0.3 * np.cos(3.1 * t)
    errors = []
    for sigma in (1e-3, 1e-1):
        draws = [truth + sigma * np.random.default_rng(s).normal(size=t.size) for s in range(3)]
        errors.append(np.median([_rms(method(t, y, 0) - truth) for y in draws]))
    slope = np.log(errors[1] / errors[0]) / np.log(100.0)
    assert 0.8 < slope < 1.02
    assert errors[1] < 0.35 * 0.1


@pytest.mark.long
@pytest.mark.parametrize("choice", CHOICES)
def test_every_choice_of_the_strength_is_near_the_best(choice):
    """Error at most 1.5 times (discrepancy: 2 times) the least over all strengths, on median."""
    ratios = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        t = _uneven(rng, 120)
        truth = np.sin(2.0 * t) * np.exp(-0.1 * t)
        y = truth + 0.05 * rng.normal(size=t.size)
        tried = 10.0 ** np.arange(-7.0, 1.0)
        best = min(_rms(tikhonov(t, y, 0, strength=s) - truth) for s in tried)
        ratios.append(_rms(tikhonov(t, y, 0, choice=choice) - truth) / best)
    assert np.median(ratios) < (2.0 if choice == "discrepancy" else 1.5)


def test_discrepancy_leaves_the_noise():
    rng = np.random.default_rng(0)
    t = _uneven(rng, 300)
    y = np.sin(2.0 * t) + 0.05 * rng.normal(size=t.size)
    x = tikhonov(t, y, 0, noise=0.05, choice="discrepancy")
    assert _rms(y - x) == pytest.approx(0.05, rel=0.03)


@pytest.mark.parametrize("method", sorted(SMOOTHERS))
def test_scaling_and_shifting_of_time_and_signal_pass_through(method):
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 10.0, 200)
    y = np.sin(2.0 * t) + 0.05 * rng.normal(size=t.size)
    x = smooth(t, y, method, noise=0.05)
    moved = smooth(3.0 * t + 7.0, 50.0 * y - 20.0, method, noise=2.5)
    tolerance = 0.01 if method == "total_variation" else 1e-3
    np.testing.assert_allclose((moved + 20.0) / 50.0, x, atol=tolerance)


@pytest.mark.long
@pytest.mark.parametrize("method", ["auto", *sorted(SMOOTHERS)])
@pytest.mark.parametrize("uneven", [False, True])
def test_missing_samples_are_filled_and_errors_stay_below_the_noise(method, uneven):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        t = _uneven(rng, 300) if uneven else np.linspace(0.0, 10.0, 300)
        truth = np.sin(2.0 * t)
        y = truth + 0.05 * rng.normal(size=t.size)
        y[rng.random(t.size) < 0.05] = np.nan
        y[:3] = np.nan
        x = smooth(t, y, method)
        assert np.isnan(x[:3]).all()
        assert np.isfinite(x[3:-3]).mean() > 0.98
        # theory: noise * sqrt(df / n) with some 25 degrees of freedom, twice that allowed
        limit = 0.05 * (1.0 if method == "total_variation" else 0.6)
        assert _rms(x - truth) < limit


def test_gaps_stay_empty_and_present_samples_are_always_answered():
    t = np.linspace(0.0, 10.0, 300)
    y = np.sin(t) + 0.01 * np.random.default_rng(0).normal(size=t.size)
    y[100:140] = np.nan
    for method in ("auto", *SMOOTHERS):
        x = smooth(t, y, method)
        assert np.isnan(x[100:140]).all()
        assert np.isfinite(np.delete(x, np.arange(100, 140))).all()


def test_clean_data_come_back_unchanged_and_filled():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        t = _uneven(rng, 400) if seed % 2 else np.linspace(0.0, 10.0, 400)
        truth = np.sin(rng.uniform(0.5, 3.0) * t)
        y = truth.copy()
        y[50::60] = np.nan
        x = smooth(t, y)
        np.testing.assert_array_equal(x[np.isfinite(y)], y[np.isfinite(y)])
        assert np.isfinite(x).all()
        np.testing.assert_allclose(x, truth, atol=5e-3)
    np.testing.assert_array_equal(smooth(t, np.ones(t.size)), np.ones(t.size))


@pytest.mark.long
def test_noise_that_grows_with_the_signal_is_recognised():
    t = np.linspace(0.0, 10.0, 512)
    truth = np.exp(-0.3 * t) * np.cos(4.0 * t)
    even, weighted = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        y = truth * (1.0 + 0.05 * rng.normal(size=t.size))
        sigma = noise_by_sample(t, y)
        size = 0.05 * np.abs(truth)
        assert _rms(sigma) == pytest.approx(_rms(size), rel=0.35)
        assert np.corrcoef(sigma, size)[0, 1] > 0.95
        even.append(_rms(fit_adaptive(t, y).spline(t) - truth))
        weighted.append(_rms(fit_adaptive(t, y, noise=sigma).spline(t) - truth))
        flat = noise_by_sample(t, truth + 0.02 * rng.normal(size=t.size))
        assert np.ptp(flat) == 0.0
        assert flat[0] == pytest.approx(0.02, rel=0.15)
    assert _rms(np.array(weighted)) < 0.8 * _rms(np.array(even))


def test_the_adaptive_spline_beats_the_even_one_where_roughness_varies():
    t = np.linspace(0.0, 10.0, 512)
    bump = np.tanh(8.0 * (t - 4.0)) + 0.3 * np.sin(t)
    even, adapted, harmless = [], [], []
    for seed in range(4):
        noise = 0.05 * np.random.default_rng(seed).normal(size=t.size)
        even.append(_rms(tikhonov(t, bump + noise, 0) - bump))
        adapted.append(_rms(adaptive_spline(t, bump + noise, 0) - bump))
        sine = np.sin(2.0 * t)
        ratio = _rms(adaptive_spline(t, sine + noise, 0) - sine)
        harmless.append(ratio / _rms(tikhonov(t, sine + noise, 0) - sine))
    assert np.median(np.array(adapted) / np.array(even)) < 0.75
    assert np.median(harmless) < 1.1


def test_fast_signals_are_not_taken_for_noise():
    t = np.linspace(0.0, 10.0, 512)
    y = np.sin(40.0 * t) + 0.02 * np.random.default_rng(0).normal(size=t.size)
    fit = fit_spline(t, y)
    assert fit.freedom > 100.0
    assert _rms(fit.spline(t) - np.sin(40.0 * t)) < 0.02


@pytest.mark.long
def test_the_pick_is_the_spline_for_motions_and_total_variation_for_relays():
    t = np.linspace(0.0, 10.0, 250)
    for seed in range(2):
        noise = 0.05 * np.random.default_rng(seed).normal(size=t.size)
        relay = np.sign(np.sin(1.7 * t))
        assert choose_smoother(t, relay + noise) == "total_variation"
        assert choose_smoother(t, np.sin(1.7 * t) + noise) == "adaptive_spline"
        x = smooth(t, relay + noise)
        assert _rms(x - relay) < 0.5 * _rms(smooth(t, relay + noise, "savitzky_golay") - relay)


def test_total_variation_smooths_steps_and_kinks():
    t = np.linspace(0.0, 1.0, 400)
    noise = 0.05 * np.random.default_rng(0).normal(size=t.size)
    step, kink = np.where(t > 0.37, 1.0, 0.0), np.abs(t - 0.37)
    for truth, order in ((step, 0), (kink, 1)):
        x = total_variation(t, truth + noise, 0, noise=0.05, order=order)
        assert _rms(x - truth) < 0.4 * 0.05
        assert _rms(truth + noise - x) == pytest.approx(0.05 * 1.03, rel=0.02)


def test_columns_are_smoothed_one_by_one():
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 10.0, 200)
    y = np.stack([np.sin(t), np.cos(2.0 * t)], axis=1) + 0.05 * rng.normal(size=(200, 2))
    noise = np.full(y.shape, 0.05)
    both = smooth(t, y, "tikhonov", noise=noise)
    for j in range(2):
        np.testing.assert_array_equal(both[:, j], smooth(t, y[:, j], "tikhonov", noise=0.05))


def test_wrong_calls_teach():
    t = np.linspace(0.0, 1.0, 50)
    with pytest.raises(InputError, match="unknown smoother 'median'"):
        smooth(t, t, "median")
    with pytest.raises(InputError, match="order 5"):
        tikhonov(t, t, order=5)
    with pytest.raises(InputError, match="unknown choice 'aic'"):
        tikhonov(t, t, choice="aic")
    with pytest.raises(InputError, match="not positive"):
        tikhonov(t, t, noise=np.zeros(50))
    with pytest.raises(InputError, match="derivative 4"):
        tikhonov(t, t, derivative=4)
    with pytest.raises(InputError, match="order from 1 to 3"):
        total_variation(t, t, 1, order=0)
    with pytest.raises(InputError, match="too few"):
        tikhonov(t[:4], t[:4])
