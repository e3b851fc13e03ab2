"""The weak view of a simulator: its residual, its derivatives, and what is left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_systems import ARM, RAIL
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.weak.weak_grid import WeakGrid
from jaxsr.diagnosis.weak.weak_system import WeakSystem, weak_system
from jaxsr.models import Model, Simulator, parse_model, read_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording


def trajectory(field: Callable, x0: list[float], time: np.ndarray) -> np.ndarray:
    """States at `time`, shape (states, samples), integrated far tighter than any tolerance here."""
    span = (time[0], time[-1])
    found = solve_ivp(field, span, x0, t_eval=time, method="DOP853", rtol=1e-10, atol=1e-12)
    assert found.success
    return found.y


def push(t: np.ndarray | float) -> np.ndarray:
    return 4.0 * np.sin(2.1 * t) + 3.0 * np.cos(4.7 * t + 0.3)


def rail_recording(rate: float = 500.0, speed: bool = False) -> Recording:
    time = np.arange(int(8 * rate)) / rate
    q, v = trajectory(lambda t, x: [x[1], (push(t) - 3.0 * x[1]) / 2.0], [0.1, -0.4], time)
    channels = {"force": push(time), "y": q}
    return Recording("rail.csv", time, channels | ({"z": v} if speed else {}))


def arm_torques(t: np.ndarray | float) -> np.ndarray:
    return np.array(
        [
            9.0 * np.sin(1.9 * t) + 6.0 * np.sin(4.1 * t),
            3.0 * np.sin(2.9 * t + 1.0) + np.sin(6.0 * t),
        ]
    )


def arm_rates(t: float, x: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Two-link arm in the vertical plane, written out by hand from Lagrange's equations."""
    a, b, d, g1, g2, f1, f2 = 1.06725, 0.2475, 0.161, 18.88425, 5.3955, 2.0, 0.4
    q1, q2, w1, w2 = x
    c, s = b * np.cos(q2), b * np.sin(q2)
    mass = np.array([[a + 2 * c, d + c], [d + c, d]])
    coriolis = np.array([-s * (2 * w1 * w2 + w2**2), s * w1**2])
    weight = np.array([g1 * np.sin(q1) + g2 * np.sin(q1 + q2), g2 * np.sin(q1 + q2)])
    right = torque - coriolis - weight - np.array([f1 * w1, f2 * w2])
    return np.array([w1, w2, *np.linalg.solve(mass, right)])


def arm_recording(rate: float = 500.0) -> Recording:
    time = np.arange(int(8 * rate)) / rate
    x = trajectory(lambda t, s: arm_rates(t, s, arm_torques(t)), [0.3, -0.2, 0.0, 0.5], time)
    torque = arm_torques(time)
    names = ("torque1_Nm", "torque2_Nm", "encoder1_rad", "encoder2_rad")
    channels = dict(zip(names, (*torque, x[0], x[1]), strict=True))
    return Recording("arm.csv", time, channels)


def weak(
    model: Model, recording: Recording, half_width: float = 0.2, theta: np.ndarray | None = None
) -> WeakSystem:
    simulator = Simulator(model)
    values = np.array(simulator.values()) if theta is None else theta
    grid = WeakGrid.build(model, [Prepared.build(model, recording)], half_width)
    return weak_system(simulator, grid, values)


def relative(system: WeakSystem) -> list[float]:
    """Rms of the residual over rms of the input side, per equation."""
    states = np.unique(system.state)
    rms = [
        [np.sqrt(np.mean(part[system.state == s] ** 2)) for s in states]
        for part in (system.residual, system.input_side)
    ]
    return [left / side for left, side in zip(*rms, strict=True)]


@pytest.fixture(scope="module")
def arm() -> Model:
    # The torques of the tight simulation are smooth, not held.
    return replace(read_model(ARM), input_hold="linear")


def test_residual_vanishes_for_the_true_mass_and_damper():
    system = weak(parse_model(RAIL), rail_recording())
    assert max(relative(system)) < 1e-4


def test_residual_vanishes_with_a_measured_velocity():
    text = RAIL.replace('outputs = ["y"]', 'outputs = ["y", "z"]').replace(
        'y = "q"', 'y = "q"\nz = "v"'
    )
    system = weak(parse_model(text), rail_recording(speed=True))
    assert max(relative(system)) < 1e-4


def test_residual_vanishes_with_the_velocity_alone():
    text = RAIL.replace('y = "q"', 'y = "v"').replace('y = "m"', 'y = "m/s"')
    recording = rail_recording(speed=True)
    recording = Recording(
        "speed.csv",
        recording.time,
        {"force": recording.channels["force"], "y": recording.channels["z"]},
    )
    system = weak(parse_model(text), recording)
    assert system.residual.size > 0
    assert max(relative(system)) < 1e-4


def test_residual_vanishes_for_an_arm_whose_inertia_depends_on_the_joints(arm):
    system = weak(arm, arm_recording())
    assert np.unique(system.state).size == 2
    assert max(relative(system)) < 1e-4


def test_residual_vanishes_where_the_drives_hold_each_torque():
    """With input_hold "zero" the force between samples is the last one, not a line."""
    model = parse_model(RAIL.replace('outputs = ["y"]', 'outputs = ["y"]\ninput_hold = "zero"'))
    dt, count, mass, damping = 0.01, 1000, 2.0, 3.0
    time = np.arange(count) * dt
    force = push(time)
    # Exact solution of M v' = u - Fv v over one sample with u held.
    decay = np.exp(-damping / mass * dt)
    q, v = np.zeros(count), np.zeros(count)
    for k in range(count - 1):
        final = force[k] / damping
        v[k + 1] = final + (v[k] - final) * decay
        q[k + 1] = q[k] + final * dt + (v[k] - final) * (1 - decay) * mass / damping
    system = weak(model, Recording("held.csv", time, {"force": force, "y": q}))
    # Half a sample of delay would leave about 2 %; smoothing the corners leaves far less.
    assert max(relative(system)) < 2e-3


def test_wrong_values_leave_a_residual_of_their_own_size():
    """Half the damping missing: what is left is that damping force."""
    model, recording = parse_model(RAIL), rail_recording()
    true, half = weak(model, recording), weak(model, recording, theta=np.array([2.0, 1.5]))
    assert max(relative(half)) > 0.1
    expected = true.residual + true.jacobian @ np.array([0.0, -1.5])
    np.testing.assert_allclose(half.residual, expected, atol=1e-9)


@pytest.mark.parametrize("case", ["rail", "arm"])
def test_jacobian_equals_finite_differences(case, arm):
    model = parse_model(RAIL) if case == "rail" else arm
    recording = rail_recording(200.0) if case == "rail" else arm_recording(200.0)
    theta = 1.1 * np.array(Simulator(model).values())
    system = weak(model, recording, theta=theta)
    for j in range(theta.size):
        step = np.zeros_like(theta)
        step[j] = 1e-5 * theta[j]
        up, down = (weak(model, recording, theta=theta + s).residual for s in (step, -step))
        slope = (up - down) / (2 * step[j])
        size = np.abs(slope).max()
        np.testing.assert_allclose(system.jacobian[:, j], slope, atol=1e-6 * size)
    # Both models are linear in their parameters: first order is exact.
    other = weak(model, recording, theta=1.3 * theta)
    np.testing.assert_allclose(system.at(1.3 * theta), other.residual, atol=1e-8 * size)


def test_rows_with_missing_samples_are_left_out():
    model, recording = parse_model(RAIL), rail_recording(200.0)
    y = recording.channels["y"].copy()
    y[600:620] = np.nan
    gap = Recording("gap.csv", recording.time, {**recording.channels, "y": y})
    whole, cut = weak(model, recording), weak(model, gap)
    assert np.isfinite(cut.residual).all() and np.isfinite(cut.jacobian).all()
    touches = (whole.centre + 0.2 > recording.time[600]) & (
        whole.centre - 0.2 < recording.time[619]
    )
    assert touches.any()
    np.testing.assert_allclose(cut.centre, whole.centre[~touches])
    # The smoothing beside a gap is one-sided: a little worse, but the physics still holds.
    assert max(relative(cut)) < 1e-3


def test_equations_with_a_hidden_state_are_not_written_down(arm):
    one_sensor = replace(arm, outputs=("y1",), readings={"y1": "q1"})
    prepared = [Prepared.build(one_sensor, arm_recording(100.0))]
    assert WeakGrid.build(one_sensor, prepared, 0.2).observable == ()
    both = [Prepared.build(arm, arm_recording(100.0))]
    assert WeakGrid.build(arm, both, 0.2).observable == ("w1", "w2")


def test_recordings_are_told_apart():
    model = parse_model(RAIL)
    prepared = [Prepared.build(model, rail_recording(r)) for r in (100.0, 200.0)]
    system = weak_system(
        Simulator(model), WeakGrid.build(model, prepared, 0.2), np.array([2.0, 3.0])
    )
    assert set(system.recording) == {0, 1}
    assert system.recording.size == system.residual.size == system.centre.size


AXES = """
[model]
states = ["q1", "q2", "v1", "v2"]
inputs = ["u"]
outputs = ["y1", "y2"]
[equations]
q1 = "v1"
q2 = "v2"
v1 = "u - 30.0*q1 - c*(v1 - v2)"
v2 = "RATE"
[inertia]
v1 = { v1 = "m1" }
MASS
[readings]
y1 = "q1"
y2 = "q2"
[parameters]
m1 = { value = 2.0, bounds = [0.5, 8.0] }
m2 = { value = 1.5, bounds = [0.5, 8.0] }
c = { value = 0.7, bounds = [0.0, 5.0] }
"""


def test_a_row_of_inertia_stands_beside_an_equation_that_divides_by_its_mass():
    time = np.arange(800) * 0.01
    channels = {"u": push(time), "y1": np.sin(2.0 * time), "y2": np.cos(1.3 * time)}
    forces = "-20.0*q2 - c*(v2 - v1)"
    texts = [("(" + forces + ")/m2", ""), (forces, 'v2 = { v2 = "m2" }')]
    models = [parse_model(AXES.replace("RATE", r).replace("MASS", m)) for r, m in texts]
    mixed, both = (weak(model, Recording("a.csv", time, channels)) for model in models)
    np.testing.assert_allclose(mixed.residual, both.residual, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(mixed.jacobian, both.jacobian, rtol=1e-6, atol=1e-9)
