"""Likelihood ratios in coloured noise: their rate of false alarms, and what they still see."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from jaxsr.diagnosis.judging.coloured import likelihood_ratio
from jaxsr.models.least_squares import Fit

SAMPLES, SEGMENTS = 400, 3
RHO = 0.8
TIME = np.arange(SAMPLES)


def noise(rng: np.random.Generator, rho: float) -> np.ndarray:
    """Coloured noise of variance one, (samples, segments)."""
    white = rng.normal(size=(1000 + SAMPLES, SEGMENTS)) * np.sqrt(1.0 - rho**2)
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -rho], white, axis=0))[1000:]


def fitted(y: np.ndarray, columns: np.ndarray) -> Fit:
    """Least squares over columns (constants, outputs, samples, segments), and their residual."""
    flat = columns.reshape(len(columns), -1).T
    theta = np.linalg.lstsq(flat, y.ravel(), rcond=None)[0]
    residual = y - np.tensordot(theta, columns, 1)
    none = np.zeros((1, *y.shape))
    cost = float(np.sum(residual**2))
    active = np.arange(len(columns))
    return Fit(theta, np.zeros((1, SEGMENTS)), cost, residual, active, columns, none, True)


def waves(frequency: float) -> np.ndarray:
    """A sine and a cosine in the first of two outputs."""
    columns = np.zeros((2, 2, SAMPLES, SEGMENTS))
    columns[:, 0] = np.array([np.sin(frequency * TIME), np.cos(frequency * TIME)])[..., None]
    return columns


@pytest.mark.long
@pytest.mark.parametrize("frequency", [0.03, 0.3, 2.0])
def test_the_ratio_is_chi_squared_at_any_frequency(frequency: float) -> None:
    """Two constants too many: 10 % of the draws above the 90th percentile, of 300, +-4 sigma."""
    rng, above = np.random.default_rng(1), 0
    known = waves(0.011)[:1]
    both = np.concatenate([known, waves(frequency)])
    for _ in range(300):
        y = np.stack([noise(rng, RHO), noise(rng, 0.2)])
        statistic = likelihood_ratio(fitted(y, known), fitted(y, both))
        above += statistic > scipy.stats.chi2.ppf(0.9, 2)
    assert abs(above - 30) < 4.0 * np.sqrt(300 * 0.1 * 0.9)


def test_least_squares_takes_slow_noise_for_a_slow_force() -> None:
    """The same without innovations: the threshold is exceeded several times as often."""
    rng, above = np.random.default_rng(1), 0
    known = waves(0.011)[:1]
    both = np.concatenate([known, waves(0.03)])
    for _ in range(300):
        y = np.stack([noise(rng, RHO), noise(rng, 0.2)])
        ratio = fitted(y, known).cost / fitted(y, both).cost
        above += y.size * np.log(ratio) > scipy.stats.chi2.ppf(0.9, 2)
    assert above > 120


@pytest.mark.parametrize(("frequency", "amplitude"), [(0.03, 1.0), (2.0, 0.2)])
def test_a_force_is_seen_as_far_as_it_stands_above_the_noise(
    frequency: float, amplitude: float
) -> None:
    """n A^2/2 over the noise's spectrum (1 - rho^2)/(1 - 2 rho cos w + rho^2), +-40 %."""
    rng = np.random.default_rng(2)
    y = np.stack([noise(rng, RHO), noise(rng, 0.2)])
    y[0] += amplitude * np.sin(frequency * TIME)[:, None]
    known = waves(0.11)[:1]
    both = np.concatenate([known, waves(frequency)])
    spectrum = (1.0 - RHO**2) / (1.0 - 2.0 * RHO * np.cos(frequency) + RHO**2)
    expected = SAMPLES * SEGMENTS * amplitude**2 / 2.0 / spectrum
    assert likelihood_ratio(fitted(y, known), fitted(y, both)) == pytest.approx(expected, rel=0.4)


def test_what_is_not_measured_does_not_count() -> None:
    rng = np.random.default_rng(3)
    y = np.stack([noise(rng, RHO), noise(rng, 0.2)])
    known, more = waves(0.011)[:1], waves(0.3)
    both = np.concatenate([known, more])
    seen = np.ones(y.shape, bool)
    seen[:, 300:] = False
    gaps = [fitted(np.where(seen, y, 0.0), c * seen) for c in (known, both)]
    short = [fitted(y[:, :300], c[:, :, :300]) for c in (known, both)]
    assert likelihood_ratio(*gaps) == pytest.approx(likelihood_ratio(*short), rel=1e-6)


def test_a_sensor_without_any_error_changes_nothing() -> None:
    rng = np.random.default_rng(5)
    known, both = waves(0.011)[:1], np.concatenate([waves(0.011)[:1], waves(0.3)])
    y = np.stack([noise(rng, RHO), np.zeros((SAMPLES, SEGMENTS))])
    alone = [fitted(y[:1], columns[:, :1]) for columns in (known, both)]
    beside = [fitted(y, columns) for columns in (known, both)]
    assert np.all(beside[1].residual[1] == 0.0)
    assert likelihood_ratio(*beside) == pytest.approx(likelihood_ratio(*alone), rel=1e-6)


def test_where_nothing_was_followed_nothing_is_told_apart() -> None:
    """Time may end before any reading was followed: every residual is then absent."""
    none = np.zeros((2, SAMPLES, SEGMENTS))
    assert likelihood_ratio(fitted(none, waves(0.3)), fitted(none, waves(0.3))) == 0.0
