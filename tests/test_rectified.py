"""Sensors that read absolute values: signs, the evidence for them, and the answer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr.diagnosis import unsigned
from jaxsr.diagnosis.rectified import signed
from jaxsr.diagnosis.setup import prepare
from jaxsr.diagnosis.unsigned import one_sided, rectified_sensors
from jaxsr.models import Simulator, apply_edit, parse_model
from jaxsr.models.unfolding import likely_signs, signed_readings
from jaxsr.recordings import Recording

STEP, SAMPLES, NOISE = 0.03, 300, 5e-3
TIME = STEP * np.arange(SAMPLES)
SPRUNG = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - k*q - d*v"
[inertia]
v = { v = "m" }
[readings]
y = "READ"
[parameters]
m = { value = 1.5, bounds = [0.5, 4.0] }
k = { value = 5.0, bounds = [1.0, 20.0] }
d = { value = 0.8, bounds = [0.0, 3.0] }
"""
SIGNED = parse_model(SPRUNG.replace("READ", "q"))


def recorded(seed: int, read: Callable[[np.ndarray], np.ndarray], cubic: float = 0.0) -> Recording:
    """Drive a sprung mass (m 1.3, k 6, d 0.6) by three sines and read its position."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    drive = 2.0 * np.sin(np.outer(TIME, [1.1, 2.3, 3.7]) + phases).sum(axis=1)

    def rate(t: float, x: np.ndarray) -> list[float]:
        force = np.interp(t, TIME, drive) - 6.0 * x[0] - cubic * x[0] ** 3 - 0.6 * x[1]
        return [x[1], force / 1.3]

    run = solve_ivp(rate, (0.0, TIME[-1]), [0.3, 0.0], t_eval=TIME, rtol=1e-8, atol=1e-10)
    y = read(run.y[0]) + NOISE * rng.normal(size=SAMPLES)
    return Recording(f"run{seed}", TIME, {"u": drive, "y": y, "truth": run.y[0]})


def mistaken(found: np.ndarray, truth: np.ndarray) -> float:
    """Share of the power of readings that have the wrong sign."""
    return float(np.sum(truth[found * truth < 0.0] ** 2) / np.sum(truth**2))


def test_the_smoothest_signs_are_those_of_the_motion() -> None:
    truth = np.exp(-0.2 * TIME) * np.cos(3.0 * TIME)
    noise = 1e-3 * np.random.default_rng(0).normal(size=SAMPLES)
    values = np.abs(truth) + noise
    values[[40, 41, 100]] = np.nan
    assert mistaken(np.nan_to_num(likely_signs(TIME, values) * values), truth) < 1e-3


def test_a_driven_model_tells_the_sign_of_the_whole_motion() -> None:
    for seed in range(3):
        recording = recorded(seed, np.abs)
        reading = SIGNED.reading_terms["y"]
        found = signed_readings(SIGNED, recording, reading, recording.channels["y"])
        assert mistaken(found, recording.channels["truth"]) < 0.1


def test_a_sensor_without_signs_is_told_by_the_evidence() -> None:
    simulator = Simulator(SIGNED)
    runs = [recorded(0, np.abs), recorded(1, np.abs)]
    (sensor,) = rectified_sensors(simulator, prepare(SIGNED, runs))
    for before, after in zip(runs, signed(SIGNED, runs, (sensor,)), strict=True):
        assert mistaken(after.channels["y"], before.channels["truth"]) < 1e-3
    assert sensor.output == "y" and sensor.log_odds > 50.0
    edited = apply_edit(SIGNED, sensor.edit(SIGNED))
    assert edited.readings["y"] == "Abs(q)"


@pytest.mark.parametrize("asked", [0, 3])
def test_no_sensor_is_told_without_the_time_to_weigh_it(asked: int) -> None:
    """The time is over at once, or while the model as it is given is weighed."""
    left = iter([False] * asked)
    items = prepare(SIGNED, [recorded(0, np.abs), recorded(1, np.abs)])
    assert rectified_sensors(Simulator(SIGNED), items, lambda: next(left, True)) == ()


def test_readings_that_are_as_modelled_keep_their_signs(monkeypatch: pytest.MonkeyPatch) -> None:
    """They cost nothing: not even long recordings are thinned for them."""
    thinned = list[object]()
    monkeypatch.setattr(unsigned, "for_evidence", lambda _, items: thinned.append(items) or items)
    simulator = Simulator(SIGNED)
    assert not rectified_sensors(simulator, prepare(SIGNED, [recorded(1, lambda q: q)]))
    assert not rectified_sensors(simulator, prepare(SIGNED, [recorded(1, lambda q: q + 5.0)]))
    assert not thinned
    assert rectified_sensors(simulator, prepare(SIGNED, [recorded(1, np.abs)])) and thinned


@pytest.mark.parametrize(
    ("read", "looked_at"),
    [(np.abs, True), (np.square, True), (lambda y: y, False), (lambda y: y + 5.0, False)],
)
def test_only_readings_that_return_to_zero_from_one_side_are_looked_at(
    read: Callable[[np.ndarray], np.ndarray], looked_at: bool
) -> None:
    assert one_sided(read(np.sin(2.0 * TIME))) is looked_at


def test_states_are_read_off_absolute_values_with_their_signs() -> None:
    model = parse_model(SPRUNG.replace("READ", "Abs(q)"))
    recording = recorded(3, np.abs)
    (item,) = prepare(model, [recording])
    truth = recording.channels["truth"]
    assert np.sqrt(np.mean((item.states.values[:, 0] - truth) ** 2)) < 0.05 * np.std(truth)


@pytest.mark.slow
def test_the_answer_names_the_sensor_and_what_is_missing_beside_it() -> None:
    runs = [recorded(seed, np.abs, cubic=4.0) for seed in (4, 5)]
    held = recorded(6, np.abs, cubic=4.0)
    found = jaxsr.diagnose(Simulator(SIGNED), runs, held_out=[held], seed=0)
    assert found.verdict == "measurement"
    rows = {row["mechanism"]: row for row in found.findings}
    assert {"rectified", "cubic_stiffness"} <= rows.keys()
    assert rows["rectified"]["edit"] == {"readings.y": "Abs(q)"}
    assert found.model.readings["y"] == "Abs(q)"
    assert found.fit["held_out"]["explained"][-1] < 0.05
    assert any(row["check"] == "rectified" for row in found.document["data_checks"])
