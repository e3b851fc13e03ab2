"""Memories that are not at rest when the recordings begin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from unrested_plants import PLANTS, SAMPLES, Plant

from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.mechanisms.memory import actuator_lags
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.memory_starts import START, memory_starts, start_of
from jaxsr.models import Simulator
from jaxsr.models.driven import driven_states, known_states
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared

HEATER = PLANTS["heater"]


def lagging(plant: Plant) -> SuperModel:
    lag = next(c for c in actuator_lags(plant.model, plant.step) if c.site == plant.site)
    return SuperModel.build(plant.model, [lag])


def test_a_memory_fades_from_where_it_stood() -> None:
    """w' = (u - w)/tau at constant u: w = u + (w0 - u)*exp(-t/tau), dw/dw0 = exp(-t/tau)."""
    super_model = lagging(HEATER)
    (recording, _), simulator = HEATER.recordings(0), Simulator(super_model.model)
    steady = {**recording.channels, "P": np.full(SAMPLES, 50.0)}
    item = Prepared.build(HEATER.model, replace(recording, channels=steady))
    theta = neutral_values(super_model)
    theta[list(super_model.model.parameters).index(super_model.names[0]["tau"])] = 80.0
    path, _, by_start = driven_states(simulator, item, theta, (), np.array([20.0]))
    faded = np.exp(-item.time / 80.0)
    np.testing.assert_allclose(path[:, 0], 50.0 - 30.0 * faded, rtol=1e-6)
    np.testing.assert_allclose(by_start[:, 0, 0], faded, rtol=1e-6)
    np.testing.assert_array_equal(known_states(super_model.model, item, theta)[:, -1], 50.0)


def test_segments_of_a_recording_share_its_start() -> None:
    """Five segments a recording, of which the later four begin where the first one leads."""
    super_model = lagging(HEATER)
    prepared = tuple(Prepared.build(HEATER.model, r) for r in HEATER.recordings(1))
    noise = HEATER.noise * np.array([np.sqrt(np.mean([p.outputs.var() for p in prepared]))])
    simulator = Simulator(super_model.model)
    arena = build_arena(super_model, prepared, Stepping("rk4", 1), 120.0, noise, simulator)
    entry = enter(arena, (0,), neutral_values(super_model))
    assert arena.problem.segments.number == 10
    used = arena.problem.segments.weights.sum()
    assert entry.fit.cost / used == pytest.approx(1.0, abs=0.2)
    values = super_model.own_values(0, entry.fit.theta)
    assert values["tau"] == pytest.approx(60.0, rel=0.02)
    # The body's temperature in every segment, and the heater's in the first of each recording,
    # which margins are washed out of where later ones are judged.
    assert entry.starts <= 12


def test_a_start_is_where_the_readings_and_what_is_believed_meet() -> None:
    """Against brute force: the posterior mean over starts of body and heater, on a linear plant."""
    super_model = lagging(HEATER)
    item = Prepared.build(HEATER.model, HEATER.recordings(2)[0])
    simulator, count = Simulator(super_model.model), 4
    names = list(super_model.model.parameters)
    values = {"k": 1.7, "C": 120.0, super_model.names[0]["tau"]: 60.0}
    theta = super_model.switched((0,), np.array([values.get(n, 0.0) for n in names]))
    (found,) = memory_starts(simulator, Stepping(), [item], theta, [count], np.ones(1))
    rest = known_states(super_model.model, item, theta)[:, -1:]

    def readings(body: float, heater: float) -> np.ndarray:
        time, x = item.time[:count], np.array([body, heater])
        course = [x]
        for k in range(count - 1):
            h, (p, ta) = time[k + 1] - time[k], item.inputs[k]
            dp, dta = (item.inputs[k + 1] - item.inputs[k]) / h

            def rate(t, y, p=p, dp=dp, ta=ta, dta=dta):
                return np.array(
                    [(y[1] - 1.7 * (y[0] - ta - dta * t)) / 120.0, (p + dp * t - y[1]) / 60.0]
                )

            a = rate(0.0, x)
            b = rate(h / 2, x + h / 2 * a)
            c = rate(h / 2, x + h / 2 * b)
            d = rate(h, x + h * c)
            x = x + h / 6 * (a + 2 * b + 2 * c + d)
            course.append(x)
        return np.array(course)[:, 0]

    base = readings(0.0, 0.0)
    columns = np.stack([readings(1.0, 0.0) - base, readings(0.0, 1.0) - base], 1)
    y = item.outputs[:count, 0] - base
    best, left, *_ = np.linalg.lstsq(columns, y, rcond=None)
    noise = float(left[0]) / (count - 2)
    spread = start_of(rest.T[..., None])[0]
    assert spread == pytest.approx(START * rest.var())
    precision = columns.T @ columns / noise + np.diag([0.0, 1.0 / spread])
    pull = columns.T @ y / noise + np.array([0.0, rest[0, 0] / spread])
    expected = np.linalg.solve(precision, pull)[1]
    assert abs(expected - best[1]) > 0.01  # what is believed counts here
    assert found[0] == pytest.approx(expected, rel=1e-4)


def _asked(name: str, seed: int) -> None:
    plant = PLANTS[name]
    given, held = plant.recordings(seed), plant.recordings(seed + 100, 1)
    found = diagnose(Simulator(plant.model), given, held_out=held, budget=1000.0)
    (finding,) = found.document["findings"]
    assert (finding["mechanism"], finding["site"]) == (plant.mechanism, plant.site)
    assert finding["probability"] > 0.9
    for constant, truth in plant.constants.items():
        assert finding["parameters"][constant]["value"] == pytest.approx(truth, rel=0.1)
    # In free run down to little more than the noise, 0.005 of the spread.
    assert found.document["fit"]["held_out"]["explained"][-1] < 0.04
    assert found.document["fit"]["train"]["explained"][-1] < 0.04


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(PLANTS))
def test_memories_are_named_wherever_they_begin(name: str) -> None:
    _asked(name, 0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 5))
@pytest.mark.parametrize("name", sorted(PLANTS))
def test_memories_are_named_wherever_they_begin_over_seeds(name: str, seed: int) -> None:
    _asked(name, seed)
