"""Starts that no sensor tells: what they cost, and where they are sought."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import input_samples, prepare, state_scale
from jaxsr.diagnosis.shooting import enter as entering
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.carried import starts_told
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import told_starts
from jaxsr.diagnosis.shooting.integration import choose_stepping
from jaxsr.models import Simulator, parse_model
from jaxsr.models.least_squares import Fit
from jaxsr.recordings import Recording

SHAKER = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = [{outputs}]
[equations]
q = "v"
v = "(u - c*v - k*q)/m"
[readings]
{readings}
[parameters]
m = {{ value = 1.6, bounds = [0.5, 5.0] }}
c = {{ value = 0.7, bounds = [0.2, 2.2] }}
k = {{ value = 32.0, bounds = [10.0, 95.0] }}
"""
ACCELEROMETER = SHAKER.format(outputs='"acc"', readings='acc = "d(v)"')
FRICTION, NOISE = 4.8, 0.04


def shaken(seed: int, friction: float = FRICTION) -> Recording:
    """The shaker with dry friction that its model leaves out; q and d(v) are read."""
    rng, time = np.random.default_rng(seed), 0.01 * np.arange(300)
    line, phase = rng.uniform(2.0, 15.0, 4), rng.uniform(0.0, 6.0, 4)
    u = 8.0 * np.sin(np.multiply.outer(time, line) + phase).sum(1)

    def rates(t: float, x: Any) -> Any:
        force = np.interp(t, time, u) - 0.7 * x[1] - 32.0 * x[0]
        return [x[1], (force - friction * np.tanh(x[1] / 5e-4)) / 1.6]

    found = solve_ivp(
        rates, (0.0, time[-1]), [0.0, 0.0], "LSODA", time, rtol=1e-8, atol=1e-10, max_step=0.01
    )
    acc = np.array([rates(t, x)[1] for t, x in zip(time, found.y.T, strict=True)])
    noise = rng.normal(size=(2, time.size))
    read = {"y": found.y[0] + 1e-3 * noise[0], "acc": acc + NOISE * noise[1], "exact": found.y[0]}
    return Recording(f"{seed}.csv", time, {"u": u, **read})


def arena_of(text: str, seconds: float) -> Arena:
    """An arena with Coulomb friction as its one candidate."""
    model = parse_model(text)
    prepared = prepare(model, [shaken(0)])
    offered = force_candidates(
        model, state_scale(model, prepared), None, input_samples(model, prepared)
    )
    friction = [c for c in offered if c.mechanism == "coulomb_friction"][:1]
    super_model = SuperModel.build(model, friction)
    simulator = Simulator(super_model.model)
    stepping = choose_stepping(simulator, prepared, neutral_values(super_model))
    return build_arena(super_model, prepared, stepping, seconds, np.full(1, NOISE), simulator)


def test_an_accelerometer_alone_tells_no_start() -> None:
    for readings, told in (('acc = "d(v)"', False), ('acc = "v"', True), ('acc = "q + v"', False)):
        model = parse_model(SHAKER.format(outputs='"acc"', readings=readings))
        assert starts_told(SuperModel.build(model, []), prepare(model, [shaken(0)])) is told


@pytest.mark.slow
def test_starts_follow_the_run_of_what_was_estimated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starts from the run of a model without friction lead its estimate astray."""
    arena = arena_of(ACCELEROMETER, 0.6)
    given = neutral_values(arena.super_model)
    found = enter(arena, (0,), given)
    size = np.sqrt(found.fit.cost / np.count_nonzero(found.fit.residual))
    assert size < 1.3
    assert found.fit.theta[-1] == pytest.approx(FRICTION / 1.6, rel=0.02)
    monkeypatch.setattr(entering, "carried_on", lambda arena, estimate, own, fit: fit)
    assert enter(arena, (0,), given).fit.cost > found.fit.cost


def fit_of(by_start: np.ndarray, cost: float = 1000.0) -> Fit:
    shape = by_start.shape[1:]
    residual = np.random.default_rng(0).normal(size=shape)
    residual *= np.sqrt(cost / np.sum(residual**2))
    none = np.zeros((2, *shape))
    start = np.zeros(by_start.shape[::3])
    return Fit(np.zeros(2), start, cost, residual, np.arange(2), none, by_start, True)


def test_a_start_counts_where_it_shows() -> None:
    """Ten segments of three states: one is never seen, one in the first four segments alone."""
    by_start = np.ones((3, 2, 25, 10))
    by_start[1] = 0.0
    by_start[2, :, :, 4:] = 1e-14
    assert told_starts(fit_of(by_start)) == 10 + 4
    assert told_starts(fit_of(np.zeros((3, 2, 25, 10)))) == 0
    assert told_starts(fit_of(np.zeros((0, 2, 25, 10)))) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "readings",
    [
        'y = "q"\nacc = "(-k*q + u - c*v)/m"',
        'y = "q"\nacc = "u/m - c*v/m - k*q/m"',
    ],
)
def test_friction_beside_an_accelerometer_blames_no_sensor(readings: str) -> None:
    model = parse_model(SHAKER.format(outputs='"y", "acc"', readings=readings))
    found = jaxsr.diagnose(jaxsr.Simulator(model), [shaken(0), shaken(1)], budget=120.0)
    assert found.verdict == "structure"
    assert found.findings[0]["mechanism"] == "coulomb_friction"
    assert all(f["family"] != "measurement" for f in found.findings)
    assert "d(v)" in found.model.readings["acc"]


@pytest.mark.slow
@pytest.mark.parametrize(("step", "wrong"), [(2e-3, False), (0.04, False), (2e-3, True)])
def test_an_ordinary_encoder_is_no_finding(step: float, wrong: bool) -> None:
    text = SHAKER.format(outputs='"y"', readings='y = "q"')
    model = parse_model(text.replace("value = 32.0", "value = 42.0") if wrong else text)
    recordings = []
    for seed in (0, 1):
        moved = shaken(seed, 0.0)
        y = step * np.round(moved.channels["exact"] / step)
        recordings.append(Recording(moved.name, moved.time, {**moved.channels, "y": y}))
    found = jaxsr.diagnose(jaxsr.Simulator(model), recordings, budget=90.0)
    assert found.verdict == ("parameter" if wrong else "nothing")
    assert [f["site"] for f in found.findings[:1]] == (["parameter:k"] if wrong else [])
    assert all(f["family"] != "measurement" for f in found.findings)
    assert any(c["check"] == "quantisation" for c in found.document["data_checks"])
