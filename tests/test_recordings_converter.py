"""Steps of a converter as noise, against ramps and waves of known motion."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.recordings.converter import (
    effective_samples,
    step_correlation,
    step_variance,
    uniform_variance,
)


def read(motion: np.ndarray, step: float) -> np.ndarray:
    return step * np.round(motion / step)


@pytest.mark.parametrize("step", [1e-3, 0.2, 7.0])
def test_the_error_of_a_quantised_ramp_has_the_variance_of_a_uniform_one(step: float) -> None:
    """1000 samples a step, midway between: q^2/12 (1 - 1e-6), the mean of a sum of squares."""
    ramp = step * (np.arange(40_000) + 0.5) / 1000.0
    error = read(ramp, step) - ramp
    assert np.mean(error**2) == pytest.approx(uniform_variance(step), rel=1e-5)
    assert np.abs(error).max() <= 0.5 * step


@pytest.mark.parametrize("lag", [1, 7, 25, 50, 80, 99, 100, 130])
def test_errors_of_a_slow_ramp_are_correlated_as_a_sawtooth(lag: int) -> None:
    """A hundredth of a step a sample; the closed form by how far apart two readings lie."""
    step = 0.3
    ramp = step * (np.arange(100_000) + 0.5) / 100.0
    error = read(ramp, step) - ramp
    found = np.mean(error[lag:] * error[:-lag]) / np.mean(error**2)
    assert found == pytest.approx(float(step_correlation(0.01 * lag * step, step)), abs=2e-3)


def test_the_correlation_is_that_of_one_reading_and_none_on_average() -> None:
    step = 2.0
    assert step_correlation(0.0, step) == 1.0
    assert step_correlation(step / 2.0, step) == pytest.approx(-0.5)
    assert step_correlation(5.0 * step, step) == pytest.approx(1.0)
    inside = step * (np.arange(1000) + 0.5) / 1000.0
    assert np.mean(step_correlation(inside, step)) == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("noise", [0.05, 0.2, 0.5])
def test_noise_ahead_of_the_converter_whitens_its_steps(noise: float) -> None:
    rng, step, lag = np.random.default_rng(0), 1.0, 10
    ramp = step * (np.arange(400_000) + 0.5) / 100.0
    error = read(ramp + noise * rng.normal(size=ramp.size), step) - ramp
    covariance = np.mean(error[lag:] * error[:-lag])
    expected = uniform_variance(step) * step_correlation(lag * 0.01, step, noise)
    assert covariance == pytest.approx(float(expected), abs=5e-4)
    assert abs(step_correlation(lag * 0.01, step, 0.5)) < 0.01


def test_without_noise_the_series_is_the_closed_form() -> None:
    apart = np.linspace(0.05, 0.95, 19)
    series = step_correlation(apart, 1.0, noise=1e-9, terms=4000)
    np.testing.assert_allclose(series, step_correlation(apart, 1.0), atol=1e-3)


@pytest.mark.parametrize("held", [1, 3, 20])
def test_readings_of_one_step_tell_as_much_as_one(held: int) -> None:
    levels = 50
    ramp = (np.arange(levels * held) // held) * 0.1
    assert effective_samples(ramp, 0.1) == levels
    variance = step_variance(ramp, 0.1)
    np.testing.assert_allclose(variance, held * uniform_variance(0.1))
    assert np.sum(uniform_variance(0.1) / variance) == pytest.approx(levels)


def test_motion_or_noise_of_a_step_makes_every_reading_its_own() -> None:
    rng = np.random.default_rng(1)
    fast = read(3.7 * np.arange(500), 1.0)
    assert effective_samples(fast, 1.0) == 500
    noisy = read(2.0 * rng.normal(size=5000), 1.0)
    assert effective_samples(noisy, 1.0) > 0.8 * 5000


def test_missing_readings_tell_nothing() -> None:
    samples = np.array([np.nan, 1.0, 1.0, np.nan, 1.0, 2.0, np.nan])
    assert effective_samples(samples, 1.0) == 2
    variance = step_variance(samples, 1.0)
    assert (np.isnan(variance) == np.isnan(samples)).all()
    np.testing.assert_allclose(variance[[1, 2, 4, 5]] * 12.0, [3.0, 3.0, 3.0, 1.0])
    assert effective_samples(np.full(3, np.nan), 1.0) == 0
    assert np.isnan(step_variance(np.full(3, np.nan), 1.0)).all()
