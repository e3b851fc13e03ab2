"""Holds and delays of inputs, delays and clocks of outputs, against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_runs import model, quiet, read_off, rolled

from jaxsr._result import InputError
from jaxsr.models import Simulator
from jaxsr.models.delays import smoothly_interpolated
from jaxsr.models.free_run import _field, _Motion, free_run
from jaxsr.models.inputs import fill_missing, stage_inputs
from jaxsr.models.rollout import Stepping
from jaxsr.recordings import Recording


def lag(hold: str = "linear", extra: str = "") -> Simulator:
    return model("x", 'x = "(u - x)/tau"', "tau = 0.5; d = 0.13", "u", extra=extra, hold=hold)


def lag_of_line(time: np.ndarray, tau: float) -> np.ndarray:
    """Response of tau x' = u - x, x(0) = 0 to the ramp u = t."""
    at = np.maximum(time, 0.0)
    return at - tau * (1 - np.exp(-at / tau))


@pytest.mark.long
def test_zero_hold_against_the_exact_recursion() -> None:
    rng = np.random.default_rng(0)
    recording = quiet(2.0, 0.1, u=rng.normal(size=21))
    u, decay = recording.channel("u"), np.exp(-0.1 / 0.5)
    exact = [0.0]
    for k in range(20):
        exact.append(decay * exact[-1] + (1 - decay) * u[k])
    x = rolled(lag("zero"), recording, [0.0], Stepping("rk4", 8))
    np.testing.assert_allclose(x[:, 0], exact, atol=1e-8)
    run = free_run(lag("zero"), recording, np.zeros(1))
    np.testing.assert_allclose(run.states[:, 0], exact, atol=1e-7)


@pytest.mark.parametrize("delay", ["0.3", "0.1", "0.07"])
def test_zero_hold_with_delay(delay: str) -> None:
    """A step of the input at 0.5 s acts after the delay, also where that meets a sample."""
    recording = quiet(2.0, 0.1, u=(np.arange(21) >= 5).astype(float))
    run = free_run(lag("zero", f"[delays]\nu = {delay}\n"), recording, np.zeros(1))
    assert run.success, run.message
    exact = 1 - np.exp(-np.maximum(recording.time - 0.5 - float(delay), 0.0) / 0.5)
    np.testing.assert_allclose(run.states[:, 0], exact, atol=1e-7)


@pytest.mark.long
def test_linear_hold_against_the_ramp_response() -> None:
    recording = quiet(2.0, 0.1, u=np.arange(21) * 0.1)
    exact = lag_of_line(recording.time, 0.5)
    x = rolled(lag(), recording, [0.0], Stepping("rk4", 8))
    np.testing.assert_allclose(x[:, 0], exact, atol=1e-8)
    run = free_run(lag(), recording, np.zeros(1))
    np.testing.assert_allclose(run.states[:, 0], exact, atol=1e-7)


def test_bandlimited_hold_is_exact_inside_the_band() -> None:
    time = np.arange(400) * 0.1
    for cycles in (0.3, 1.0, 2.0):  # Hz; half the sampling rate is 5 Hz
        u = np.sin(2 * np.pi * cycles * time)
        start, middle, end = stage_inputs(time, u, "bandlimited", 2)
        inside = slice(100, 299)  # away from the ends, where the record's outside is unknown
        at = time[:-1, None] + 0.1 * np.array([0.25, 0.75])
        error = np.abs(middle - np.sin(2 * np.pi * cycles * at))[inside].max()
        line = np.abs((start + end) / 2 - np.sin(2 * np.pi * cycles * at))
        assert error < 2e-3, cycles
        np.testing.assert_allclose(start[:, 0], u[:-1], atol=1e-9)
        np.testing.assert_allclose(end[:, -1], u[1:], atol=1e-9)
        assert line.shape == middle.shape


def test_bandlimited_needs_uniform_time_and_missing_inputs_are_filled() -> None:
    with pytest.raises(InputError, match="uniform"):
        stage_inputs(np.array([0.0, 1.0, 3.0]), np.zeros(3), "bandlimited", 1)
    filled = fill_missing(np.arange(4.0), np.array([0.0, np.nan, 2.0, 3.0]))
    np.testing.assert_array_equal(filled, np.arange(4.0))


def test_what_differs_in_values_and_delays_alone_is_compiled_once() -> None:
    first = _field(_Motion.of(lag("zero")))
    assert _field(_Motion.of(lag("zero", "[delays]\nu = 0.3\n"))) is first
    assert _field(_Motion.of(lag("linear"))) is not first
    other_names = model("x", 'x = "(u - x)/tau"', "tau = 0.5; c = 0.13", "u")
    other_law = model("x", 'x = "(u - x)/tau + d"', "tau = 0.5; d = 0.13", "u")
    assert len({_field(_Motion.of(s)) for s in (lag(), other_names, other_law)}) == 3


@pytest.mark.slow
def test_free_run_draws_a_bandlimited_input() -> None:
    time = np.arange(200) * 0.1
    w = 2 * np.pi * 1.5
    recording = Recording("a.csv", time, {"u": np.sin(w * time)})
    a = 1 / 0.5
    exact = a / (a**2 + w**2) * (a * np.sin(w * time) - w * np.cos(w * time))
    run = free_run(lag("bandlimited"), recording, np.array([exact[0]]))
    # What comes after the record is unknown, hence not the last samples.
    assert np.abs(run.states[:-5, 0] - exact[:-5]).max() < 1e-3
    linear = free_run(lag("linear"), recording, np.array([exact[0]]))
    assert np.abs(linear.states[:-5, 0] - exact[:-5]).max() > 5e-3


@pytest.mark.parametrize("delay", ["0.13", '"d"'])
def test_delay_on_an_input(delay: str) -> None:
    recording = quiet(2.0, 0.1, u=np.arange(21) * 0.1)
    simulator = lag(extra=f"[delays]\nu = {delay}\n")
    exact = lag_of_line(recording.time - 0.13, 0.5)
    x = rolled(simulator, recording, [0.0], Stepping("rk4", 32))
    # The kink at 0.13 s lies inside a step.
    np.testing.assert_allclose(x[:, 0], exact, atol=1e-4)
    run = free_run(simulator, recording, np.zeros(1))
    np.testing.assert_allclose(run.states[:, 0], exact, atol=1e-6)


@pytest.mark.long
def test_delay_and_clock_on_an_output() -> None:
    recording = quiet(2.0, 0.01, u=np.zeros(201))
    two = {"outputs": ("late", "fast"), "readings": {"late": "x", "fast": "x"}}
    given = replace(lag().model, **two, delays={"late": 0.13}, clock={"fast": "1 - d"})
    simulator = Simulator(given)
    exact = np.stack(
        [
            np.exp(-np.maximum(recording.time - 0.13, 0.0) / 0.5),
            np.exp(-recording.time * (1 - 0.13) / 0.5),
        ],
        axis=1,
    )
    run = free_run(simulator, recording, np.ones(1))
    np.testing.assert_allclose(run.outputs, exact, atol=1e-7)
    y = read_off(simulator, recording, [1.0], Stepping("rk4", 1))
    np.testing.assert_allclose(y, exact, atol=3e-8)  # cubics between samples


def test_readings_between_samples_are_of_fourth_order() -> None:
    def error(samples: int) -> float:
        time = np.linspace(0.0, 2.0, samples)[:, None]
        at = np.random.default_rng(0).uniform(0.0, 2.0, (400, 1))
        value, slope = smoothly_interpolated(time, np.sin(3.0 * time)[None], at)
        assert np.abs(slope[0] - 3.0 * np.cos(3.0 * at)).max() < 500.0 / samples**3
        return float(np.abs(value[0] - np.sin(3.0 * at)).max())

    orders = np.log2([error(n + 1) / error(2 * n + 1) for n in (20, 40, 80)])
    np.testing.assert_allclose(orders, 4.0, atol=0.25)


def test_readings_between_samples_of_a_padded_segment_stay_inside_it() -> None:
    time = np.array([0.0, 0.1, 0.25, 0.3, 0.45, 0.45, 0.45])[:, None]
    values = (time**3 - time)[None]
    at = np.array([-1.0, 0.05, 0.2, 0.4, 0.5])[:, None]
    found, slopes = smoothly_interpolated(time, values, at)
    inside = np.clip(at, 0.0, 0.45)
    np.testing.assert_allclose(found[0], inside**3 - inside, atol=1e-14)
    moving = np.array([0.0, 1.0, 1.0, 1.0, 0.0])[:, None]
    np.testing.assert_allclose(slopes[0], moving * (3.0 * at**2 - 1.0), atol=1e-12)
