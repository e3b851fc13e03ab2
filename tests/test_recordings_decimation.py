"""Fewer samples that tell the same motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from jaxsr.recordings import Recording
from jaxsr.recordings.decimation import decimated, is_uniform

TIME = np.arange(0.0, 20.0, 1e-3)
FACTOR = 20


def response(time: np.ndarray, u: np.ndarray, interp: bool) -> np.ndarray:
    """A mass on a spring with a period of 2 s."""
    return lsim(([1.0], [1.0, 0.6, 10.0]), u, time, interp=interp)[1]


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_a_coarse_input_moves_the_machine_as_the_fine_one_does(hold):
    """White commands, far rougher than the new sampling."""
    rng = np.random.default_rng(0)
    u = 5.0 * rng.normal(size=TIME.size) + np.sin(2.0 * TIME)
    y = response(TIME, u, hold == "linear")
    coarse = decimated(Recording("r", TIME, {"u": u, "y": y}), FACTOR, {"u": hold})
    again = response(coarse.time, coarse.channels["u"], hold == "linear")
    apart = np.sqrt(np.mean((again - coarse.channels["y"]) ** 2)) / y.std()
    picked = response(coarse.time, u[::FACTOR], hold == "linear")
    taken = np.sqrt(np.mean((picked - coarse.channels["y"]) ** 2)) / y.std()
    assert apart < 0.01 < 0.1 * taken


def test_white_noise_falls_and_steps_of_a_converter_stay():
    rng = np.random.default_rng(1)
    y = np.sin(3.0 * TIME)
    noise = 0.02 * rng.normal(size=y.size)
    stepped = np.round(y / 0.01) * 0.01
    channels = {"white": y + noise, "stepped": stepped, "coloured": y + np.cumsum(noise) / 50}
    coarse = decimated(Recording("r", TIME, channels), FACTOR, {})
    left = coarse.channels["white"] - y[::FACTOR]
    assert np.std(left) < 0.4 * 0.02 and abs(np.mean(left[1:] * left[:-1])) < 0.2 * np.var(left)
    np.testing.assert_array_equal(coarse.channels["stepped"], stepped[::FACTOR])
    np.testing.assert_array_equal(coarse.channels["coloured"], channels["coloured"][::FACTOR])
    np.testing.assert_array_equal(coarse.time, TIME[::FACTOR])


def test_lines_and_constants_stay_what_they_are():
    line = Recording("r", TIME[:1003], {"u": 2.0 + 3.0 * TIME[:1003], "c": np.ones(1003)})
    coarse = decimated(line, 10, {"u": "linear", "c": "zero"})
    np.testing.assert_allclose(coarse.channels["u"], 2.0 + 3.0 * coarse.time, rtol=1e-9)
    np.testing.assert_allclose(coarse.channels["c"], 1.0)
    assert decimated(line, 1, {}) is line


def test_only_uniform_times_and_whole_inputs_allow_it():
    uneven = Recording("r", np.array([0.0, 1.0, 2.5, 3.5]), {"u": np.ones(4)})
    lost = Recording("r", np.arange(4.0), {"u": np.array([1.0, np.nan, 1.0, 1.0])})
    assert not is_uniform(uneven, ["u"]) and not is_uniform(lost, ["u"])
    assert is_uniform(lost, []) and is_uniform(Recording("r", np.arange(4.0), {}), [])
