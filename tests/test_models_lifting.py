"""Segments linearised about a path: derivatives, orders, corners, unmeasured states."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxsr.expressions import evaluate, parse
from jaxsr.expressions.slopes import evaluate_with_slopes
from jaxsr.models import Simulator, parse_model
from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field
from jaxsr.models.lifting import closed, linear, simulated
from jaxsr.models.relaxed import relaxed
from jaxsr.models.rollout import Stepping, linearise
from jaxsr.models.segments import Prepared, Segments, build_segments, cut
from jaxsr.models.sensitivity import advanced, condensed
from jaxsr.recordings import Recording

FORMULAS = (
    "x*y - y**3/(1 + x**2)",
    "sin(x*y) + cos(x)**2*exp(-y)",
    "tanh(3*x)*sqrt(y**2 + 1)",
    "log(x**2 + 2)*Abs(y)**1.7",
    "Max(x, y)*atan2(x, y + 3)",
    "Min(x**2, 0.5)/(y**2 + 0.3)",
)
COUPLED = parse_model(
    """
[model]
states = ["a", "va", "b", "vb"]
inputs = ["u"]
outputs = ["ya", "yb"]
[equations]
a = "va"
va = "u - k*a - c*va*Abs(va) - g*sin(b)"
b = "vb"
vb = "-m*b**3 - g*sin(a)"
[inertia]
va = { va = "2.0", vb = "i*cos(a - b)" }
vb = { va = "i*cos(a - b)", vb = "1.5" }
[readings]
ya = "a"
yb = "s*b + a"
[parameters]
k = { value = 9.0, bounds = [1.0, 90.0] }
c = { value = 0.4, bounds = [0.0, 9.0] }
g = { value = 0.7, bounds = [0.0, 9.0] }
m = { value = 3.0, bounds = [0.0, 9.0] }
i = { value = 0.4, bounds = [0.0, 0.9] }
s = { value = 1.2, bounds = [0.5, 2.0] }
lag = { value = 0.013, bounds = [0.0, 0.1] }
[delays]
u = "lag"
"""
)
RUB = parse_model(
    """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - 2.0*q - F*sign(v)"
[readings]
y = "q"
[parameters]
F = { value = 3.0, bounds = [0.0, 5.0] }
"""
)
HIDDEN = parse_model(
    """
[model]
states = ["q", "v", "z", "w"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - 6*q - 0.3*v + 3*z"
z = "w"
w = "3*q - 20*z - 0.4*w"
[readings]
y = "q"
"""
)


def segments_of(
    simulator: Simulator, rng: np.random.Generator, substeps: int, horizon: float | None = 1.0
) -> Segments:
    """Cut a recording of smooth signals into segments."""
    time = np.arange(241) * 0.02
    waves = np.sin(np.multiply.outer(rng.uniform(1.0, 6.0, 3), time) + rng.uniform(0, 6, (3, 1)))
    channels = {"u": 4.0 * waves[0], "y": waves[1], "ya": waves[1], "yb": waves[2]}
    items = [Prepared.build(simulator.model, Recording("waves.csv", time, channels))]
    return build_segments(simulator.model, items, cut(items, horizon), substeps)


@pytest.mark.long
@pytest.mark.parametrize("formula", FORMULAS)
def test_slopes_are_the_derivatives_that_jax_takes(formula):
    term, rng = parse(formula), np.random.default_rng(1)
    x, y = rng.normal(size=(2, 400))
    value, slopes = evaluate_with_slopes(term, {"x": x, "y": y}, ("x", "y"))
    np.testing.assert_allclose(value, evaluate(term, {"x": x, "y": y}, "numpy"), rtol=1e-13)
    with jax.enable_x64(True):

        def total(x: jax.Array, y: jax.Array) -> jax.Array:
            return jnp.sum(evaluate(term, {"x": x, "y": y}, "jax"))

        expected = jax.grad(total, argnums=(0, 1))(jnp.asarray(x), jnp.asarray(y))
    for name, slope in zip("xy", expected, strict=True):
        np.testing.assert_allclose(slopes[name], slope, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_closed_segments_and_their_derivatives_are_those_of_the_rollout(seed):
    """Mass matrix, cubes, a delayed input: against derivatives through a compiled simulation."""
    simulator, rng = Simulator(COUPLED), np.random.default_rng(seed)
    segments, stepping = segments_of(simulator, rng, 2, 0.5), Stepping("rk4", 2)
    theta, active = np.array(simulator.values()), np.arange(6)
    path = closed(simulator, stepping, segments, theta, segments.course)
    assert path is not None
    found = linear(simulator, stepping, segments, theta, path, active)
    y, by_theta, by_start = linearise(simulator, stepping, segments, theta, segments.guess, active)
    seen = np.isfinite(segments.outputs)
    np.testing.assert_allclose(found.outputs[seen], y[seen], rtol=1e-8, atol=1e-10)
    for ours, theirs in ((found.by_theta, by_theta), (found.by_start, by_start)):
        size = np.abs(theirs).max()
        np.testing.assert_allclose(ours[:, seen], theirs[:, seen], atol=1e-8 * size)


def test_the_derivative_by_a_delay_is_the_difference_of_two_delays():
    simulator, rng = Simulator(COUPLED), np.random.default_rng(5)
    segments, stepping = segments_of(simulator, rng, 2, 0.5), Stepping("rk4", 2)
    theta, number = np.array(simulator.values()), list(COUPLED.parameters).index("lag")

    def run(delay: float) -> np.ndarray:
        values = theta.copy()
        values[number] = delay
        return simulated(simulator, stepping, segments, values, segments.guess)

    path = closed(simulator, stepping, segments, theta, segments.course)
    slope = linear(simulator, stepping, segments, theta, path, [number]).by_theta[0]
    expected = (run(0.014) - run(0.012)) / 0.002
    np.testing.assert_allclose(slope, expected, atol=2e-2 * np.abs(expected).max())


def advanced_once(equations: str, parameters: str, x: list[float], h: float, steps: int, method):
    """Integrate one trajectory over `steps` samples, each of one step."""
    names = ", ".join(f'"{n}"' for n in ("x", "z")[: len(x)])
    simulator = Simulator(
        parse_model(
            f'[model]\nstates = [{names}]\noutputs = ["y"]\n[equations]\n{equations}\n'
            f'[readings]\ny = "x"\n[parameters]\n{parameters}\n'
        )
    )
    field = Field(simulator, simulator.values())
    to = Directions(simulator.model.states, {}, {}, ())
    state = [np.array([[value]]) for value in x]
    tangent = np.eye(len(x))
    for k in range(steps):
        nothing = Stages(np.zeros((3, 0, 1, 1)), {})
        time, length = np.array([[k * h]]), np.array([[[h]]])
        state, slopes = advanced(field, to, method, state, time, length, lambda _, s=nothing: s)
        tangent = slopes[:, :, 0, 0] @ tangent
    return np.array([s[0, 0] for s in state]), tangent


@pytest.mark.parametrize(("method", "order"), [("rk4", 4), ("rodas3", 3)])
def test_one_sample_maps_converge_with_their_order_and_so_do_their_tangents(method, order):
    """Van der Pol's oscillator."""
    equations = 'x = "z"\nz = "mu*(1 - x**2)*z - x"'
    runs = [
        advanced_once(equations, "mu = 1.5", [2.0, 0.3], 1.0 / n, n, method) for n in (16, 32, 512)
    ]
    for k in (0, 1):
        coarse, fine = (np.abs(runs[i][k] - runs[2][k]).max() for i in (0, 1))
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.4)


def test_the_implicit_map_forgets_at_once_what_dies_out_at_once():
    """L-stability: x' = -1e9 (x - 1) over one step."""
    end, tangent = advanced_once('x = "-rate*(x - 1)"', "rate = 1e9", [5.0], 0.1, 1, "rodas3")
    assert end[0] == pytest.approx(1.0, abs=1e-6)
    assert abs(tangent[0, 0]) < 1e-6


def test_a_path_closes_through_sticking_and_equals_the_run_from_sample_to_sample():
    simulator, rng = Simulator(RUB), np.random.default_rng(2)
    segments = segments_of(simulator, rng, 2, None)
    stepping = Stepping("rodas3", 2, (1e-3,))
    theta = np.array(simulator.values())
    path = closed(simulator, stepping, segments, theta, segments.course)
    assert path is not None
    other = segments.course + rng.normal(size=segments.course.shape)
    other[:, 0] = segments.course[:, 0]
    again = closed(simulator, stepping, segments, theta, other)
    assert again is not None
    np.testing.assert_allclose(again, path, atol=1e-7)
    found = linear(simulator, stepping, segments, theta, path, [0])
    assert np.abs(found.shift).max() < 1e-7
    slow = np.abs(path[1]) < 2e-3
    assert 0.02 < slow.mean() < 0.9  # it does stick
    assert closed(simulator, stepping, segments, theta, other, lambda: True) is None


@pytest.mark.long
@pytest.mark.parametrize("window", [8, 64])
def test_windows_that_newton_closes_lead_where_single_steps_lead(window, monkeypatch):
    monkeypatch.setattr("jaxsr.models.lifting.CLOSING_LONG", 1)  # all of it by windows
    simulator, rng = Simulator(RUB), np.random.default_rng(4)
    segments, stepping = segments_of(simulator, rng, 2, None), Stepping("rodas3", 2, (1e-3,))
    theta = np.array(simulator.values())
    monkeypatch.setattr("jaxsr.models.ground.MOST_WINDOW", window)
    path = closed(simulator, stepping, segments, theta, segments.course)
    monkeypatch.setattr("jaxsr.models.lifting.SHORT", 10**9)
    single = closed(simulator, stepping, segments, theta, segments.course)
    assert path.shape[1] > 1.5 * window
    np.testing.assert_allclose(path, single, atol=1e-7)


def test_products_of_maps_carry_derivatives_and_defects():
    rng = np.random.default_rng(3)
    slopes, defects = rng.normal(size=(2, 3, 4, 2)), rng.normal(size=(2, 4, 2))
    spread, shift = condensed(slopes, defects)
    dx0, dp = rng.normal(size=(2, 2)), rng.normal()
    x = dx0.copy()
    for k in range(4):
        x = np.einsum("ijs,js->is", slopes[:, :2, k], x) + slopes[:, 2, k] * dp + defects[:, k]
    told = np.einsum("sij,js->is", spread[4, :, :, :2], dx0) + spread[4, :, :, 2].T * dp
    np.testing.assert_allclose(told + shift[:, 4], x, rtol=1e-12)


def test_a_state_without_a_sensor_is_told_by_the_equations():
    """A resonator inside; its path is found from the host's reading alone."""
    simulator, stepping = Simulator(HIDDEN), Stepping("rk4", 2)
    time = np.arange(301) * 0.02
    u = 3.0 * np.sin(2.2 * time) + 2.0 * np.cos(4.1 * time)
    blank = Recording("a.csv", time, {"u": u, "y": np.zeros(time.size)})
    items = [Prepared.build(HIDDEN, blank)]
    truth = build_segments(HIDDEN, items, [(0, 0, time.size)], 2)
    start = np.array([[0.2], [0.0], [-0.3], [0.5]])
    begun = truth.course.copy()
    begun[:, 0] = start
    path = closed(simulator, stepping, truth, np.zeros(0), begun)
    assert path is not None
    rng = np.random.default_rng(7)
    y = path[0, :, 0] + 1e-3 * rng.normal(size=time.size)
    items = [Prepared.build(HIDDEN, Recording("b.csv", time, {"u": u, "y": y}))]
    segments = build_segments(HIDDEN, items, [(0, 0, time.size)], 2)
    found = relaxed(simulator, stepping, segments, np.zeros(0), np.array([1e-3]))
    for state in range(4):
        wrong = np.sqrt(np.mean((found[state] - path[state]) ** 2))
        assert wrong < 0.03 * np.std(path[state])
