"""Integration: convergence order, drift, gaps and what stays unknown."""

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.views import integrate

W = 2.0 * np.pi  # whole periods in whole seconds


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(x))))


def _uneven(samples: int, seed: int, span: float = 4.0) -> np.ndarray:
    jitter = np.random.default_rng(seed).uniform(-0.3, 0.3, samples) * span / samples
    return np.sort(np.linspace(0.0, span, samples) + jitter)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("uneven", [False, True])
def test_the_error_falls_with_the_fourth_power_of_the_sample_time(order, uneven):
    errors = []
    for samples in (80, 160, 320):
        worst = []
        for seed in range(5):
            t = _uneven(samples, seed) if uneven else np.linspace(0.0, 4.0, samples)
            exact = [np.sin(W * t) / W, -np.cos(W * t) / W**2][order - 1]
            x = integrate(t, np.cos(W * t), order, drift="none")
            start = np.cos(W * t[0]), np.sin(W * t[0])
            if order == 1:
                exact = exact - start[1] / W
            else:
                exact = exact + start[0] / W**2 - start[1] / W * (t - t[0])
            worst.append(np.max(np.abs(x - exact)))
        errors.append(np.median(worst))
    slope = np.log2(errors[0] / errors[2]) / 2.0
    assert slope > (3.4 if uneven else 3.7)


@pytest.mark.parametrize("order", [1, 2])
def test_cubics_are_integrated_exactly_on_any_grid(order):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        t = _uneven(40, seed)
        p = np.polynomial.Polynomial(rng.normal(size=4))
        exact = p.integ(order, lbnd=t[0])(t)
        y = p(t)
        y[rng.integers(1, 39)] = np.nan
        np.testing.assert_allclose(integrate(t, y, order, drift="none"), exact, atol=1e-10)


@pytest.mark.parametrize("drift", ["constants", "bias"])
def test_the_chosen_constants_are_those_of_a_motion_about_a_place(drift):
    """Bias of the sensor, starting values: none of them is seen; whole periods leave little."""
    errors = []
    for periods in (10, 40):
        t = np.linspace(0.0, periods, 50 * periods)
        wrong = 0.2 if drift == "bias" else 0.0
        x = integrate(t, -(W**2) * np.sin(W * t + 0.7) + wrong, 2, drift)
        errors.append(_rms(x - np.sin(W * t + 0.7)))
    # leakage of a sine into a straight line or a parabola: amplitude over number of periods
    assert errors[0] < 1.0 / 10.0
    assert errors[1] < errors[0] / 3.0


def test_the_high_pass_takes_a_wandering_bias_and_leaves_the_motion():
    t = np.linspace(0.0, 40.0, 4000)
    motion, wander = np.sin(W * t), 0.3 * np.sin(W * t / 40.0)
    x = integrate(t, -(W**2) * motion + wander, 2, "highpass", cutoff=0.2)
    inside = slice(500, -500)
    assert _rms((x - motion)[inside]) < 0.01
    assert _rms((integrate(t, -(W**2) * motion + wander, 2, "bias") - motion)[inside]) > 1.0


def test_scaling_of_time_and_signal():
    t = _uneven(200, 0)
    a = np.cos(W * t)
    x = integrate(t, a, 2)
    np.testing.assert_allclose(integrate(3.0 * t, 5.0 * a, 2), 45.0 * x, rtol=1e-9, atol=1e-12)
    both = integrate(t, np.stack([a, 2.0 * a], axis=1), 2)
    np.testing.assert_allclose(both[:, 1], 2.0 * x, atol=1e-12)


def test_noise_grows_as_theory_says():
    """Velocity from white noise: a random walk of variance noise^2 h t."""
    t = np.linspace(0.0, 10.0, 1001)
    ends = [
        integrate(t, 0.1 * np.random.default_rng(s).normal(size=t.size), drift="none")[-1]
        for s in range(200)
    ]
    assert _rms(np.array(ends)) == pytest.approx(0.1 * np.sqrt(0.01 * 10.0), rel=0.15)


def test_a_gap_parts_the_record():
    t = np.linspace(0.0, 20.0, 2000)
    a = -(W**2) * np.sin(W * t)
    a[900:1000], a[[5, 6, 7]], a[-2:] = np.nan, np.nan, np.nan
    x = integrate(t, a, 2)
    assert np.isnan(x[900:1000]).all()
    assert np.isnan(x[-2:]).all()
    assert np.isfinite(x[:900]).all()
    assert _rms(x - np.sin(W * t)) < 0.15


def test_wrong_calls_teach():
    t = np.linspace(0.0, 1.0, 50)
    with pytest.raises(InputError, match="order 3"):
        integrate(t, t, 3)
    with pytest.raises(InputError, match="unknown drift 'mean'"):
        integrate(t, t, drift="mean")
    with pytest.raises(InputError, match="cutoff"):
        integrate(t, t, drift="highpass")
    with pytest.raises(InputError, match="fewer than 4"):
        integrate(t[:3], t[:3])
