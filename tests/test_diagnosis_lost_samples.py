"""The weak view where sensors drop samples, differ in their rates or are absent."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr._result import InputError
from jaxsr.diagnosis.setup import half_width_of, prepare_data, seen_by
from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import WeakSystem, weak_system
from jaxsr.models import Model, Simulator, parse_model
from jaxsr.recordings import Recording

MOTOR = """
[model]
states = ["i", "w", "th"]
inputs = ["u"]
outputs = ["yi", "yw"]
[equations]
i = "(u - R*i - Ke*w)/L"
w = "(Ke*i - b*w)/J"
th = "w"
[readings]
yi = "i"
yw = "w"
[parameters]
R = { value = 1.0, bounds = [0.1, 5.0] }
L = 0.05
Ke = 0.1
J = { value = 0.002, bounds = [0.0005, 0.01] }
b = { value = 0.001, bounds = [0.0, 0.01] }
[initial]
th = 0.0
"""
STEP, SAMPLES = 0.01, 1500
DROPPED = (0.005, 0.02, 0.1, 0.2)


def chain(noise: float = 0.0, name: str = "chain.csv", seed: int = 0) -> Recording:
    """Two masses that the model TWO_MASSES describes exactly, both positions measured."""
    time = STEP * np.arange(SAMPLES)

    def force(t: np.ndarray | float) -> np.ndarray | float:
        return 3.0 * np.sin(2.1 * t) + 2.0 * np.cos(4.3 * t)

    def rates(t: float, x: np.ndarray) -> list[float]:
        q1, q2, v1, v2 = x
        pull = 40.0 * (q2 - q1)
        return [v1, v2, force(t) - 60.0 * q1 + pull - 0.8 * v1, (-pull - 0.5 * v2) / 0.7]

    found = solve_ivp(rates, (0.0, time[-1]), [0.1, 0.0, 0.0, 0.0], t_eval=time, rtol=1e-10)
    rng = np.random.default_rng(seed)
    y1, y2 = found.y[:2] + noise * rng.normal(size=(2, SAMPLES))
    return Recording(name, time, {"force": np.asarray(force(time)), "y1": y1, "y2": y2})


CHAIN = """
[model]
states = ["q1", "q2", "v1", "v2"]
inputs = ["force"]
outputs = ["y1", "y2"]
[equations]
q1 = "v1"
q2 = "v2"
v1 = "force - k*q1 + kc*(q2 - q1) - c1*v1"
v2 = "-kc*(q2 - q1) - c2*v2"
[inertia]
v1 = { v1 = "1" }
v2 = { v2 = "m2" }
[readings]
y1 = "q1"
y2 = "q2"
[parameters]
k = { value = 60.0, bounds = [10.0, 200.0] }
kc = { value = 40.0, bounds = [10.0, 200.0] }
c1 = { value = 0.8, bounds = [0.0, 10.0] }
c2 = { value = 0.5, bounds = [0.0, 10.0] }
m2 = { value = 0.7, bounds = [0.1, 5.0] }
"""


def without(recording: Recording, lost: dict[str, np.ndarray]) -> Recording:
    """Leave samples out, given by a mask for each channel."""
    channels = {
        key: np.where(lost[key], np.nan, values) if key in lost else values
        for key, values in recording.channels.items()
    }
    return Recording(recording.name, recording.time, channels)


def at_random(share: float, seed: int, *names: str) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {name: rng.random(SAMPLES) < share for name in names}


def weak(model: Model, *recordings: Recording) -> WeakSystem:
    prepared = prepare_data(model, recordings)
    half_width = half_width_of(prepared)
    assert half_width is not None
    simulator = Simulator(model)
    return weak_system(
        simulator, WeakGrid.build(model, prepared, half_width), np.array(simulator.values())
    )


def relative(system: WeakSystem, model: Model, state: str) -> float:
    """Residual of one equation over what its terms bring, both as root mean squares."""
    rows = system.state == model.states.index(state)
    terms = system.jacobian[rows] * system.theta
    return float(np.sqrt(np.mean(system.residual[rows] ** 2) / np.mean(np.sum(terms**2, axis=1))))


@pytest.mark.long
@pytest.mark.parametrize("share", DROPPED)
def test_samples_lost_at_random_leave_nearly_all_rows_and_the_law(share):
    model, whole = parse_model(CHAIN), chain()
    complete = weak(model, whole)
    # as many samples lost on each sensor, at other times
    lost = at_random(share, 1, "y1") | at_random(share, 2, "y2")
    system = weak(model, without(whole, lost))
    expected = complete.residual.size * complete.half_width / system.half_width
    assert system.residual.size > 0.9 * expected
    for state in ("v1", "v2"):
        assert relative(system, model, state) < 0.02


@pytest.mark.parametrize("every", [2, 3, 10])
def test_a_slow_sensor_has_the_rows_of_the_fast_one(every):
    model, whole = parse_model(CHAIN), chain()
    slow = np.arange(SAMPLES) % every != 0
    system = weak(model, without(whole, {"y2": slow}))
    assert system.half_width >= 4 * every * STEP * (1 - 1e-9)
    counts = [np.count_nonzero(system.state == model.states.index(s)) for s in ("v1", "v2")]
    assert counts[0] == counts[1] > 50
    for state in ("v1", "v2"):
        assert relative(system, model, state) < 0.05


def test_sensors_that_drop_out_in_turn_leave_the_equations_that_need_one_alone():
    """No support holds both sensors; the drive's own equation needs the first alone."""
    model = parse_model(CHAIN.replace("+ kc*(q2 - q1) ", ""))
    turn = (np.arange(SAMPLES) // 100) % 2 == 0
    system = weak(model, without(chain(), {"y1": turn, "y2": ~turn}))
    assert set(system.state) == {model.states.index("v1")}


def test_a_long_gap_costs_its_own_rows_alone():
    model, whole = parse_model(CHAIN), chain()
    gap = np.zeros(SAMPLES, bool)
    gap[500:800] = True
    cut, full = weak(model, without(whole, {"y2": gap})), weak(model, whole)
    assert np.isfinite(cut.residual).all()
    reach = cut.half_width
    beside = (full.centre + reach < whole.time[500]) | (full.centre - reach > whole.time[799])
    assert cut.residual.size == np.count_nonzero(beside)


@pytest.mark.long
@pytest.mark.parametrize("column", ["empty", "none"])
def test_a_sensor_absent_in_one_recording_is_missing_there(column):
    model, first, second = parse_model(CHAIN), chain(), chain(name="second.csv", seed=1)
    second = without(second, {"y2": np.ones(SAMPLES, bool)})
    if column == "none":
        kept = {key: values for key, values in second.channels.items() if key != "y2"}
        second = Recording(second.name, second.time, kept)
    system = weak(model, first, second)
    assert set(system.recording) == {0}
    assert seen_by(Simulator(model), prepare_data(model, [first, second])) is not None


def test_a_sensor_absent_in_every_recording_is_named():
    model = parse_model(CHAIN)
    lost = without(chain(), {"y2": np.ones(SAMPLES, bool)})
    with pytest.raises(InputError, match="every sample of column 'y2' is missing"):
        prepare_data(model, [lost])


def test_nothing_that_moves_is_refused_by_name():
    model, whole = parse_model(CHAIN), chain()
    still = Recording(
        "still.csv", whole.time, dict(whole.channels, y1=0 * whole.time, y2=0 * whole.time)
    )
    with pytest.raises(InputError, match=r"still\.csv: nothing moves: y1, y2 are constant"):
        prepare_data(model, [still])


def motor(seed: int = 0) -> Recording:
    time = 0.005 * np.arange(800)

    def voltage(t: np.ndarray | float) -> np.ndarray | float:
        return 5.0 * np.sign(np.sin(3.0 * t)) + 2.0 * np.sin(11.0 * t)

    def rates(t: float, x: np.ndarray) -> list[float]:
        i, w = x
        friction = 0.02 * np.tanh(w / 0.05)
        return [(voltage(t) - i - 0.1 * w) / 0.05, (0.1 * i - 0.001 * w - friction) / 0.002]

    found = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, max_step=2e-3, rtol=1e-8)
    rng = np.random.default_rng(seed)
    yi, yw = found.y + np.array([[0.01], [0.05]]) * rng.normal(size=found.y.shape)
    return Recording("motor.csv", time, {"u": np.asarray(voltage(time)), "yi": yi, "yw": yw})


@pytest.mark.long
def test_a_motor_whose_angle_no_sensor_tells_is_seen():
    """Mechanisms of the hidden angle take the angle that the measured speed leads to."""
    model = parse_model(MOTOR)
    prepared = prepare_data(model, [motor()])
    seen = seen_by(Simulator(model), prepared)
    assert seen is not None
    theta = np.array([p.value for p in model.parameters.values()])
    system = weak_system(Simulator(model), seen.grid, theta)
    assert set(system.state) == {model.states.index(s) for s in ("i", "w")}
    assert "coulomb_friction@equation:w" in {c.label for c in seen.candidates}


def test_few_samples_are_no_weak_view():
    model, whole = parse_model(CHAIN), chain()
    prepared = prepare_data(model, [whole.select(slice(0, 12))])
    assert half_width_of(prepared) is None
    assert seen_by(Simulator(model), prepared) is None
    both = prepare_data(model, [whole.select(slice(0, 12)), whole])
    width = half_width_of(both)
    assert width is not None and width == half_width_of(prepare_data(model, [whole]))
