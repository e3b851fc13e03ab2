"""Estimates of what no sensor reads: no start that is estimated anew takes the place of a law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis import diagnose
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording

MODEL = """
[model]
states = ["q1", "q2", "v1", "v2"]
inputs = ["u"]
outputs = ["y"]
input_hold = "linear"
[equations]
q1 = "v1"
q2 = "v2"
v1 = "u - k1*q1 - c1*v1 - k2*(q1 - q2)"
v2 = "(k2*(q1 - q2) - c2*v2)/m2"
[readings]
y = "q1"
[parameters]
k1 = { value = 10.0, bounds = [2.0, 50.0] }
k2 = { value = 25.0, bounds = [5.0, 125.0] }
c1 = { value = 0.5, bounds = [0.1, 2.5] }
c2 = { value = 0.3, bounds = [0.06, 1.5] }
m2 = { value = 1.5, bounds = [0.3, 7.5] }
"""
TIME = np.arange(700) * 0.02
FRICTION, NOISE = 0.4, 2e-3


def recorded(rng: np.random.Generator, number: int) -> Recording:
    """Two masses in a row, the second of which slides with Coulomb friction, the first read."""
    rates, phases = rng.uniform((0.7, 2.0, 4.0), (2.0, 4.0, 7.0)), rng.uniform(0.0, 6.0, 3)
    u = 3.0 * np.sin(rates * TIME[:, None] + phases).sum(1)

    def rate(t: float, x: np.ndarray) -> list[float]:
        q1, q2, v1, v2 = x
        spring = 25.0 * (q1 - q2)
        drag = 0.3 * v2 + FRICTION * np.tanh(v2 / 1e-3)
        push = np.interp(t, TIME, u)
        return [v1, v2, push - 10.0 * q1 - 0.5 * v1 - spring, (spring - drag) / 1.5]

    run = solve_ivp(
        rate, (0.0, TIME[-1]), np.zeros(4), t_eval=TIME, max_step=0.02, rtol=1e-6, method="LSODA"
    )
    y = run.y[0] + NOISE * rng.standard_normal(TIME.size)
    return Recording(f"run{number}", TIME, {"u": u, "y": y})


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_friction_of_a_mass_that_no_sensor_reads_has_its_size(seed: int) -> None:
    rng = np.random.default_rng(seed)
    records = [recorded(rng, number) for number in range(3)]
    found = diagnose(Simulator(parse_model(MODEL)), records, budget=1000.0).document
    (finding,) = found["findings"]
    assert (finding["mechanism"], finding["site"]) == ("coulomb_friction", "equation:v2")
    told = finding["parameters"]["Fc"]
    assert told["value"] == pytest.approx(FRICTION, rel=0.05)
    low, high = told["ci95"]
    assert high - low < 0.2 * FRICTION
    train = found["fit"]["train"]
    assert train["explained"][-1] < 0.3 * train["recalibrated"][-1]
