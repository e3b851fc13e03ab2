"""Roll-outs of recordings: starts, values by file, compilation, derivatives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from model_runs import friction, model, quiet

from jaxsr.models import Simulator, model_text, parse_model
from jaxsr.models.free_run import free_run
from jaxsr.models.rollout import Stepping, _outputs_jit, linearise, outputs
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.models.states import estimate_states, output_table
from jaxsr.recordings import Recording


def test_initial_numbers_hold_at_the_first_sample_alone() -> None:
    simulator = model("q v", 'q = "v"; v = "-q"', extra='[initial]\nq = 0.5\nv = "free"\n')
    time = np.arange(200) * 0.05
    rng = np.random.default_rng(0)
    recording = Recording("a.csv", time, {"y": 0.6 * np.cos(time) + 1e-3 * rng.normal(size=200)})
    estimate = estimate_states(simulator.model, recording)
    assert estimate.values[0, 0] == 0.5
    assert np.abs(estimate.values[1:, 0] - 0.6 * np.cos(time[1:])).max() < 0.02
    item = Prepared.build(simulator.model, recording)
    segments = build_segments(simulator.model, [item], [(0, 0, 100), (0, 100, 200)], 1)
    assert segments.guess[0, 0] == 0.5 and not segments.free_start[0, 0]
    assert segments.free_start[0, 1] and segments.free_start[1].all()
    assert segments.guess[0, 1] == pytest.approx(0.6 * np.cos(5.0), abs=0.02)


@pytest.mark.long
def test_per_recording_values_hold_in_their_file_alone() -> None:
    simulator = model(
        "x", 'x = "-k*x"', "k = 1.0", extra='[per_recording]\nk = { "b.csv" = 2.0 }\n'
    )
    time = np.arange(50) * 0.02
    items = []
    for name in ("a.csv", "b.csv"):
        recording = Recording(name, time, {"y": np.ones(50)})
        items.append(Prepared.build(simulator.model, recording))
    segments = build_segments(simulator.model, items, [(0, 0, 50), (1, 0, 50)], 4)
    y = outputs(simulator, Stepping("rk4", 4), segments, np.array([1.0]), np.ones((1, 2)))
    np.testing.assert_allclose(y[0, :, 0], np.exp(-time), atol=1e-8)
    np.testing.assert_allclose(y[0, :, 1], np.exp(-2 * time), atol=1e-8)
    run = free_run(simulator, items[1].recording, np.ones(1))
    np.testing.assert_allclose(run.states[:, 0], np.exp(-2 * time), atol=1e-7)
    assert output_table(simulator.model, items[0].recording).shape == (50, 1)


def test_a_second_call_compiles_nothing() -> None:
    simulator = friction()
    recording = quiet(1.0, 0.02, u=np.ones(51), y=np.zeros(51))
    item = Prepared.build(simulator.model, recording)
    segments = build_segments(simulator.model, [item], [(0, 0, 25), (0, 25, 50)], 2)
    x0 = np.zeros((2, 2))
    outputs(simulator, Stepping("rk4", 2, (0.1,)), segments, np.array([0.5]), x0)
    programs: Any = _outputs_jit
    before = programs._cache_size()
    outputs(simulator, Stepping("rk4", 2, (0.2,)), segments, np.array([0.7]), x0 + 1.0)
    again = Simulator(parse_model(model_text(simulator.model)))
    outputs(again, Stepping("rk4", 2, (0.2,)), replace(segments, guess=x0), np.array([0.7]), x0)
    assert programs._cache_size() == before


def test_parameters_in_another_order_are_another_program() -> None:
    """Parameters are passed by position: a kept program of the other order would swap them."""
    time = np.arange(20) * 0.05
    item_of, ends = Recording("a.csv", time, {"y": np.ones(20)}), []
    for order in ("a = 1.0; b = 3.0", "b = 3.0; a = 1.0"):
        simulator = model("x", 'x = "-a*x + b"', order)
        item = Prepared.build(simulator.model, item_of)
        segments = build_segments(simulator.model, [item], [(0, 0, 20)], 1)
        y = outputs(simulator, Stepping(), segments, np.array(simulator.values()), np.ones((1, 1)))
        ends.append(y[0, -1, 0])
    exact = 3.0 - 2.0 * np.exp(-time[-1])
    np.testing.assert_allclose(ends, exact, rtol=1e-6)


def test_derivatives_against_finite_differences() -> None:
    simulator = model(
        "q v", 'q = "v"; v = "u - k*sin(q) - c*v*Abs(v)"', "k = 4.0; c = 0.3; e = 1.0", "u"
    )
    time = np.arange(40) * 0.05
    recording = Recording("a.csv", time, {"u": np.sin(time), "y": np.zeros(40)})
    item = Prepared.build(simulator.model, recording)
    segments = build_segments(simulator.model, [item], [(0, 0, 20), (0, 20, 40)], 2)
    theta, x0 = np.array(simulator.values()), np.array([[0.3, -0.2], [0.5, 1.0]])
    methods: Any = ("rk4", "rodas3")
    for method in methods:
        stepping = Stepping(method, 2)
        y, by_theta, by_start = linearise(
            simulator, stepping, segments, theta, x0, np.array([1, 0])
        )
        np.testing.assert_allclose(y, outputs(simulator, stepping, segments, theta, x0), atol=1e-12)
        h = 1e-5
        for row, index in enumerate((1, 0)):
            step = np.zeros(3)
            step[index] = h
            up = outputs(simulator, stepping, segments, theta + step, x0)
            down = outputs(simulator, stepping, segments, theta - step, x0)
            np.testing.assert_allclose(by_theta[row], (up - down) / (2 * h), atol=1e-7)
        for row in range(2):
            step = np.zeros((2, 1))
            step[row] = h
            up = outputs(simulator, stepping, segments, theta, x0 + step)
            down = outputs(simulator, stepping, segments, theta, x0 - step)
            np.testing.assert_allclose(by_start[row], (up - down) / (2 * h), atol=1e-7)
