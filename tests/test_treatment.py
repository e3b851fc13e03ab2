"""Treatment of samples: derivatives and their errors, options, motions from accelerations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import jaxsr
from jaxsr._result import InputError
from jaxsr.discovery.samples import Samples, hold_back, roles, samples, thinned
from jaxsr.discovery.treatment import Treatment, treat
from jaxsr.evolution import SearchConfig
from jaxsr.recordings import Recording
from jaxsr.views import DERIVATIVES, SMOOTHERS

Signal = Callable[[np.ndarray], np.ndarray]
SMOOTH: dict[str, tuple[Signal, Signal, Signal]] = {
    "sine": (np.sin, np.cos, lambda t: -np.sin(t)),
    "chirp": (
        lambda t: np.sin(0.3 * t**2),
        lambda t: 0.6 * t * np.cos(0.3 * t**2),
        lambda t: 0.6 * np.cos(0.3 * t**2) - 0.36 * t**2 * np.sin(0.3 * t**2),
    ),
    "decay": (
        lambda t: np.exp(-t) + 0.01 * t,
        lambda t: 0.01 - np.exp(-t),
        lambda t: np.exp(-t),
    ),
    "bump": (
        lambda t: 1.0 / (1.0 + (t - 4.0) ** 2),
        lambda t: -2.0 * (t - 4.0) / (1.0 + (t - 4.0) ** 2) ** 2,
        lambda t: (6.0 * (t - 4.0) ** 2 - 2.0) / (1.0 + (t - 4.0) ** 2) ** 3,
    ),
    "polynomial": (lambda t: t**4 - 3.0 * t, lambda t: 4.0 * t**3 - 3.0, lambda t: 12.0 * t**2),
}
RATIO = 3.0  # the stated error, at most so many times too small, at any sample


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("n", [60, 250, 2000])
@pytest.mark.parametrize("name", SMOOTH)
def test_the_errors_of_clean_derivatives_bound_what_they_miss(
    name: str, n: int, order: int
) -> None:
    t = np.linspace(0.0, 8.0, n)
    x = SMOOTH[name][0](t)
    signal = treat(t, x)
    assert signal.clean and not signal.weak
    assert np.array_equal(signal.values, x)  # to the last bit
    found, error = signal.derivative(order)
    assert error is not None and np.all(error > 0.0)
    missed = np.abs(found - SMOOTH[name][order](t))
    inside = missed <= error
    assert np.mean(inside) >= 0.95 and np.max(missed / error) < RATIO, np.max(missed / error)


@pytest.mark.parametrize("order", [1, 2])
def test_errors_are_no_larger_than_they_need_be(order: int) -> None:
    """Where differences of order 6 are good to a few digits, the stated error is, too."""
    t = np.linspace(0.0, 8.0, 250)
    for values in SMOOTH.values():
        found, error = treat(t, values[0](t)).derivative(order)
        assert error is not None
        assert np.median(error) < 1e-4 * np.sqrt(np.mean(found**2))


def test_missing_samples_of_clean_data_are_not_made_up() -> None:
    t = np.linspace(0.0, 8.0, 300)
    x = np.sin(t)
    x[[40, 41, 120]] = np.nan
    signal = treat(t, x)
    found, error = signal.derivative(1)
    known = np.isfinite(found)
    assert signal.clean and error is not None and np.count_nonzero(known) > 250
    assert np.array_equal(np.isnan(signal.values), np.isnan(x))
    assert np.max(np.abs(found - np.cos(t))[known]) < 1e-6


def noisy(seed: int, share: float, n: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 8.0, n)
    truth = np.sin(2.0 * t) + 0.3 * np.cos(5.0 * t)
    level = share * float(np.std(truth))
    return t, truth, truth + level * np.random.default_rng(seed).normal(size=n)


@pytest.mark.parametrize("share", [0.003, 0.03, 0.2])
@pytest.mark.parametrize("seed", range(2))
def test_noisy_samples_are_smoothed_and_taken_in_the_weak_view(seed: int, share: float) -> None:
    t, truth, x = noisy(seed, share)
    signal = treat(t, x)
    assert signal.weak and not signal.clean
    level = share * np.std(truth)
    np.testing.assert_allclose(np.sqrt(np.mean(signal.noise**2)), level, rtol=0.2)
    assert np.sqrt(np.mean((signal.values - truth) ** 2)) < 0.6 * level
    found, error = signal.derivative(1)
    rate = 2.0 * np.cos(2.0 * t) - 1.5 * np.sin(5.0 * t)
    assert error is None
    plain = np.gradient(x, t) - rate
    assert np.std(found - rate) < 0.5 * np.std(plain)


def test_a_derivative_that_is_a_column_leaves_its_state_alone() -> None:
    t, _, x = noisy(0, 0.05)
    signal = treat(t, x, given=True)
    assert np.array_equal(signal.values, x) and not signal.weak
    assert not treat(t, x, Treatment(view="weak"), given=True).weak


@pytest.mark.parametrize("count", [4, 12, 23])
def test_too_few_samples_stay_as_they_are(count: int) -> None:
    t, _, x = noisy(0, 0.05, count)
    signal = treat(t, x, Treatment(view="weak"))
    assert np.array_equal(signal.values, x) and signal.clean and not signal.weak
    assert np.all(np.isfinite(signal.derivative(1)[0]))


@pytest.mark.parametrize("way", sorted(SMOOTHERS))
def test_a_smoother_that_is_named_is_used(way: str) -> None:
    t, _, x = noisy(1, 0.05)
    values = treat(t, x, Treatment(smoothing=way)).values
    np.testing.assert_array_equal(values, jaxsr.views.smooth(t, x, way))
    assert np.std(values - x) > 0.0


@pytest.mark.parametrize("way", sorted(DERIVATIVES))
def test_a_derivative_that_is_named_is_used(way: str) -> None:
    t, _, x = noisy(1, 0.05)
    signal = treat(t, x, Treatment(smoothing="none", derivative=way))
    found, error = signal.derivative(1)
    assert error is None and not signal.weak and np.array_equal(signal.values, x)
    np.testing.assert_array_equal(found, jaxsr.views.derivative(t, x, way))


def test_a_view_that_is_named_is_taken() -> None:
    t, truth, x = noisy(1, 0.05)
    assert not treat(t, x, Treatment(view="derivative")).weak
    assert treat(t, truth, Treatment(view="weak")).weak
    part = roles(["x"], None, 1, (), None)
    for view, expected in (("derivative", set()), ("weak", {"x"})):
        chosen = replace(part, treatment=Treatment(view=view))
        assert set(samples([Recording("a", t, {"x": x})], chosen).weak) == expected
        assert set(samples([Recording("a", t, {"x": truth})], chosen).weak) == expected


def test_no_smoothing_leaves_noisy_samples_as_recorded() -> None:
    t, _, x = noisy(1, 0.05)
    assert np.array_equal(treat(t, x, Treatment(smoothing="none")).values, x)


@pytest.mark.parametrize("name", ["smoothing", "derivative", "view"])
def test_an_option_without_meaning_gets_one_clear_line(name: str) -> None:
    with pytest.raises(InputError) as told:
        Treatment(**{name: "moving_average"})
    text = str(told.value)
    assert "moving_average" in text and name in text and "auto" in text and "\n" not in text


def test_the_weak_view_and_a_derivative_contradict_each_other() -> None:
    with pytest.raises(InputError, match="takes no derivative"):
        Treatment(view="weak", derivative="tikhonov")


def test_every_fourth_block_of_every_recording_is_held_back() -> None:
    group = np.repeat([0, 1, 2], [160, 80, 5])
    held = hold_back(group)
    assert not np.any(held[group == 2])  # too short to be cut
    for number in (0, 1):
        own = held[group == number]
        assert np.mean(own) == 0.25
        assert np.count_nonzero(np.diff(own.astype(int)) == 1) == 2  # in two blocks


def test_thinned_rows_are_even_and_keep_both_ends() -> None:
    for n, most in ((10, 20), (1000, 7), (101, 100)):
        kept = thinned(np.arange(n), most)
        assert len(kept) == min(n, most) and kept[0] == 0 and kept[-1] == n - 1
        assert len(set(kept)) == len(kept) and np.ptp(np.diff(kept)) <= 1


def test_what_one_recording_lacks_is_left_out_for_all() -> None:
    t, truth, x = noisy(3, 0.05)
    part = roles(["x"], None, 1, (), None)
    clean, rough = Recording("clean", t, {"x": truth}), Recording("rough", t, {"x": x})
    both = samples([clean, rough], part)
    assert not both.weak and not both.errors and len(both.traces) == 2
    assert set(samples([rough, rough], part).weak) == {"x"}
    assert set(samples([clean, clean], part).errors) == {"x"}


@pytest.mark.parametrize("count", [3, 30])
def test_a_short_recording_beside_a_long_one_weighs_no_more_a_sample(count: int) -> None:
    t, _, x = noisy(4, 0.05)
    long, short = Recording("long", t, {"x": x}), Recording("short", t[:count], {"x": x[:count]})
    levels = [
        float(np.median(trace["noise"]["x"]))
        for trace in samples([long, short], roles(["x"], None, 1, (), None)).traces
    ]
    assert 0.2 < levels[1] / levels[0] < 5.0


def shaken(noise: float, seed: int = 0) -> tuple[Recording, np.ndarray, np.ndarray]:
    """q'' = -9 q - 0.6 q' + 2 u, u two sines, in the steady state; only q'' and u are recorded."""
    t = np.arange(0.0, 120.0, 0.1)
    q, v, u = np.zeros((3, len(t)))
    for w, size, phase in ((2.1, 1.0, 0.0), (4.3, 0.7, 0.4)):
        wave = size * np.exp(1j * (w * t + phase))
        answer = 2.0 / (9.0 - w**2 + 0.6j * w) * wave
        u, q, v = u + wave.imag, q + answer.imag, v + (1j * w * answer).imag
    a = -9.0 * q - 0.6 * v + 2.0 * u
    a = a + noise * np.std(a) * np.random.default_rng(seed).normal(size=len(t))
    return Recording("shaken", t, {"a": a, "u": u}), q, v


def test_motions_are_integrated_from_accelerations_alone() -> None:
    """What a part of a period leaves is of the order of the amplitude over 40 periods."""
    recording, q, v = shaken(0.0)
    data = samples([recording], roles(["q"], ["a"], 2, ("u",), None))
    for name, truth in (("q", q), ("d_q", v)):
        apart = data.variables[name] - truth
        assert np.sqrt(np.mean(apart**2)) < np.std(truth) / 40.0
    assert np.array_equal(data.targets["d_q"], recording.channels["a"])
    assert np.array_equal(data.targets["q"], data.variables["d_q"])


def test_a_displacement_that_is_recorded_is_not_integrated() -> None:
    recording, q, v = shaken(0.0)
    given = Recording("given", recording.time, {**recording.channels, "q": q})
    data = samples([given], roles(["q"], ["a"], 2, ("u",), None))
    assert np.array_equal(data.variables["q"], q)
    assert np.sqrt(np.mean((data.variables["d_q"] - v) ** 2)) < np.std(v) / 100.0


def _from_accelerations(noise: float, budget: float) -> None:
    quick = SearchConfig(population=40, refined=3, generations=8, restarts=0, patience=2)
    found = jaxsr.discover(
        [shaken(noise)[0]],
        states=["q"],
        derivatives=["a"],
        order=2,
        inputs=["u"],
        autonomous=True,
        config=quick,
        budget=budget,
    )
    first, second = found.equations
    assert first.expression == "d_q"
    rng = np.random.default_rng(0)
    q, v, u = rng.normal(size=(3, 400)) * [[0.4], [1.0], [0.9]]
    truth = -9.0 * q - 0.6 * v + 2.0 * u
    values = Samples({"t": q, "q": q, "d_q": v, "u": u}, {}, np.zeros(400, int), frozenset())
    apart = second.predict(values) - truth
    assert np.sqrt(np.mean(apart**2)) < 0.02 * np.std(truth)


@pytest.mark.slow
def test_accelerations_alone_give_a_model_close_to_the_truth() -> None:
    _from_accelerations(0.0, 6.0)


@pytest.mark.slow
def test_accelerations_with_a_little_noise_give_a_model_close_to_the_truth() -> None:
    """Integrated twice, noise of 1e-4 of the motion wanders by some percent of it in 120 s."""
    _from_accelerations(1e-4, 20.0)
