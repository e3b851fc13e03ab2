"""Fixed steps of models: orders, stability, mass matrices, an impact."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from model_runs import ball, model, quiet, rolled
from scipy.integrate import solve_ivp

from jaxsr.models.rollout import Stepping
from jaxsr.models.stepping import METHODS, Step, factorised


@pytest.mark.parametrize(("method", "order"), [("rk4", 4), ("rodas3", 3)])
def test_convergence_order_on_a_forced_nonlinear_oscillator(method: Any, order: int) -> None:
    simulator = model("q v", 'q = "v"; v = "u - q**3 - 0.2*v + sin(t)"', inputs="u")
    u = np.array([0.0, 1.0, -1.0, 0.5, 2.0])
    recording = quiet(2.0, 0.5, u=u)
    exact = np.array([[0.3, 0.5]])
    for k, (begin, end) in enumerate(pairwise(recording.time)):  # the force bends at its samples

        def rate(t: float, x: np.ndarray, ends: tuple = (begin, end), k: int = k) -> list[float]:
            force = np.interp(t, ends, u[k : k + 2])
            return [x[1], force - x[0] ** 3 - 0.2 * x[1] + np.sin(t)]

        step = solve_ivp(rate, (begin, end), exact[-1], method="DOP853", rtol=1e-12, atol=1e-13)
        exact = np.vstack([exact, step.y[:, -1]])
    errors = [
        np.abs(rolled(simulator, recording, [0.3, 0.5], Stepping(method, n)) - exact).max()
        for n in (16, 32)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25), errors


def test_rodas3_is_l_stable() -> None:
    """One step of x' = -x/tau with h/tau to infinity must give zero, not -1 or growth."""

    def field(t: jax.Array, x: tuple, u: tuple) -> tuple:
        return (-x[0] * 1e12 + 0.0 * t,)

    with jax.enable_x64(True):
        step = Step(jnp.asarray(0.0), jnp.asarray(1.0), (), (), ())
        after = METHODS["rodas3"](field, (jnp.asarray(1.0),), step)
        assert abs(float(after[0])) < 1e-9
        for z in (-0.1, -1.0, -10.0, -1e3):
            small = METHODS["rodas3"](lambda t, x, u, z=z: (z * x[0] + 0.0 * t,), (1.0,), step)
            assert abs(float(small[0])) < 1.0


def test_elimination_agrees_with_numpy() -> None:
    rng = np.random.default_rng(0)
    for count in range(1, 6):
        half = rng.normal(size=(7, count, count))
        matrix = half @ half.transpose(0, 2, 1) + 0.5 * np.eye(count)
        right = rng.normal(size=(7, count))
        rows = [[matrix[:, i, j] for j in range(count)] for i in range(count)]
        found = np.stack(factorised(rows)(tuple(right.T)), axis=1)
        np.testing.assert_allclose(found, np.linalg.solve(matrix, right[..., None])[..., 0], 1e-8)


def test_mass_matrix_rates_agree_with_numpy() -> None:
    simulator = model(
        "q a b",
        'q = "a"; a = "f1 - q"; b = "f2*a"',
        "f1 = 2.0; f2 = 3.0",
        extra='[inertia]\na = { a = "2 + q**2", b = "cos(q)" }\nb = { a = "cos(q)", b = "3.0" }\n',
    )
    q, a, b = 0.4, -0.7, 1.1
    rates = simulator.rates(0.0, (q, a, b), (), simulator.values())
    matrix = np.array([[2 + q**2, np.cos(q)], [np.cos(q), 3.0]])
    expected = np.linalg.solve(matrix, [2.0 - q, 3.0 * a])
    np.testing.assert_allclose([float(r) for r in rates], [a, *expected], rtol=1e-6)


def test_mass_matrix_row_may_reach_a_state_without_a_row() -> None:
    simulator = model(
        "q v", 'q = "v"; v = "1.0 + 0*q"', extra='[inertia]\nv = { v = "2", q = "3" }\n'
    )
    rates = simulator.rates(0.0, (0.0, 0.5), (), ())
    assert [float(r) for r in rates] == pytest.approx([0.5, (1.0 - 3 * 0.5) / 2])


def test_double_pendulum_keeps_its_energy() -> None:
    simulator = model(
        "q1 q2 w1 w2",
        'q1 = "w1"; q2 = "w2"'
        '; w1 = "-w2**2*sin(q1 - q2) - 2*g*sin(q1)"; w2 = "w1**2*sin(q1 - q2) - g*sin(q2)"',
        "g = 9.81",
        extra='[inertia]\nw1 = { w1 = "2", w2 = "cos(q1 - q2)" }\n'
        'w2 = { w1 = "cos(q1 - q2)", w2 = "1" }\n',
    )
    recording = quiet(3.0, 0.01)
    methods: Any = (("rk4", 1e-6), ("rodas3", 1e-3))
    for method, tolerance in methods:
        x = rolled(simulator, recording, [1.0, 0.5, 0.0, 0.0], Stepping(method, 2))
        q1, q2, w1, w2 = x.T
        kinetic = w1**2 + 0.5 * w2**2 + w1 * w2 * np.cos(q1 - q2)
        energy = kinetic - 9.81 * (2 * np.cos(q1) + np.cos(q2))
        assert np.ptp(kinetic) > 5.0
        assert np.abs(energy - energy[0]).max() < tolerance * np.ptp(kinetic)


def test_bouncing_ball() -> None:
    """First impact at sqrt(2 h/g), then flights of 2 e^n sqrt(2 h/g)."""
    recording = quiet(1.5, 0.01)
    x = rolled(ball(), recording, [1.0, 0.0], Stepping("rk4", 4))
    t0 = np.sqrt(2 / 9.81)
    exact, begin, speed = np.empty(recording.time.size), -t0, np.sqrt(2 * 9.81)
    for i, t in enumerate(recording.time):
        while t > begin + 2 * speed / 9.81:
            begin, speed = begin + 2 * speed / 9.81, 0.8 * speed
        s = t - begin
        exact[i] = speed * s - 9.81 * s**2 / 2
    assert x[:, 0].min() > -0.02
    # Located by the secant inside a step of 2.5 ms: g h^2/8 = 8e-6 m, carried on by the bounces.
    np.testing.assert_allclose(x[:, 0], exact, atol=1e-3)
