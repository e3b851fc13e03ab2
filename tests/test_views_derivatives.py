"""Derivatives: convergence orders, exactness on polynomials, noise, kinks and missing samples."""

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.views import (
    DERIVATIVES,
    choose_fit,
    choose_method,
    derivative,
    finite_difference,
    savitzky_golay,
    smooth_states,
    total_variation,
)

W = 3.0


def _grid(samples: int, uneven: bool, seed: int = 0) -> np.ndarray:
    """Time from 0 to 2; the uneven grid is a smooth map plus jitter, so that refining it works."""
    s = np.linspace(0.0, 1.0, samples)
    if not uneven:
        return 2.0 * s
    jitter = np.random.default_rng(seed).uniform(-0.3, 0.3, samples) / samples
    return 2.0 * np.sort(s + 0.1 * np.sin(np.pi * s) + jitter)


def _truth(t: np.ndarray, order: int) -> np.ndarray:
    return [np.sin(W * t), W * np.cos(W * t), -(W**2) * np.sin(W * t)][order]


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(x**2)))


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("accuracy", [2, 4, 6])
def test_finite_differences_have_their_order_up_to_the_ends(accuracy, order, uneven):
    errors = []
    sizes = (40, 80)
    for samples in sizes:
        worst = []
        for seed in range(5):
            t = _grid(samples, uneven, seed)
            estimate = finite_difference(t, _truth(t, 0), order, accuracy)
            worst.append(np.max(np.abs(estimate - _truth(t, order))))
        errors.append(np.median(worst))
    slope = np.log2(errors[0] / errors[1])
    # one-sided stencils at the ends lead the error constant; jitter blurs the slope
    assert slope > accuracy - (0.9 if uneven else 0.4)


@pytest.mark.parametrize("method", [finite_difference, savitzky_golay])
@pytest.mark.parametrize("order", [1, 2])
def test_polynomials_are_exact_on_any_grid(method, order):
    options = {"accuracy": 4} if method is finite_difference else {"window": 9, "degree": 4}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        t = np.cumsum(rng.uniform(0.05, 0.15, 60)) - 3.0
        c = np.polynomial.Polynomial(rng.normal(size=5))
        expected = c.deriv(order)(t)
        estimate = method(t, c(t), derivative=order, **options)
        np.testing.assert_allclose(estimate, expected, atol=1e-8 * np.max(np.abs(expected)))


@pytest.mark.parametrize(("degree", "slope"), [(2, 2.0), (4, 4.0)])
def test_savitzky_golay_has_its_order_inside(degree, slope):
    errors = []
    for samples in (100, 200):
        t = _grid(samples, uneven=False)
        estimate = savitzky_golay(t, _truth(t, 0), 1, window=9, degree=degree)
        errors.append(np.max(np.abs(estimate - _truth(t, 1))[10:-10]))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(slope, abs=0.3)


def test_savitzky_golay_on_uniform_and_nearly_uniform_grids_agree():
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 5.0, 400)
    y = np.sin(t) + 0.01 * rng.normal(size=t.size)
    for order in (0, 1, 2):
        fast = savitzky_golay(t, y, order, window=31, degree=4)
        moved = t + 2e-5 * rng.uniform(-1.0, 1.0, t.size)  # just outside what counts as uniform
        slow = savitzky_golay(moved, y, order, window=31, degree=4)
        np.testing.assert_allclose(fast, slow, rtol=1e-3, atol=2e-3 * np.max(np.abs(fast)))


@pytest.mark.long
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("sigma", [1e-4, 1e-2, 0.1])
@pytest.mark.parametrize("uneven", [False, True])
def test_the_chosen_window_is_near_the_best(order, sigma, uneven):
    """The error is at most 1.6 times the least that any window and degree could have reached."""
    ratios = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        t = 5.0 * _grid(400, uneven, seed)
        y = _truth(t, 0) + sigma * rng.normal(size=t.size)
        inside = slice(40, -40)
        chosen = _rms((savitzky_golay(t, y, order) - _truth(t, order))[inside])
        tried = [
            _rms((savitzky_golay(t, y, order, window, degree) - _truth(t, order))[inside])
            for degree in (2, 4, 6)
            for window in range(9, 130, 10)
        ]
        ratios.append(chosen / min(tried))
    assert np.median(ratios) < 1.6
    assert max(ratios) < 2.5


def test_the_expected_error_is_near_the_true_one():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        t = np.linspace(0.0, 10.0, 1500)
        y = _truth(t, 0) + 0.01 * rng.normal(size=t.size)
        fit = choose_fit(t, y, 1)
        true = _rms((savitzky_golay(t, y, 1, fit.window, fit.degree) - _truth(t, 1))[100:-100])
        assert 0.6 * true < fit.error < 2.0 * true


def test_total_variation_keeps_a_kink_that_savitzky_golay_rounds():
    t = np.linspace(-1.0, 1.0, 1000)
    truth = np.sign(t - 0.2)
    sharp, rounded = [], []
    for seed in range(12):
        y = np.abs(t - 0.2) + 0.01 * np.random.default_rng(seed).normal(size=t.size)
        sharp.append(_rms(total_variation(t, y) - truth))
        rounded.append(_rms(savitzky_golay(t, y) - truth))
    assert np.mean(sharp) < 0.6 * np.mean(rounded)
    assert np.median(np.array(sharp) / np.array(rounded)) < 0.6


def test_total_variation_meets_the_discrepancy_principle_and_scales():
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 4.0, 800)
    y = np.abs(np.sin(2.0 * t)) + 0.02 * rng.normal(size=t.size)
    u = total_variation(t, y, noise=0.02)
    x = np.concatenate([[0.0], np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(t))])
    assert _rms(y - x - np.mean(y - x)) == pytest.approx(0.0206, rel=0.02)
    np.testing.assert_allclose(total_variation(t, 5.0 * y, noise=0.1), 5.0 * u, atol=0.05)
    np.testing.assert_allclose(total_variation(t / 3.0, y, noise=0.02), 3.0 * u, atol=0.05)


def test_total_variation_of_a_line_and_a_parabola():
    t = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 300)) * 0.01
    np.testing.assert_allclose(total_variation(t, 3.0 * t - 1.0, strength=0.1), 3.0, atol=1e-5)
    estimate = total_variation(t, 2.5 * t**2, derivative=2, strength=1e-3)
    np.testing.assert_allclose(estimate, 5.0, atol=1e-3)


def test_total_variation_on_a_long_record_is_quick_and_finite():
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0.0, 10.0, 5000))
    y = np.sin(3.0 * t) + 0.05 * rng.normal(size=t.size)
    for order in (1, 2):
        assert np.isfinite(total_variation(t, y, order)).all()
    assert _rms(total_variation(t, y) - 3.0 * np.cos(3.0 * t)) < 0.4


@pytest.mark.parametrize("method", sorted(DERIVATIVES))
def test_missing_samples_are_left_out(method):
    t = np.linspace(0.0, 2.0, 300)
    y = _truth(t, 0) + 1e-3 * np.random.default_rng(0).normal(size=t.size)
    y[[3, 50, 51, 200]] = np.nan
    estimate = derivative(t, y, method)
    present = np.isfinite(y)
    assert np.isfinite(estimate[present]).all()
    assert np.isnan(estimate[~present]).all() == (method == "finite_difference")
    limit = {"finite_difference": 0.6, "total_variation": 0.4}.get(method, 0.05)
    assert _rms(estimate - _truth(t, 1)) < limit


def test_long_gaps_are_not_filled():
    t = np.linspace(0.0, 2.0, 300)
    y = _truth(t, 0)
    y[100:200] = np.nan
    assert np.isnan(savitzky_golay(t, y, 1, window=11, degree=4)[110:190]).all()


def test_auto_takes_differences_when_clean_and_fits_when_noisy():
    t = np.linspace(0.0, 10.0, 1000)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        clean, noise = np.sin(rng.uniform(0.5, 3.0) * t), rng.normal(size=t.size)
        assert choose_method(t, clean) == "finite_difference"
        assert choose_method(t, clean + 1e-3 * noise) == "savitzky_golay"
    y = np.stack([_truth(t, 0), _truth(t, 0) + 0.01 * noise], axis=1)
    estimate = derivative(t, y)
    assert _rms(estimate[:, 0] - _truth(t, 1)) < 1e-7
    assert _rms(estimate[:, 1] - _truth(t, 1)) < 0.03


def test_states_of_a_chirp_read_by_a_coarse_encoder():
    t = np.linspace(0.0, 10.0, 5000)
    phase, w, rate = 0.5 * t + 0.15 * t**2, 0.5 + 0.3 * t, 0.3
    q, v = np.sin(phase), w * np.cos(phase)
    a = rate * np.cos(phase) - w**2 * np.sin(phase)
    step = 2.0 * np.pi / 4096
    q_hat, v_hat, a_hat = smooth_states(t, np.round(q / step) * step)
    inside = slice(50, -50)
    assert _rms((q_hat - q)[inside]) < 0.5 * step / np.sqrt(12.0)
    assert _rms((v_hat - v)[inside]) < 0.005 * _rms(v)
    assert _rms((a_hat - a)[inside]) < 0.03 * _rms(a)


def test_wrong_calls_teach():
    t = np.linspace(0.0, 1.0, 50)
    with pytest.raises(
        InputError, match=r"`window` must be odd and greater than `degree`=3, got 4"
    ):
        savitzky_golay(t, t, 1, window=4, degree=3)
    with pytest.raises(InputError, match="51 is longer"):
        savitzky_golay(t, t, 1, window=51, degree=3)
    with pytest.raises(InputError, match="accuracy 3"):
        finite_difference(t, t, accuracy=3)
    with pytest.raises(InputError, match="unknown derivative 'spline'"):
        derivative(t, t, "spline")
    with pytest.raises(InputError, match="strength"):
        total_variation(t, t, strength=-1.0)


@pytest.mark.long
@pytest.mark.parametrize("method", ["auto", *sorted(DERIVATIVES)])
def test_short_constant_gappy_and_tiny_signals_give_numbers_or_one_clear_line(method):
    # the adaptive spline is the slow one
    for seed in range(24 if method == "adaptive_spline" else 96):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(3, 40))
        t = np.cumsum(rng.uniform(0.1, 1.0, n)) if seed % 2 else 0.1 * np.arange(n)
        y = [rng.normal(size=n), np.sin(t), np.ones(n), np.round(rng.normal(size=n))][seed % 4]
        y = y * 10.0 ** rng.integers(-60, 60)
        y[rng.random(n) < 0.3 * (seed % 3 == 0)] = np.nan
        try:
            estimate = derivative(t, y, method, 1 + seed % 2)
        except InputError as error:
            assert np.isfinite(y).sum() < 7, error
            continue
        assert np.isfinite(estimate[np.isfinite(y)]).all()
