"""Noise, quantisation and the checks of a recording, with rates over seeded draws."""

from collections import Counter

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.recordings import (
    Block,
    Recording,
    blocks,
    check_recording,
    folds,
    noise_level,
    quantisation_step,
)


def _motion(rng: np.random.Generator, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A random sum of three sines and its exact rate."""
    w, a, p = rng.uniform(0.2, 6.0, 3), rng.uniform(0.1, 3.0, 3), rng.uniform(0.0, 6.0, 3)
    phase = np.outer(t, w) + p
    return (a * np.sin(phase)).sum(1), (a * w * np.cos(phase)).sum(1)


def _time(rng: np.random.Generator, samples: int, uniform: bool = True) -> np.ndarray:
    if uniform:
        return np.linspace(0.0, 10.0, samples)
    return np.sort(rng.uniform(0.0, 10.0, samples))


@pytest.mark.parametrize("uniform", [True, False])
@pytest.mark.parametrize("sigma", [1e-4, 1e-2, 0.5])
def test_noise_level_is_right_within_15_percent(uniform, sigma):
    for seed in range(30):
        rng = np.random.default_rng(seed)
        t = _time(rng, 1500, uniform)
        y = _motion(rng, t)[0] + sigma * rng.normal(size=t.size)
        y[rng.random(t.size) < 0.05] = np.nan
        assert noise_level(t, y) == pytest.approx(sigma, rel=0.15)


def test_noise_level_is_small_on_clean_signals_kinks_and_constants():
    t = np.linspace(0.0, 10.0, 1000)
    for seed in range(30):
        q, _ = _motion(np.random.default_rng(seed), t)
        assert noise_level(t, q) < 1e-9 * np.ptp(q)
    assert noise_level(t, np.abs(np.sin(3.0 * t))) < 1e-9
    assert noise_level(t, np.full(1000, 3.0)) == 0.0


def test_noise_level_is_not_below_that_of_the_quantisation():
    t = np.linspace(0.0, 10.0, 4000)
    y = np.round(np.sin(0.3 * t) / 0.02) * 0.02  # hundreds of equal samples on every level
    assert noise_level(t, y) == pytest.approx(0.02 / np.sqrt(12.0), rel=1e-6)


@pytest.mark.parametrize("step", [1e-6, 0.01, 0.0123, 2.0 * np.pi / 4096, 3.0])
def test_quantisation_step_is_found(step):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        size = int(rng.integers(200, 3000))
        y = np.round(100.0 * step * rng.normal(size=size) / step) * step + rng.normal()
        y[:2] += 0.3 * step  # two values off the grid
        assert quantisation_step(y) == pytest.approx(step, rel=1e-3)


def test_no_quantisation_step_in_continuous_values():
    for seed in range(100):
        rng = np.random.default_rng(seed)
        y = rng.normal(size=int(rng.integers(8, 2000)))
        assert quantisation_step(y) is None
    assert quantisation_step(np.array([0.0, 1.0, 0.0, 1.0] * 50)) is None


def _found(recording: Recording, **options) -> set[tuple[str, str]]:
    return {(item.channel, item.check) for item in check_recording(recording, **options)}


def test_clean_smooth_signals_raise_no_alarm():
    """At most 2 of 100 draws: a draw may by chance be sampled coarsely for its motion."""
    alarms = Counter()
    for seed in range(100):
        rng = np.random.default_rng(seed)
        t = np.linspace(0.0, rng.uniform(3.0, 20.0), int(rng.integers(300, 2000)))
        q, v = _motion(rng, t)
        found = _found(Recording("x", t, {"q": q, "v": v, "decay": np.exp(-t)}))
        alarms.update({check for _, check in found})
    assert all(count <= 2 for count in alarms.values()), alarms


def test_noisy_quantised_signals_raise_no_false_alarm():
    """Noise and steps are there and said; clipping, outliers, lags and gaps are not."""
    alarms = Counter()
    for seed in range(100):
        rng = np.random.default_rng(seed)
        t = _time(rng, int(rng.integers(300, 2000)))
        q, v = _motion(rng, t)
        v = v + 0.02 * rng.normal(size=t.size)
        found = _found(Recording("x", t, {"q": np.round(q / 0.01) * 0.01, "v": v}))
        assert ("q", "quantisation") in found
        assert ("v", "noise") in found
        alarms.update({check for _, check in found} - {"quantisation", "noise"})
    assert all(count <= 2 for count in alarms.values()), alarms


def test_clipping_and_outliers_are_found():
    hits = Counter()
    for seed in range(50):
        rng = np.random.default_rng(seed)
        t = _time(rng, 2000)
        q, _ = _motion(rng, t)
        noisy = q + 1e-3 * rng.normal(size=t.size)
        clipped = np.minimum(noisy, 0.6 * q.max())
        spiked = noisy.copy()
        spiked[[500, 900]] += np.ptp(q)
        recording = Recording("x", t, {"clipped": clipped, "spiked": spiked})
        found = _found(recording)
        hits.update(found)
        assert ("spiked", "clipping") not in found
        assert not {check for _, check in _found(recording, inputs=["clipped", "spiked"])} & {
            "clipping",
            "outliers",
        }
    assert hits["clipped", "clipping"] >= 45
    assert hits["spiked", "outliers"] == 50


@pytest.mark.parametrize("samples_late", [-3.0, 0.4, 1.5])
def test_lag_between_position_and_rate_is_measured(samples_late):
    hits = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        t = _time(rng, 2000)
        late = samples_late * (t[1] - t[0])
        state = rng.bit_generator.state
        q, _ = _motion(rng, t)
        rng.bit_generator.state = state
        _, v = _motion(rng, t - late)
        channels = {"q": q + 1e-4 * rng.normal(size=t.size), "v": v + 1e-3 * rng.normal(size=2000)}
        lags = [c for c in check_recording(Recording("x", t, channels)) if c.check == "lag"]
        assert len(lags) <= 1
        for lag in lags:
            hits += 1
            assert lag.channel == "v"
            assert lag.value == pytest.approx(late, rel=0.1, abs=0.05 * (t[1] - t[0]))
    assert hits >= 27


def test_time_and_missing_samples_are_reported():
    rng = np.random.default_rng(0)
    t = np.arange(500) * 0.01
    y = np.sin(t)
    uneven = Recording("x", t + 0.002 * rng.uniform(size=500), {"y": y})
    assert _found(uneven) >= {("time", "non_uniform_time")}
    assert ("time", "gap") not in _found(uneven)
    kept = np.r_[0:200, 230:500]
    gap = [c for c in check_recording(Recording("x", t[kept], {"y": y[kept]})) if c.check == "gap"]
    assert gap[0].value == pytest.approx(0.31)
    y[100:110] = np.nan
    missing = check_recording(Recording("x", t, {"y": y, "c": np.ones(500)}))
    assert {(c.channel, c.check, c.value) for c in missing} == {
        ("y", "missing_samples", 0.02),
        ("c", "constant", 1.0),
    }


def _recordings(*sizes: int) -> list[Recording]:
    return [Recording(f"{n}", np.arange(n), {"a": np.zeros(n)}) for n in sizes]


def test_blocks_cover_every_sample_once():
    rng = np.random.default_rng(0)
    for _ in range(50):
        recordings = _recordings(*rng.integers(3, 200, int(rng.integers(1, 5))))
        least = int(rng.integers(3, 30))
        cut = blocks(recordings, int(rng.integers(1, 9)), least)
        for number, recording in enumerate(recordings):
            own = [b for b in cut if b.recording == number]
            samples = np.concatenate([np.arange(b.start, b.stop) for b in own])
            np.testing.assert_array_equal(samples, np.arange(len(recording)))
            assert len(own) == 1 or min(len(b) for b in own) >= least
            assert len(own[0].of(recordings)) == len(own[0])


def test_folds_hold_back_every_block_once():
    one = blocks(_recordings(100), 6, 3)
    for train, validation in folds(one, 3):
        assert not set(train) & set(validation)
        assert set(train) | set(validation) == set(one)
    held = [block for _, validation in folds(one, 3) for block in validation]
    assert sorted(held) == one
    assert folds(one, 3)[0][1] == [Block(0, 0, 17), Block(0, 50, 67)]
    several = blocks(_recordings(50, 60, 70), 4, 3)
    for _, validation in folds(several, 3):
        assert len({block.recording for block in validation}) == 1
        assert len(validation) == 4
    with pytest.raises(InputError):
        folds(one[:2], 3)


def test_values_beyond_any_sensor_are_named_and_overflow_nothing():
    t = np.arange(40.0)
    values = np.where(t == 7.0, -1.7e308, np.where(t == 9.0, 1.7e308, np.sin(t)))
    (check,) = check_recording(Recording("a", t, {"q": values}))
    assert check.channel == "q" and "no sensor" in check.message
