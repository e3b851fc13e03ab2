"""Multiple shooting: known systems recovered from noisy data, inside bounds."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.models import Simulator, parse_model
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.rollout import Stepping, linearise, outputs
from jaxsr.models.segments import Prepared, build_segments, cut
from jaxsr.models.shooting import fit
from jaxsr.recordings import Recording

PENDULUM = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - w2*sin(q) - c*v"
[readings]
y = "q"
[parameters]
w2 = { value = 6.0, bounds = [1.0, 20.0] }
c = { value = 0.05, bounds = [0.0, 2.0] }
unused = 1.0
"""
TRUTH = np.array([9.0, 0.2, 1.0])
NOISE = 0.01


def recorded(simulator: Simulator, rng: np.random.Generator, name: str, noise: float) -> Recording:
    """Simulate the truth with fine steps and add noise to its sensor."""
    time = np.arange(401) * 0.02
    u = 2.0 * np.sin(1.5 * time + rng.uniform(0, 6)) + np.sin(4.0 * time)
    blank = Recording(name, time, {"u": u, "y": np.zeros(time.size)})
    item = Prepared.build(simulator.model, blank)
    segments = build_segments(simulator.model, [item], [(0, 0, time.size)], 8)
    start = rng.normal(size=(2, 1))
    y = outputs(simulator, Stepping("rk4", 8), segments, TRUTH, start)[0, :, 0]
    return Recording(name, time, {"u": u, "y": y + noise * rng.normal(size=time.size)})


def problem(simulator: Simulator, recordings: list[Recording], horizon: float) -> Problem:
    items = [Prepared.build(simulator.model, r) for r in recordings]
    stepping = Stepping("rk4", 2)
    segments = build_segments(simulator.model, items, cut(items, horizon), stepping.substeps)
    return Problem(simulator, stepping, segments, np.array([NOISE]))


def box(simulator: Simulator) -> tuple[np.ndarray, np.ndarray]:
    bounds = [p.bounds or (p.value, p.value) for p in simulator.model.parameters.values()]
    return np.array([b[0] for b in bounds]), np.array([b[1] for b in bounds])


def deviations(found: Fit) -> np.ndarray:
    """Standard deviations of the estimates, the starts projected out; noise is the scale."""
    return np.sqrt(np.diag(np.linalg.inv(found.normal_equations()[0].sum(0))))


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(parse_model(PENDULUM))


@pytest.mark.long
def test_parameters_are_recovered_inside_their_intervals(simulator: Simulator) -> None:
    rng = np.random.default_rng(0)
    active, scores = np.array([0, 1]), []
    for trial in range(8):
        recordings = [recorded(simulator, rng, f"{trial}{k}.csv", NOISE) for k in range(2)]
        task = problem(simulator, recordings, 2.0)
        found = fit(task, np.array(simulator.values()), active, box(simulator))
        assert found.converged and found.theta[2] == 1.0
        scores.append((found.theta[active] - TRUTH[active]) / deviations(found))
        # Residuals are white of size 1: samples less estimated numbers degrees of freedom.
        weight = task.segments.weights.sum()
        expected = weight - 2 - 2 * task.segments.number
        assert found.cost == pytest.approx(expected, abs=5 * np.sqrt(2 * expected))
    z = np.array(scores)
    assert np.abs(z).max() < 4.0
    # 16 standard normal draws: their mean square lies in (0.3, 2.2) with probability 0.99.
    assert 0.3 < np.mean(z**2) < 2.2


def test_exact_data_give_exact_values(simulator: Simulator) -> None:
    rng = np.random.default_rng(1)
    task = problem(simulator, [recorded(simulator, rng, "a.csv", 0.0)], 2.0)
    found = fit(task, np.array(simulator.values()), np.array([0, 1]), box(simulator))
    # The truth took four times finer steps of order four.
    np.testing.assert_allclose(found.theta, TRUTH, rtol=1e-4)


def test_bounds_hold_and_the_rest_adapts(simulator: Simulator) -> None:
    rng = np.random.default_rng(2)
    task = problem(simulator, [recorded(simulator, rng, "a.csv", NOISE)], 2.0)
    low, high = box(simulator)
    high[0] = 8.0
    start = np.array(simulator.values())
    found = fit(task, start, np.array([0, 1]), (low, high))
    assert found.theta[0] == pytest.approx(8.0, abs=1e-9)
    assert low[1] <= found.theta[1] <= high[1]
    fixed = fit(task, found.theta, np.array([1]), (low, high))
    assert found.cost == pytest.approx(fixed.cost, rel=1e-3)
    free = fit(task, start, np.array([0, 1]), box(simulator))
    assert free.cost < found.cost


def test_nothing_active_estimates_the_starts_alone(simulator: Simulator) -> None:
    rng = np.random.default_rng(3)
    task = problem(simulator, [recorded(simulator, rng, "a.csv", NOISE)], 1.0)
    found = fit(task, TRUTH, np.zeros(0, dtype=int), box(simulator))
    np.testing.assert_array_equal(found.theta, TRUTH)
    samples = task.segments.weights.sum()
    assert found.cost == pytest.approx(samples, rel=0.25)
    guess = outputs(simulator, task.stepping, task.segments, TRUTH, task.segments.guess)
    assert found.cost < np.sum(task.residual(guess) ** 2)


def test_missing_samples_carry_no_weight(simulator: Simulator) -> None:
    rng = np.random.default_rng(4)
    whole = recorded(simulator, rng, "a.csv", NOISE)
    y = whole.channel("y").copy()
    y[rng.random(y.size) < 0.3] = np.nan
    task = problem(simulator, [Recording("a.csv", whole.time, {**whole.channels, "y": y})], 2.0)
    found = fit(task, np.array(simulator.values()), np.array([0, 1]), box(simulator))
    assert np.abs((found.theta[:2] - TRUTH[:2]) / deviations(found)).max() < 4.0
    assert (found.residual[~np.isfinite(task.segments.outputs)] == 0).all()


def test_normal_equations_project_out_the_starts(simulator: Simulator) -> None:
    """Against the full least-squares problem of parameters and starts, written out."""
    rng = np.random.default_rng(5)
    task = problem(simulator, [recorded(simulator, rng, "a.csv", NOISE)], 2.0)
    found = fit(task, np.array(simulator.values()), np.array([0, 1]), box(simulator))
    y, by_theta, by_start = linearise(
        simulator, task.stepping, task.segments, found.theta, found.x0, np.array([0, 1])
    )
    assert y.shape == found.residual.shape
    weight, count = task.segments.weights / NOISE, task.segments.number
    columns = [(by_theta[k] * weight).ravel() for k in range(2)]
    for s in range(count):
        for i in range(2):
            alone = np.zeros_like(by_start[i])
            alone[..., s] = (by_start[i] * weight)[..., s]
            columns.append(alone.ravel())
    full = np.stack(columns, axis=1)
    covariance = np.linalg.inv(full.T @ full)[:2, :2]
    projected = found.normal_equations()[0].sum(0)
    np.testing.assert_allclose(np.linalg.inv(projected), covariance, rtol=1e-5)
