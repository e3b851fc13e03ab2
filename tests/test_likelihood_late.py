"""Sensors that are late in recordings that begin on the move."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.likelihood.local import _shown, linearised
from jaxsr.diagnosis.likelihood.posterior import posterior
from jaxsr.diagnosis.setup import seen_by
from jaxsr.models import Simulator, parse_model
from jaxsr.models.lifting import readings_along
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.recordings import Recording

STEP, SAMPLES = 0.01, 300
TIME = STEP * np.arange(SAMPLES)

SWING = """
[model]
states = ["q", "w"]
outputs = ["y"]
[equations]
q = "w"
w = "-25.0*q"
[readings]
y = "q"
[delays]
y = "tau"
[parameters]
tau = { value = 0.07, bounds = [0.0, 0.2] }
"""

PENDULUM = """
[model]
states = ["x", "q", "v", "w"]
inputs = ["u"]
outputs = ["cart", "angle"]
input_hold = "linear"
[equations]
x = "v"
q = "w"
v = "u - c*v - k*x + m*l*sin(q)*w**2"
w = "-b*w - m*9.81*l*sin(q)"
[inertia]
v = { v = "M + m", w = "m*l*cos(q)" }
w = { v = "m*l*cos(q)", w = "m*l**2" }
[readings]
cart = "x"
angle = "q"
[parameters]
M = { value = 1.7, bounds = [0.6, 5.0] }
m = { value = 0.6 }
l = { value = 0.5 }
c = { value = 2.7, bounds = [1.0, 7.0] }
k = { value = 11.0 }
b = { value = 0.03, bounds = [0.01, 0.1] }
"""


def innovation(recorded: np.ndarray) -> np.ndarray:
    """What the true path leaves of recorded readings that are late by 0.07 s."""
    simulator = Simulator(parse_model(SWING))
    item = Prepared.build(simulator.model, Recording("run", TIME, {"y": recorded}))
    segments = build_segments(simulator.model, [item], [(0, 0, SAMPLES)], 1)
    path = np.stack([np.sin(5.0 * TIME), 5.0 * np.cos(5.0 * TIME)])[..., None]
    args = simulator, Stepping("rk4", 1), segments, np.array([0.07]), path
    return recorded - readings_along(*args, late=True, live=True)[0][0, :, 0]


def test_a_sensor_was_live_before_a_recording_that_begins_on_the_move() -> None:
    """Continued along a cubic, of which (5 tau)^4 = 0.015 is the size of the next term."""
    assert np.abs(innovation(np.sin(5.0 * (TIME - 0.07)))).max() < 0.015


def test_a_sensor_that_shows_its_first_value_until_its_delay_has_passed_is_believed() -> None:
    assert np.abs(innovation(np.sin(5.0 * np.maximum(TIME - 0.07, 0.0)))).max() < 1e-4


def test_readings_count_where_the_state_is_that_they_show() -> None:
    """Readings of a state before the piece tell of nothing; noise there is, none that hides it."""
    rng = np.random.default_rng(3)
    simulator = Simulator(parse_model(SWING))
    recorded = np.sin(5.0 * (TIME - 0.07)) + 1e-4 * rng.normal(size=SAMPLES)
    item = Prepared.build(simulator.model, Recording("run", TIME, {"y": recorded}))
    segments = build_segments(simulator.model, [item], [(0, 0, SAMPLES)], 1)
    path = np.stack([np.sin(5.0 * TIME), 5.0 * np.cos(5.0 * TIME)])[..., None]
    args = simulator, Stepping("rk4", 1), segments, np.array([0.07]), path
    local = linearised(*args, [0])
    late, shown = 7, local.innovation[: SAMPLES - 7, 0, 0]
    np.testing.assert_allclose(shown, recorded[late:] - path[0, :-late, 0], atol=1e-4)
    np.testing.assert_allclose(local.reading[: SAMPLES - late, 0, 0], [[1.0, 0.0]] * 293, atol=1e-3)
    by_delay = local.reading_by_constant[: SAMPLES - late, 0, 0, 0]
    np.testing.assert_allclose(by_delay[1:], -path[1, 1:-late, 0], atol=0.02)
    assert not local.reading[-late:].any() and not local.reading_by_constant[-late:].any()
    assert np.isnan(local.innovation[-late:]).all()  # off by (5 tau)^4, 150 deviations
    usual = (recorded[:late] - recorded.mean()) ** 2 / recorded.var()
    expected = -0.5 * np.sum(np.log(2.0 * np.pi * recorded.var()) + usual)
    np.testing.assert_allclose(local.log_apart, expected)


@pytest.mark.parametrize("skew", [-0.03, -0.004, 0.0, 0.004, 0.03])
def test_readings_by_another_clock_stand_at_what_they_show(skew: float) -> None:
    """Every reading stands somewhere; of two that show one sample, the second shows none."""
    places = np.rint(np.arange(SAMPLES) * (1.0 + skew)).astype(int)
    at, spare, outside = _shown(places)
    np.testing.assert_array_equal(np.sort(at), np.arange(SAMPLES))
    np.testing.assert_array_equal(places[at[~spare]], np.flatnonzero(~spare))
    np.testing.assert_array_equal(places[at[outside]] >= SAMPLES, True)
    assert (~spare).sum() == np.unique(places[places < SAMPLES]).size


def moving(
    rng: np.random.Generator, delay: float, skew: float = 0.0, noise: float = 0.02
) -> Recording:
    """A cart with a pendulum that has moved for a second, the angle's sensor late."""
    size, phase, rate = (
        rng.uniform(2.0, 5.0, 3),
        rng.uniform(0.0, 6.0, 3),
        np.array([2.1, 4.3, 8.7]),
    )

    def drive(t: float) -> float:
        return float((size * np.sin(rate * t + phase)).sum())

    def rates(t: float, state: np.ndarray) -> list[float]:
        _, q, v, w = state
        inertia = np.array([[2.3, 0.3 * np.cos(q)], [0.3 * np.cos(q), 0.15]])
        cart = drive(t) - 2.7 * v - 11.0 * state[0] + 0.3 * np.sin(q) * w**2
        turn = -0.03 * w - 0.3 * 9.81 * np.sin(q)
        return [v, w, *np.linalg.solve(inertia, [cart, turn])]

    span, start = (-1.0, 1.1 * TIME[-1]), [0.0, 0.1, 0.0, 0.0]
    run = solve_ivp(rates, span, start, rtol=1e-9, atol=1e-11, dense_output=True)
    cart, angle = run.sol(TIME)[0], run.sol((1.0 + skew) * TIME - delay)[1]
    readings = {
        "cart": cart + noise * cart.std() * rng.normal(size=SAMPLES),
        "angle": angle + noise * angle.std() * rng.normal(size=SAMPLES),
    }
    return Recording("run", TIME, {"u": np.array([drive(t) for t in TIME]), **readings})


@pytest.mark.long
@pytest.mark.parametrize("delay", [0.08, 0.17])
@pytest.mark.parametrize("seed", range(2))
def test_a_late_sensor_is_found_though_a_force_imitates_it(seed: int, delay: float) -> None:
    rng, simulator = np.random.default_rng(seed), Simulator(parse_model(PENDULUM))
    prepared = [Prepared.build(simulator.model, moving(rng, delay)) for _ in range(2)]
    found = posterior(simulator.model, prepared, seen_by(simulator, prepared))
    assert found is not None and found.leader.share == 0.0
    (number,) = found.leader.members
    assert found.candidates[number].label == "sensor_delay@output:angle"
    value, deviation = found.leader.constants[found.leader.names[number]["tau"]]
    assert abs(value - delay) < 4.0 * deviation


@pytest.mark.long
@pytest.mark.parametrize("skew", [-0.02, -0.01, 0.01, 0.02])
def test_a_clock_of_its_own_is_found(skew: float) -> None:
    """Its readings are off by up to six samples at the end of a piece, and by none at its start.

    With one shift for a piece, a clock ahead by 1 % left a force, and 227 less of log evidence.
    """
    rng, simulator = np.random.default_rng(0), Simulator(parse_model(PENDULUM))
    prepared = [Prepared.build(simulator.model, moving(rng, 0.0, skew, 1e-3)) for _ in range(2)]
    found = posterior(simulator.model, prepared, seen_by(simulator, prepared))
    assert found is not None and found.leader.share == 0.0
    (number,) = found.leader.members
    assert found.candidates[number].label == "clock_skew@output:angle"
    value, deviation = found.leader.constants[found.leader.names[number]["s"]]
    assert abs(value - skew) < 4.0 * deviation
