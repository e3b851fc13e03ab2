"""Angles that wrap, and files whose times are in different units."""

import numpy as np
import pytest

from jaxsr._result import InputError
from jaxsr.recordings import Recording, check_recording, check_time_units, unwrap, wrapping

TURN = {"0 to 360": (360.0, 0.0), "-180 to 180": (360.0, -180.0)} | {
    "0 to 2 pi": (2.0 * np.pi, 0.0),
    "-pi to pi": (2.0 * np.pi, -np.pi),
}


def _angle(rng: np.random.Generator, t: np.ndarray, period: float) -> np.ndarray:
    """A motion of a few turns whose steps stay below a fifth of a turn."""
    w, p = rng.uniform(0.1, 0.8, 3), rng.uniform(0.0, 6.0, 3)
    return period * (np.sin(np.outer(t, w) + p) @ rng.uniform(0.5, 2.0, 3) + 0.3 * t)


def _folded(q: np.ndarray, period: float, low: float) -> np.ndarray:
    return (q - low) % period + low


@pytest.mark.parametrize("turn", TURN)
def test_a_wrapped_angle_is_counted_on(turn):
    period, low = TURN[turn]
    for seed in range(20):
        rng = np.random.default_rng(seed)
        t = np.cumsum(rng.uniform(0.018, 0.022, 800))
        q = _angle(rng, t, period)
        y = np.round(_folded(q, period, low), 4)
        y[rng.random(t.size) < 0.02] = np.nan
        if np.nanmax(np.abs(np.diff(y))) < 0.5 * period:
            continue
        recording = unwrap(Recording("a", t, {"q": y, "v": np.sin(t)}))
        counted = recording.channel("q")
        known = np.isfinite(y)
        shift = np.round((q - counted)[known][0] / period) * period
        np.testing.assert_allclose(counted[known] + shift, q[known], atol=1e-3 * period)
        (check,) = [c for c in check_recording(recording) if c.check == "wrap"]
        assert check.channel == "q" and "counted on" in check.message


def test_an_angle_that_swings_about_its_end_is_counted_on():
    t = np.arange(500) * 0.01
    q = 8.0 * np.sin(3.0 * t + 0.1)
    recording = unwrap(Recording("a", t, {"q": np.round(q % 360.0, 2)}))
    np.testing.assert_allclose(recording.channel("q") - q, 0.0, atol=0.006)


def test_turns_over_a_gap_are_told_by_the_speed_and_said_where_that_is_a_guess():
    t = np.arange(1000) * 0.005
    t[500:] += 1.3
    for slower, guess in ((1.0, False), (0.7, True)):
        rate = 700.0 * np.where(t < t[500], 1.0, slower)
        q = np.concatenate([[0.0], np.cumsum(rate[1:] * np.diff(t))])
        recording = unwrap(Recording("a", t, {"q": np.round(q % 360.0, 2)}))
        (check,) = recording.remarks
        assert ("guess" in check.message) == guess
        if not guess:
            np.testing.assert_allclose(recording.channel("q"), q, atol=0.006)


def test_what_only_looks_like_a_wrap_is_left():
    rng = np.random.default_rng(0)
    t = np.arange(600) * 0.01
    square = np.where(np.sin(3.0 * t) > 0.0, 360.0, 0.0)
    cases = {
        "command": square,
        "levels": np.repeat(rng.choice([0.0, 90.0, 270.0, 360.0], 60), 10),
        "noise": rng.uniform(0.0, 360.0, t.size),
        "phase": np.where(np.sin(3.0 * t) > 0.0, np.pi, -np.pi),
        "beyond": np.abs(400.0 * np.sin(t)),
        "sine": 180.0 + 170.0 * np.sin(3.0 * t),
        "drops": np.where(rng.random(t.size) < 0.02, 0.0, 355.0 + np.sin(t)),
    }
    recording = unwrap(Recording("a", t, cases))
    for name, y in cases.items():
        np.testing.assert_array_equal(recording.channel(name), y, err_msg=name)
    assert not recording.remarks


def test_only_the_channels_asked_for_are_counted_on():
    t = np.arange(600) * 0.01
    y = (300.0 * t) % 360.0
    recording = unwrap(Recording("a", t, {"q": y, "r": y}), ["r"])
    np.testing.assert_array_equal(recording.channel("q"), y)
    np.testing.assert_allclose(recording.channel("r"), 300.0 * t, atol=1e-9)


def _clock(name: str, step: float, samples: int, stated: bool = False) -> Recording:
    t = step * np.arange(samples)
    return Recording(name, t, {"q": np.sin(t)}, time_stated=stated)


@pytest.mark.parametrize("factor", [1e3, 950.0, 1e6])
def test_seconds_beside_milliseconds_are_refused_with_both_names(factor):
    files = [
        _clock("a.csv", 0.01, 500),
        _clock("c.csv", 0.02, 100),
        _clock("b.csv", 0.01 * factor, 400),
    ]
    with pytest.raises(InputError, match=r"b\.csv.*a\.csv.*thousandfold|millionfold"):
        check_time_units(files)


def test_different_rates_and_stated_units_are_not_refused():
    check_time_units([_clock("a", 0.01, 500), _clock("b", 0.5, 500)])
    check_time_units([_clock("a", 0.001, 20000), _clock("b", 1.0, 20)])
    check_time_units([_clock("a", 0.001, 500, True), _clock("b", 1.0, 500, True)])
    check_time_units([_clock("a", 0.001, 500)])


@pytest.mark.parametrize("seed", range(40))
def test_a_column_is_passed_over_only_where_no_turn_would_be_found(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng([73, seed])
    time = np.arange(300) * 0.01
    turn = rng.choice([360.0, 2.0 * np.pi])
    angle = np.cumsum(rng.normal(0.0, 0.04 * turn, 300)) + rng.uniform(-1.0, 1.0) * turn
    folded = np.mod(angle + rng.choice([0.0, 0.5 * turn]), turn) - rng.choice([0.0, 0.5 * turn])
    folded *= rng.choice([1.0, 1.0, 0.6, 1.5])
    folded[rng.random(300) < rng.choice([0.0, 0.1])] = np.nan
    record = Recording("a.csv", time, {"angle": folded})
    found = unwrap(record)
    monkeypatch.setattr(wrapping, "_may_turn", lambda values: True)
    wanted = unwrap(record)
    np.testing.assert_array_equal(found.channels["angle"], wanted.channels["angle"])
    assert found.remarks == wanted.remarks
