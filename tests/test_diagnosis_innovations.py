"""Innovations of noise that is correlated over more than its neighbours."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
import scipy.stats
from test_diagnosis_coloured import SAMPLES, SEGMENTS, fitted, noise, waves

from jaxsr.diagnosis.judging.coloured import likelihood_ratio
from jaxsr.diagnosis.judging.innovations import Autoregression, _in_a_row


def filtered(rng: np.random.Generator, slow: float, sensor: float) -> np.ndarray:
    """First-order noise through a sensor's first-order filter, (samples, segments)."""
    white = rng.normal(size=(3000 + SAMPLES, SEGMENTS))
    ripple = scipy.signal.lfilter([1.0], [1.0, -slow], white, axis=0)
    return np.asarray(scipy.signal.lfilter([1.0], [1.0, -sensor], ripple, axis=0))[3000:]


def test_innovations_of_a_filtered_process_are_white() -> None:
    y = filtered(np.random.default_rng(0), 0.97, 0.9)
    seen = np.ones(y.shape, bool)
    process = Autoregression.of(y, seen)
    assert process.order == 2
    # the product of (1 - 0.97 L)(1 - 0.9 L)
    assert process.predictors[2] == pytest.approx([1.87, -0.873], abs=0.05)
    e = process.innovations(y, seen)
    assert np.std(e[2:]) == pytest.approx(1.0, rel=0.05)
    for lag in (1, 2, 3):
        assert abs(np.mean(e[lag:] * e[:-lag])) < 4.0 / np.sqrt(y.size)


def test_white_noise_has_no_memory_and_lost_samples_none_either() -> None:
    y = np.random.default_rng(1).normal(size=(SAMPLES, SEGMENTS))
    seen = np.random.default_rng(2).random(y.shape) < 0.9
    process = Autoregression.of(y, seen)
    assert process.order == 0
    assert np.array_equal(process.innovations(y, seen), np.where(seen, y, 0.0))


def test_a_gap_begins_the_memory_anew() -> None:
    y = noise(np.random.default_rng(3), 0.8)
    seen = np.ones(y.shape, bool)
    seen[100:120] = False
    process = Autoregression.of(y, seen)
    e = process.innovations(y, seen)
    assert process.order == 1
    weight = np.sqrt(process.variances[1] / process.variances[0])
    assert e[120] == pytest.approx(weight * y[120])
    assert e[121] == pytest.approx(y[121] - process.predictors[1][0] * y[120])


@pytest.mark.parametrize(("slow", "sensor"), [(0.95, 0.8), (0.995, 0.98)])
def test_noise_of_a_filtered_sensor_is_no_slow_force(slow: float, sensor: float) -> None:
    """Two constants too many pass the 99.9th percentile in a few of 40 draws, not in most."""
    rng, above = np.random.default_rng(1), 0
    known, more = waves(0.011)[:1], waves(0.03)
    both = np.concatenate([known, more])
    for _ in range(40):
        y = np.stack([filtered(rng, slow, sensor), rng.normal(size=(SAMPLES, SEGMENTS))])
        statistic = likelihood_ratio(fitted(y, known), fitted(y, both))
        above += statistic > scipy.stats.chi2.ppf(0.999, 2)
    assert above <= 2


@pytest.mark.parametrize("most", [0, 1, 8])
@pytest.mark.parametrize("size", [1, 5, 60])
def test_samples_in_a_row_are_counted_up_to_a_number(size: int, most: int) -> None:
    seen = np.random.default_rng(size).random((size, 4)) < [1.0, 0.9, 0.5, 0.0]
    expected = np.zeros(seen.shape, dtype=int)
    for k, s in np.ndindex(seen.shape):
        before = seen[:k, s][::-1]
        expected[k, s] = min(before.size if before.all() else int(np.argmin(before)), most)
    np.testing.assert_array_equal(_in_a_row(seen, most), expected)
