"""What could stand in the place of a chosen mechanism."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest
from diagnosis_systems import RAIL, STIFF
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.integration import choose_stepping
from jaxsr.diagnosis.judging.refine import Ground, refine
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.memory import memory_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.diagnosis.search.choice import alone
from jaxsr.diagnosis.search.exchange import exchange
from jaxsr.diagnosis.search.nesting import INSIDE, continued, simplified
from jaxsr.diagnosis.search.peaks import peaked
from jaxsr.models import Model, Simulator, apply_edit, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

SWING = """
[model]
states = ["q", "v"]
inputs = ["torque"]
outputs = ["y"]
[equations]
q = "v"
v = "b*torque - c*v - g*sin(q)"
[readings]
y = "q"
[parameters]
b = { value = 1.2, bounds = [0.3, 3.0] }
c = { value = 0.4, bounds = [0.05, 2.0] }
g = { value = 30.0, bounds = [10.0, 90.0] }
"""
SCALE = {"q": np.linspace(-2.0, 2.0, 21), "v": np.linspace(-2.0, 2.0, 21)}
MASS = parse_model(STIFF)


def force(model: Model, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    simulator = Simulator(model)
    with jax.enable_x64(True):
        return np.asarray(simulator.forces(0.7, (q, v), (u,), simulator.values())[1])


@pytest.mark.parametrize("richer", sorted(INSIDE))
def test_a_richer_law_is_the_simpler_one_at_the_constants_it_starts_from(richer: str) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-2.0, 2.0, (3, 200))
    offered = force_candidates(MASS, SCALE)
    simpler, starts = INSIDE[richer]
    inner = next(c for c in offered if c.mechanism == simpler)
    variants = [c for c in offered if c.mechanism == richer]
    assert variants
    for candidate in variants:
        size = rng.uniform(0.1, 5.0)
        own = {p.name: p.neutral for p in candidate.parameters}
        own |= {n: size if isinstance(at, str) else at for n, at in starts.items()}
        (name,) = (p.name for p in inner.parameters)
        both = [
            apply_edit(MASS, c.edit(MASS, {n: n for n in values}, values))
            for c, values in ((candidate, own), (inner, {name: size}))
        ]
        one, other = (force(model, *points) for model in both)
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_the_simpler_law_inside_a_richer_one_starts_as_large() -> None:
    offered = force_candidates(MASS, SCALE)
    for richer, (simpler, starts) in INSIDE.items():
        pair = [next(c for c in offered if c.mechanism == name) for name in (simpler, richer)]
        beside = next(c for c in offered if c.mechanism == "constant_force")
        super_model = SuperModel.build(MASS, [*pair, beside])
        order, theta = list(super_model.model.parameters), neutral_values(super_model)
        theta[order.index(super_model.names[2]["F0"])] = 0.7
        for own, at in starts.items():
            theta[order.index(super_model.names[1][own])] = 2.5 if isinstance(at, str) else at
        ((members, start),) = simplified(super_model, (1, 2), theta)
        assert members == (0, 2)
        assert list(super_model.own_values(0, start).values()) == [2.5]
        assert super_model.own_values(2, start) == {"F0": 0.7}
        np.testing.assert_array_equal(
            start[super_model.index(1)], neutral_values(super_model)[super_model.index(1)]
        )
        # and back again: the richer law starts where the simpler one stands
        again = continued(super_model, start, 0, 1, starts)
        np.testing.assert_allclose(again[super_model.index(1)], theta[super_model.index(1)])
        assert list(simplified(super_model, (0, 2), theta)) == []


def test_a_law_that_a_bad_start_has_spoilt_is_found_from_the_law_inside_it(monkeypatch) -> None:
    """A mass on a rail whose friction falls from 4 N at rest to 2 N, as exp(-(v/0.4)^2)."""
    monkeypatch.setattr("jaxsr.diagnosis.search.exchange.RIVAL_PATIENCE", 60.0)
    t = np.arange(1500) * 0.01
    tones = np.array([0.7, 1.9, 3.1])

    def push(s: float | np.ndarray) -> np.ndarray:
        return 12.0 * np.sin(np.multiply.outer(s, tones)).sum(-1)

    def rate(s: float, x: np.ndarray) -> list[float]:
        friction = (2.0 + 2.0 * np.exp(-((x[1] / 0.4) ** 2))) * np.tanh(x[1] / 1e-3)
        return [x[1], (push(s) - 3.0 * x[1] - friction) / 2.0]

    q = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], "LSODA", t, rtol=1e-8, atol=1e-10).y[0]
    noise = 1e-4 * np.random.default_rng(0).standard_normal(t.size)
    model = parse_model(RAIL)
    prepared = [Prepared.build(model, Recording("a.csv", t, {"force": push(t), "y": q + noise}))]
    offered = force_candidates(model, SCALE)
    names = ("coulomb_friction", "stribeck_friction", "constant_force")
    chosen = [next(c for c in offered if c.mechanism == name) for name in names]
    super_model = SuperModel.build(model, chosen)
    simulator = Simulator(super_model.model)
    theta = neutral_values(super_model)
    stepping = choose_stepping(simulator, prepared, theta)
    arena = build_arena(super_model, prepared, stepping, 1.0, np.array([1e-3]), simulator)
    null = enter(arena, (), theta)
    coulomb = enter(arena, (0,), theta, null.fit.path)
    spoilt = theta.copy()
    for name, value in {"Fc": 0.0, "Fs": 60.0, "vs": 0.02}.items():
        spoilt[list(super_model.model.parameters).index(super_model.names[1][name])] = value
    ((number, start),) = peaked(arena, coulomb, 0, [1])
    assert number == 1
    assert 0.2 < start["vs"] < 0.8
    assert start["Fc"] < start["Fs"] < 3.0 * start["Fc"]
    bad = enter(arena, (1,), spoilt, null.fit.path, max_iterations=1)
    assert bad.fit.cost > coulomb.fit.cost
    found = {e.members: e for e in exchange(arena, coulomb, [null, coulomb, bad], lambda: False)}
    stribeck = found[1,]
    assert stribeck.fit.cost < 0.2 * coulomb.fit.cost
    # From a larger set that found the law, the law alone is found as well.
    both = enter(arena, (1, 2), stribeck.fit.theta, stribeck.fit.path, near=True)
    case: Any = SimpleNamespace(search=SimpleNamespace(exhausted=False))
    better = {e.members: e for e in alone(arena, both, [null, coulomb, bad], case)}
    assert better[1,].fit.cost < 1.01 * stribeck.fit.cost
    # All parts are estimated, though time ends while the first of them is led out of corners.
    search = SimpleNamespace(exhausted=False)

    def ending(arena: Arena, entry: Entry, stop: object) -> tuple[Entry, None]:
        search.exhausted = True
        return entry, None

    monkeypatch.setattr("jaxsr.diagnosis.search.choice.out_of_corners", ending)
    case = SimpleNamespace(search=search)
    assert {e.members for e in alone(arena, both, [null], case)} == {(1,), (2,)}
    refined = refine(Ground(arena, tuple(prepared), (1.0,), None), stribeck)
    for name, truth in {"Fc": 2.0, "Fs": 4.0, "vs": 0.4}.items():
        value, half = refined.interval(name)
        assert abs(value - truth) < half < 0.05 * truth


def test_a_delay_of_several_samples_is_found_from_the_lag_that_imitates_it(monkeypatch) -> None:
    """A pendulum turning over, read 0.055 s late; what a linearisation promises is left out."""
    monkeypatch.setattr("jaxsr.diagnosis.search.exchange.RIVAL_PATIENCE", 60.0)
    monkeypatch.setattr("jaxsr.diagnosis.search.exchange.expected", lambda *args: [])
    t = np.arange(1500) * 0.01
    tones = np.array([0.9, 2.3, 4.1])

    def push(s: float | np.ndarray) -> np.ndarray:
        return 14.0 * np.sin(np.multiply.outer(s, tones)).sum(-1)

    def rate(s: float, x: np.ndarray) -> list[float]:
        return [x[1], push(s) - 30.0 * np.sin(x[0]) - 0.4 * x[1]]

    free = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], "RK45", rtol=1e-9, dense_output=True)
    q = free.sol(np.maximum(t - 0.055, 0.0))[0]
    y = q + 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    model = parse_model(SWING)
    prepared = [Prepared.build(model, Recording("a.csv", t, {"torque": push(t), "y": y}))]
    offered = [
        *memory_candidates(model, SCALE, 0.01),
        *timing_candidates(model, 0.01, float(t[-1])),
    ]
    chosen = [
        next(c for c in offered if c.mechanism == name) for name in ("actuator_lag", "sensor_delay")
    ]
    super_model = SuperModel.build(model, chosen)
    simulator, theta = Simulator(super_model.model), neutral_values(super_model)
    stepping = choose_stepping(simulator, prepared, theta)
    arena = build_arena(super_model, prepared, stepping, 1.0, np.array([1e-3]), simulator)
    null = enter(arena, (), theta)
    lag = enter(arena, (0,), theta, null.fit.path)
    assert lag.fit.cost < 0.5 * null.fit.cost
    found = {e.members: e for e in exchange(arena, lag, [null, lag], lambda: False)}
    delay = found[1,]
    assert delay.fit.cost < 0.1 * lag.fit.cost
    (tau,) = delay.fit.theta[super_model.index(1)]
    assert abs(tau - 0.055) < 1e-3
