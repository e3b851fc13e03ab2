"""Jumps of the state: located inside steps, with exact derivatives, and bounded in number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_runs import ball, model

from jaxsr.models import Parameter, Simulator
from jaxsr.models.lifting import closed, linear
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, Segments, build_segments
from jaxsr.models.simulation import simulate_to_csv
from jaxsr.recordings import Recording

TIME = np.arange(151) * 0.01
FORCED = model(
    "q v",
    'q = "v"; v = "-g - d*v + u"',
    "g = { value = 9.8, bounds = [1, 20] }; e = { value = 0.7, bounds = [0, 1] }\n"
    "d = { value = 0.1, bounds = [0, 1] }; h = { value = 0.05, bounds = [0, 1] }",
    inputs="u",
    extra='[[events]]\nwhen = "q - h"\ndirection = -1\nreset = { v = "-e*v" }\n',
)


def segments_of(simulator: Simulator, time: np.ndarray, substeps: int = 1) -> Segments:
    channels = {"y": 0.5 + 0.0 * time, "u": 0.3 * np.sin(5.0 * time)}
    prepared = [Prepared.build(simulator.model, Recording("a", time, channels))]
    return build_segments(simulator.model, prepared, [(0, 0, time.size)], substeps)


def run(
    simulator: Simulator, segments: Segments, x0: list[float], theta: np.ndarray, method: str
) -> np.ndarray:
    path = segments.course.copy()
    path[:, 0, 0] = x0
    found = closed(
        simulator,
        Stepping(method, segments.length.shape[1]),
        segments,
        theta,
        path,  # type: ignore[arg-type]
    )
    assert found is not None
    return found[..., 0]


def bounced(time: np.ndarray, q: float, e: float, g: float) -> np.ndarray:
    """Height of a ball dropped from `q`: parabolas between impacts, in closed form."""
    height, begin, v = np.empty(time.size), 0.0, 0.0
    while True:
        flight = (v + np.sqrt(v**2 + 2.0 * g * q)) / g
        here = (time >= begin) & (time <= begin + flight)
        s = time[here] - begin
        height[here] = q + v * s - 0.5 * g * s**2
        begin, v, q = begin + flight, e * (g * flight - v), 0.0
        if begin > time[-1]:
            return height


@pytest.mark.parametrize("method", ["rk4", "rodas3"])
def test_a_ball_bounces_as_in_closed_form(method: str) -> None:
    simulator = ball()
    segments = segments_of(simulator, TIME)
    theta = np.array([9.81, 0.8])
    path = run(simulator, segments, [1.0, 0.0], theta, method)
    # both methods are exact along a parabola
    np.testing.assert_allclose(path[0], bounced(TIME, 1.0, 0.8, 9.81), atol=1e-9)


@pytest.mark.parametrize(("method", "substeps"), [("rk4", 1), ("rk4", 3), ("rodas3", 2)])
def test_derivatives_go_through_jumps(method: str, substeps: int) -> None:
    segments = segments_of(FORCED, TIME, substeps)
    theta, start = np.array(FORCED.values()), [1.0, 0.0]
    path = run(FORCED, segments, start, theta, method)[..., None]
    stepping = Stepping(method, substeps)  # type: ignore[arg-type]
    found = linear(FORCED, stepping, segments, theta, path, range(4))
    assert np.abs(found.shift).max() < 1e-9 * np.abs(path).max()  # the path is a simulation
    eps = 1e-6
    for k in range(6):
        change, x = np.zeros(4), [np.array(start), np.array(start)]
        if k < 4:
            change[k] = eps
        else:
            x[0][k - 4], x[1][k - 4] = start[k - 4] + eps, start[k - 4] - eps
        up = run(FORCED, segments, list(x[0]), theta + change, method)[0]
        down = run(FORCED, segments, list(x[1]), theta - change, method)[0]
        own = found.by_theta[k, 0, :, 0] if k < 4 else found.by_start[k - 4, 0, :, 0]
        # rounding over eps, and the few steps of Newton's method to a crossing
        np.testing.assert_allclose(own, (up - down) / (2 * eps), atol=2e-6)


@pytest.mark.long
def test_a_ball_that_comes_to_rest_stays_on_the_floor() -> None:
    simulator = ball()
    time = np.arange(601) * 0.01
    theta = np.array([9.81, 0.5])
    path = run(simulator, segments_of(simulator, time), [0.5, 0.0], theta, "rk4")
    assert np.abs(path[0, 200:]).max() < 1e-3 and np.abs(path[1, -1]) < 1e-3
    assert path[0].min() > -1e-6


@pytest.mark.long
def test_a_simulated_ball_comes_to_rest() -> None:
    text = ball().model
    at = replace(
        text, initial={"q": 1.0, "v": 0.0}, parameters={"g": Parameter(9.81), "e": Parameter(0.6)}
    )
    table = simulate_to_csv(Simulator(at), duration=2.5, dt=0.01)
    height = table["y"].to_numpy()
    early = table["t"].to_numpy() < 1.5
    exact = bounced(table["t"].to_numpy()[early], 1.0, 0.6, 9.81)
    np.testing.assert_allclose(height[early], exact, atol=1e-8)
    assert np.abs(height[200:]).max() < 1e-4  # 1.8 s are all its bounces


def test_a_start_below_the_surface_by_the_noise_bounces_at_once() -> None:
    simulator = ball()
    segments = segments_of(simulator, TIME)
    segments.course[0] = np.linspace(0.0, 1.0, TIME.size)[:, None]
    path = run(simulator, segments, [-1e-4, -2.0], np.array([9.81, 0.8]), "rk4")
    assert path[1, 1] == pytest.approx(1.6 - 9.81 * 0.01)
    far = run(simulator, segments, [-0.5, -2.0], np.array([9.81, 0.8]), "rk4")
    assert far[1, 1] == pytest.approx(-2.0 - 9.81 * 0.01)  # beyond: it has passed long ago


def test_events_of_time_and_of_both_directions() -> None:
    switch = model(
        "q",
        'q = "1"',
        "",
        extra='[[events]]\nwhen = "t - 0.333"\nreset = { q = "q + 2" }\n'
        '[[events]]\nwhen = "q - 3"\ndirection = 0\nreset = { q = "1" }\n',
    )
    path = run(switch, segments_of(switch, TIME), [0.0], np.zeros(0), "rk4")
    t = TIME
    expected = np.where(t < 0.333, t, np.where(t < 1.0, t + 2.0, t))
    apart = np.abs(t - 1.0) > 1e-6  # where it jumps at a sample, either side is right
    np.testing.assert_allclose(path[0][apart], expected[apart], atol=1e-9)


@pytest.mark.long
def test_rows_that_are_missing_do_not_change_a_simulation() -> None:
    dropped = Simulator(replace(FORCED.model, initial={"q": 1.0, "v": 0.0}))
    time = np.arange(301) * 0.01
    kept = (time < 0.6) | (time > 2.0)

    def heights(rows: np.ndarray) -> np.ndarray:
        recording = Recording("a", time[rows], {"u": 0.0 * time[rows]})
        return simulate_to_csv(dropped, recording)["y"].to_numpy()

    whole, part = heights(np.ones(time.size, bool)), heights(kept)
    np.testing.assert_allclose(part, whole[kept], atol=1e-5)
