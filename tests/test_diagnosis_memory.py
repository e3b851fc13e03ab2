"""Mechanisms that bring states, delays or a clock: neutral, estimated, and told apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_systems import ARM
from memory_plants import GIVEN, PLANTS, STEP, alone, arena_of, winner

from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.memory import (
    RESOLVED,
    STEPS,
    dissipates,
    memory_candidates,
    overflows,
)
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.diagnosis.setup import state_scale
from jaxsr.diagnosis.shooting.arena import Arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.reduced import reduce
from jaxsr.diagnosis.shooting.uncertainty import half_widths, sensitivities
from jaxsr.expressions import parse, to_numpy
from jaxsr.models import Model, Simulator, apply_edit, parse_model, read_model
from jaxsr.models.rollout import Stepping, outputs
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.models.writing import model_text
from jaxsr.recordings import Recording

RIVALS = ("actuator_lag", "sensor_delay", "viscous_damping", "coulomb_friction")


def driven_arm(seed: int = 0) -> tuple[Model, Prepared]:
    """The two-link arm with wild inputs and readings; nothing has to fit."""
    model, rng = read_model(ARM), np.random.default_rng(seed)
    time = np.arange(200) * 0.01
    waves = np.sin(np.outer(time, rng.uniform(1, 9, 4)) + rng.uniform(0, 6, 4))
    roles = [*model.inputs, *model.outputs]
    columns = {model.column(r): w for r, w in zip(roles, waves.T, strict=True)}
    return model, Prepared.build(model, Recording("arm.csv", time, columns))


def all_candidates(model: Model, item: Prepared) -> list[Candidate]:
    step, duration = item.recording.sample_time, float(item.time[-1])
    found = memory_candidates(model, state_scale(model, [item]), step)
    return [*found, *timing_candidates(model, step, duration)]


def run(model: Model, item: Prepared) -> np.ndarray:
    rows, simulator = [(0, 0, 90), (0, 90, 200)], Simulator(model)
    segments = build_segments(model, [item], rows, 2)
    theta = np.array(simulator.values())
    return outputs(simulator, Stepping("rk4", 2), segments, theta, segments.guess)


def test_the_table_of_mechanisms_is_complete():
    found = {c.label for c in all_candidates(*driven_arm())}
    for axis in ("w1", "w2"):
        assert {f"hysteresis@equation:{axis}", f"hidden_mode@equation:{axis}"} <= found
        assert f"drift@equation:{axis}" in found
    for k in "12":
        assert {f"actuator_lag@input:tau{k}", f"input_delay@input:tau{k}"} <= found
        assert {f"{m}@output:y{k}" for m in ("sensor_delay", "clock_skew", "drift")} <= found


def test_neutral_values_are_the_given_model():
    """Every mechanism at once at two coupled axes: a free run differs by rounding."""
    model, item = driven_arm()
    once = {c.label: c for c in all_candidates(model, item)}
    combined = SuperModel.build(model, once.values()).model
    assert len(combined.driven) == 2 + 2 * (1 + 2)
    np.testing.assert_allclose(run(combined, item), run(model, item), rtol=1e-11, atol=1e-11)


def pendulum() -> tuple[Model, Prepared]:
    recording = PLANTS["nothing"].record(0)
    part = {name: signal[:200] for name, signal in recording.channels.items()}
    return GIVEN, Prepared.build(GIVEN, Recording("a.csv", recording.time[:200], part))


def mechanisms() -> list[Candidate]:
    return all_candidates(*pendulum())


@pytest.mark.long
@pytest.mark.parametrize("number", range(len(mechanisms())))
def test_each_candidate_is_neutral_then_simulates_as_its_edit(number):
    """The edit at values away from neutral and the super-model with its switch on agree."""
    model, item = pendulum()
    candidate = mechanisms()[number]
    super_model = SuperModel.build(model, [candidate])
    np.testing.assert_allclose(run(super_model.model, item), run(model, item), atol=1e-12)
    values = {}
    for spec in candidate.parameters:
        away = 0.3 * (spec.high if spec.high < 1e11 else 3.0)
        values[spec.name] = away if spec.coefficient else spec.neutral
    names = candidate.names(model.symbols)
    edited = apply_edit(model, candidate.edit(model, names, values))
    assert parse_model(model_text(edited)) == replace(edited, name=edited.name)
    assert not edited.driven
    own = super_model.model
    full = super_model.names[0]
    changed = {full[n]: replace(own.parameters[full[n]], value=v) for n, v in values.items()}
    theta = super_model.switched([0], neutral_values(super_model))
    order = list(own.parameters)
    shifted = replace(own, parameters={**own.parameters, **changed})
    for name, value in zip(order, theta, strict=True):
        if name not in changed:
            old = shifted.parameters[name]
            shifted = replace(
                shifted, parameters={**shifted.parameters, name: replace(old, value=float(value))}
            )
    begin = replace(edited, initial={**edited.initial, **{s: "driven" for s in edited.states[2:]}})
    found = run(shifted, item)
    np.testing.assert_allclose(found, run(begin, item), rtol=1e-9, atol=1e-9)
    assert np.abs(found - run(model, item)).max() > 1e-6


def test_an_input_is_replaced_in_definitions_and_never_inside_other_names():
    model = parse_model(
        """
[model]
states = ["x"]
inputs = ["u"]
outputs = ["y"]
[definitions]
push = "2*u + u0"
[equations]
x = "push + u*x - u2"
[readings]
y = "x"
[parameters]
u0 = 1.0
u2 = 3.0
"""
    )
    lag = next(c for c in memory_candidates(model, {}, 0.01) if c.mechanism == "actuator_lag")
    edit = lag.edit(model, lag.names(model.symbols), {"tau": 0.1})
    assert edit.changes["definitions.push"] == "2*uf + u0"
    assert edit.changes["equations.x"] == "push + uf*x - u2"
    assert edit.changes["equations.uf"] == "(u - uf)/tau"
    assert edit.changes["model.states"] == ("x", "uf")
    assert "parameters.on_tau" not in edit.changes


def test_two_lags_in_a_row_are_two_lags():
    lag = next(c for c in mechanisms() if c.mechanism == "actuator_lag")
    once = apply_edit(GIVEN, lag.edit(GIVEN, lag.names(GIVEN.symbols), {"tau": 0.1}))
    twice = apply_edit(once, lag.edit(once, lag.names(once.symbols), {"tau": 0.2}))
    assert twice.states == ("q", "v", "uf", "uf_u")
    assert twice.equations["uf_u"] == "(u - uf_u)/tau_u"
    assert twice.equations["uf"] == "(uf_u - uf)/tau"


def test_a_level_overflows_into_another():
    model = parse_model(
        """
[model]
states = ["x1", "x2"]
inputs = ["u"]
outputs = ["y"]
[equations]
x1 = "u - k*sqrt(x1)"
x2 = "k*sqrt(x1) - k*sqrt(x2)"
[readings]
y = "x2"
[parameters]
k = { value = 0.1, bounds = [0.0, 1.0] }
"""
    )
    scale = {s: np.linspace(1.0, 9.0, 21) for s in model.states}
    upper, lower = sites_of(model, scale)
    # What leaves the lower one cannot run up.
    assert all([s for s, _ in c.terms] == ["x2"] for c in overflows(lower, 0.5))
    found = list(overflows(upper, 0.5))
    assert all(c.parameters[0].high == 200.0 and c.parameters[0].hard for c in found)
    lost = [c for c in found if [s for s, _ in c.terms] == ["x1"]]
    partly = [c for c in found if any(p.name == "part" for p in c.parameters)]
    led = next(c for c in found if len(c.terms) == 2 and c not in partly)
    assert len(found) == 3 * len(lost) == 3 * len(partly)
    edges = [c.parameters[1].neutral for c in lost]
    assert len(edges) == 4 and edges == sorted(edges) and edges[-1] < 9.0
    edited = apply_edit(model, led.edit(model, led.names(model.symbols), {"ko": 2.0, "xo": 7.0}))
    assert edited.equations["x2"].endswith("+ ko*Max(x1 - xo, 0)")
    values = {"ko": 2.0, "xo": 7.0, "part": 0.3}
    edited = apply_edit(model, partly[0].edit(model, partly[0].names(model.symbols), values))
    assert edited.equations["x2"].endswith("+ part*ko*Max(x1 - xo, 0)")


def test_hysteresis_stores_and_loses_what_is_put_in():
    """Power in = rate of what is stored + loss, and the loss is a loss where b >= abs(g)."""
    rng = np.random.default_rng(5)
    loop = next(c for c in mechanisms() if c.mechanism == "hysteresis")
    rate, force = parse(loop.states[0].equation.format_map(Plain())), loop.terms[0][1]
    assert force == "- {kz}*{z}"
    for _ in range(300):
        kz, b = rng.uniform(0.1, 5.0, 2)
        g, z, v = rng.uniform(-2.0, 2.0, 3)
        known = {"a": 1.0, "b": b, "g": g, "z": z, "v": v}
        loss = kz * z * v - kz * z * float(to_numpy(rate)(known))
        np.testing.assert_allclose(loss, kz * z**2 * abs(v) * (b + g * np.sign(v * z)), atol=1e-12)
        if abs(g) <= b:
            assert loss >= 0.0 and dissipates(known)
        if abs(g) > 1.6 * b:
            assert not dissipates(known)


class Plain(dict):
    """Names in braces stand for themselves."""

    def __missing__(self, key: str) -> str:
        return key


def estimate(arena: Arena, mechanism: str) -> dict[str, tuple[float, float]]:
    """Constants of one mechanism with the half-widths of their intervals."""
    candidates = arena.super_model.candidates
    number = next(i for i, c in enumerate(candidates) if c.mechanism == mechanism)
    entry = enter(arena, (number,), neutral_values(arena.super_model))
    half = dict(zip(entry.fit.active, half_widths(arena, entry.fit), strict=True))
    order = list(arena.super_model.model.parameters)
    places = {own: order.index(n) for own, n in arena.super_model.names[number].items()}
    return {own: (entry.fit.theta[j], half.get(j, 0.0)) for own, j in places.items()}


PLANTED = [
    ("actuator_lag", {"tau": 0.06}),
    ("sensor_delay", {"tau": 0.043}),
    ("hysteresis", {"kz": 20.0, "b": 6.0, "g": 3.0}),
]


@pytest.mark.parametrize(("mechanism", "truth"), PLANTED, ids=[p[0] for p in PLANTED])
def test_constants_are_found(mechanism, truth):
    """Within 1.5 half-widths (six constants at 95 %: one misses in a quarter of the draws)."""
    moving = replace(PLANTS[mechanism], before=3.0)
    found = estimate(arena_of(moving.record(0), (mechanism,)), mechanism)
    for name, value in truth.items():
        estimated, half = found[name]
        assert 0.0 < half < 0.7 * value
        assert abs(estimated - value) < max(1.5 * half, 0.05 * value)


@pytest.mark.long
@pytest.mark.parametrize("plant", ["nothing", *RIVALS])
def test_the_planted_mechanism_wins(plant):
    arena = arena_of(PLANTS[plant].record(0), RIVALS)
    assert winner(arena, alone(arena)) == plant


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["nothing", *RIVALS, "hysteresis"])
def test_the_planted_mechanism_wins_for_most_seeds(plant):
    names = (*RIVALS, "hysteresis") if plant == "hysteresis" else RIVALS
    right = 0
    for seed in range(5):
        arena = arena_of(PLANTS[plant].record(10 + seed), names)
        right += winner(arena, alone(arena)) == plant
    assert right >= 4


@pytest.mark.slow
@pytest.mark.parametrize(("mechanism", "truth"), PLANTED, ids=[p[0] for p in PLANTED])
def test_intervals_hold_the_truth(mechanism, truth):
    """20 recordings: 95 % intervals hold 80 to 100 % of the truths."""
    held = []
    for seed in range(20):
        found = estimate(arena_of(PLANTS[mechanism].record(50 + seed), (mechanism,)), mechanism)
        held += [abs(found[n][0] - v) <= found[n][1] for n, v in truth.items()]
    assert np.mean(held) >= 0.8


def test_time_constants_stay_resolved():
    lag = next(c for c in mechanisms() if c.mechanism == "actuator_lag").parameters[0]
    assert lag.low == pytest.approx(RESOLVED * STEP) and lag.low < lag.neutral < lag.high


@pytest.mark.long
@pytest.mark.parametrize("samples", [0.3, 1.0, 3.0])
def test_a_lag_shorter_than_a_sample_is_estimated(samples):
    """RK4 would be unstable below 0.36 samples; sets with a lag take shorter steps."""
    plant = replace(PLANTS["actuator_lag"], lag=samples * STEP)
    arena = arena_of(plant.record(7), ("actuator_lag",))
    assert reduce(arena.problem, arena.super_model, (0,)).problem.stepping.substeps >= STEPS
    tau, half = estimate(arena, "actuator_lag")["tau"]
    assert abs(tau - plant.lag) < 1.5 * half and half < 0.3 * plant.lag


def test_effects_beside_a_lag_shorter_than_a_sample_are_finite():
    """All candidates at once take the steps that the chosen lag needs, or it would overflow."""
    plant = replace(PLANTS["actuator_lag"], lag=0.25 * STEP)
    arena = arena_of(plant.record(7), ("actuator_lag", "viscous_damping"))
    labels = [c.mechanism for c in arena.super_model.candidates]
    number = labels.index("actuator_lag")
    start, place = neutral_values(arena.super_model), arena.super_model.index(number)[0]
    start[place] = plant.lag
    entry = enter(arena, (number,), start)
    assert entry.fit.theta[place] < 0.35 * STEP
    told = sensitivities(arena, entry.fit, exclude=(number,))
    assert len(told.error) == 2 and np.all((told.error > 1e-4) & (told.error < 0.1))
