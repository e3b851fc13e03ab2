"""Parameters that leave no trace together: what bounds tell in the place of data."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.judging.refine import Ground, refine
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.uncertainty import unseen
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

# A mass on a spring whose foot is moved: only k/M and c/M show.
SHAKEN = """
[model]
states = ["q", "v"]
inputs = ["foot"]
outputs = ["y"]
[equations]
q = "v"
v = "-k*(q - foot) - c*v"
[inertia]
v = { v = "M" }
[readings]
y = "q"
[parameters]
M = { value = 2.0, bounds = [1.0, 4.0] }
k = { value = 50.0, bounds = [20.0, 120.0] }
c = { value = 1.5, bounds = [0.5, 4.0] }
"""


def shaken(seed: int) -> Arena:
    """An arena with data of M = 2.1 f, k = 55 f and c = 1.4 f, the same for every factor f."""
    t = np.arange(800) * 0.01

    def foot(s: float | np.ndarray) -> np.ndarray:
        return 0.1 * np.sin(3.0 * np.asarray(s)) + 0.05 * np.sin(7.0 * np.asarray(s) + 1.0)

    def rate(s: float, x: np.ndarray) -> list[float]:
        return [x[1], (-55.0 * (x[0] - foot(s)) - 1.4 * x[1]) / 2.1]

    q = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-11).y[0]
    noise = 1e-4 * np.random.default_rng(seed).standard_normal(t.size)
    model = parse_model(SHAKEN)
    data = [Prepared.build(model, Recording("a.csv", t, {"foot": foot(t), "y": q + noise}))]
    super_model = SuperModel.build(model, [])
    simulator = Simulator(model)
    return build_arena(super_model, data, Stepping("rk4", 1), 1.0, np.array([1e-4]), simulator)


def test_the_direction_that_leaves_no_trace_is_the_common_factor() -> None:
    arena = shaken(0)
    fit = enter(arena, (), neutral_values(arena.super_model)).fit
    blind = unseen(arena, fit)
    assert blind.directions.shape == (3, 1)
    ray = fit.theta / np.linalg.norm(fit.theta)
    direction = blind.directions[:, 0] / np.linalg.norm(blind.directions)
    assert abs(ray @ direction) == pytest.approx(1.0, abs=1e-6)
    # uniform priors on M, k and c, their mean precision that of one factor on all three
    width = np.array([3.0, 100.0, 3.5])
    variance = 1.0 / np.mean(12.0 * fit.theta**2 / width**2)
    np.testing.assert_allclose(np.diag(blind.covariance), fit.theta**2 * variance, rtol=1e-5)


def test_a_step_towards_the_given_values_shows_the_same() -> None:
    arena = shaken(1)
    given = neutral_values(arena.super_model)
    # begun far off, an estimate stays far off along the ray
    entry = enter(arena, (), 1.6 * given)
    assert np.all(entry.fit.theta > 1.3 * given)
    moved = entry.fit.theta + unseen(arena, entry.fit).step(entry.fit.theta - given)
    assert np.all(np.abs(moved / given - 1.0) < 0.15)
    again = enter(arena, (), moved, entry.fit.path, max_iterations=1, near=True)
    assert again.fit.cost == pytest.approx(entry.fit.cost, rel=1e-6)


def test_intervals_hold_a_factor_that_no_data_tell() -> None:
    arena = shaken(2)
    entry = enter(arena, (), neutral_values(arena.super_model))
    estimate = refine(Ground(arena, arena.prepared, (1.0,), None), entry)
    for factor in (0.6, 0.8, 1.25, 1.6):
        truth = factor * np.array([2.1, 55.0, 1.4])
        assert np.all(np.abs(estimate.theta - truth) < estimate.half)
    assert np.all(estimate.told < 0.02 * estimate.theta)  # the data tell ratios well
