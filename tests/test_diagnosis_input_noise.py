"""Noise of a recorded input: whether it acted, as the readings tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.input_noise import idle_noise, noisy_inputs, quieted
from jaxsr.diagnosis.setup import prepare
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording

COIL = """
[model]
states = ["i"]
inputs = ["V"]
outputs = ["y"]
[equations]
i = "(V - R*i)/L"
[readings]
y = "i"
[parameters]
L = { value = 0.001, bounds = [0.0001, 0.1] }
R = { value = 2.0, bounds = [0.1, 10.0] }
"""
MODEL = parse_model(COIL)
TIME = np.arange(1500) * 1e-3


def recording(seed: int, acts: bool, noise: float = 0.03) -> Recording:
    """A coil under a smooth voltage; noise lies on its recording, and acts or does not."""
    rng = np.random.default_rng(seed)
    smooth = 3.0 * np.sin(12.0 * TIME)
    read = smooth + noise * rng.normal(size=TIME.size)
    drive = read if acts else smooth

    def rate(t: float, i: np.ndarray) -> np.ndarray:
        return (np.interp(t, TIME, drive) - 1.5 * i) / 0.002

    i = solve_ivp(rate, (0.0, TIME[-1]), [0.0], t_eval=TIME, max_step=5e-4, rtol=1e-6).y[0]
    return Recording("a.csv", TIME, {"V": read, "y": i + 0.005 * rng.normal(size=TIME.size)})


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("acts", [True, False])
def test_the_readings_tell_whether_noise_of_an_input_acted(seed: int, acts: bool) -> None:
    prepared = prepare(MODEL, [recording(seed, acts)])
    found = idle_noise(Simulator(MODEL), prepared, lambda: False)
    assert found == (() if acts else ("V",))


def test_smoothing_brings_the_course_back() -> None:
    prepared = prepare(MODEL, [recording(0, False)])
    (smooth,) = quieted(MODEL, prepared, ["V"])
    truth = 3.0 * np.sin(12.0 * TIME)
    assert np.std(smooth.inputs[:, 0] - truth) < 0.4 * np.std(prepared[0].inputs[:, 0] - truth)


def test_clean_and_rough_inputs_are_left() -> None:
    clean = recording(0, False, noise=0.0)
    assert noisy_inputs(MODEL, prepare(MODEL, [clean])) == ()
    rough = np.random.default_rng(1).normal(size=TIME.size)
    wild = Recording("b.csv", TIME, {**clean.channels, "V": rough})
    assert noisy_inputs(MODEL, prepare(MODEL, [wild])) == ()
