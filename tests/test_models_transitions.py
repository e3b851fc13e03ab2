"""Derivatives of Runge-Kutta steps carried backwards: differences, and parts of the samples."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.models import Simulator, parse_model, transitions
from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field
from jaxsr.models.sensitivity import advanced

MODEL = parse_model(
    """
[model]
states = ["a", "va", "b"]
inputs = ["u"]
outputs = ["y"]
[equations]
a = "va"
va = "u - k*a - c*va*Abs(va) + b"
b = "-(b - u*va)/tau"
[readings]
y = "a"
[parameters]
k = { value = 9.0, bounds = [1.0, 90.0] }
c = { value = 0.4, bounds = [0.0, 9.0] }
tau = { value = 0.3, bounds = [0.01, 9.0] }
"""
)
NAMES = tuple(MODEL.parameters)
STEPS, SEGMENTS, SUBSTEPS, H = 37, 3, 3, 0.05


def advance(method: str, x: np.ndarray, theta: np.ndarray, slopes: bool = True):
    """Advance random samples, a parameter of them with a value per segment."""
    simulator, n = Simulator(MODEL), len(MODEL.states)
    inputs = np.random.default_rng(1).normal(size=(SUBSTEPS, 3, 1, STEPS, SEGMENTS))
    values = [theta[0], theta[1] * np.linspace(0.5, 2.0, SEGMENTS), theta[2]]
    field = Field(simulator, values, active=NAMES)
    columns = {name: n + k for k, name in enumerate(NAMES)}
    to = Directions(MODEL.states, columns, {}, MODEL.inputs) if slopes else None
    length = np.full((STEPS, SUBSTEPS, SEGMENTS), H)
    ends, by = advanced(
        field,
        to,
        method,
        list(x),
        np.zeros((STEPS, SEGMENTS)),
        length,
        lambda number: Stages(inputs[number], {}),
    )
    return np.stack(ends), by


def sample() -> tuple[np.ndarray, np.ndarray]:
    """Random states and the given parameters."""
    x = np.random.default_rng(0).normal(size=(len(MODEL.states), STEPS, SEGMENTS))
    return x, np.array([9.0, 0.4, 0.3])


@pytest.mark.parametrize("method", ["rk4", "rodas3"])
def test_the_derivatives_are_central_differences_by_states_and_parameters(method):
    """Of several substeps; a parameter with values of its own keeps their ratio."""
    x, theta = sample()
    _, by = advance(method, x, theta)
    n, e = x.shape[0], 1e-5
    ratio = np.linspace(0.5, 2.0, SEGMENTS)
    for k in range(n + theta.size):
        moved = [np.zeros_like(x), np.zeros_like(theta)]
        moved[0 if k < n else 1][k if k < n else k - n] = e
        up, down = (
            advance(method, x + s * moved[0], theta + s * moved[1], False)[0] for s in (1, -1)
        )
        expected = (up - down) / (2 * e)
        found = by[:, k] * (ratio if k == n + 1 else 1.0)
        np.testing.assert_allclose(found, expected, atol=2e-7 * max(np.abs(expected).max(), 1.0))


@pytest.mark.parametrize("method", ["rk4", "rodas3"])
def test_the_parts_of_the_samples_taken_together_do_not_matter(method, monkeypatch):
    x, theta = sample()
    whole = advance(method, x, theta)[1]
    monkeypatch.setattr(transitions, "MOST", 11)  # not a divisor of the samples
    np.testing.assert_array_equal(advance(method, x, theta)[1], whole)
