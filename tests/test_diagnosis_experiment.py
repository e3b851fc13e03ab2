"""The next experiment: an excitation chosen by simulation tells two explanations apart."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from diagnosis_systems import CART

from jaxsr._progress import Budget
from jaxsr.diagnosis.explaining import experiment
from jaxsr.diagnosis.explaining.experiment import _shapes, best_experiment
from jaxsr.diagnosis.judging.weights import Alternative
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.reduced import lean
from jaxsr.models import Simulator, parse_model
from jaxsr.models.lifting import closed
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.recordings import Recording

CUBIC = Candidate(
    "cubic_stiffness",
    "elastic",
    "equation:v",
    (ParameterSpec("k3", None),),
    "",
    terms=(("v", "- {k3}*q**3"),),
)
DRAG = Candidate(
    "quadratic_drag",
    "dissipative",
    "equation:v",
    (ParameterSpec("kd", None, low=0.0),),
    "",
    terms=(("v", "- {kd}*v*Abs(v)"),),
)


def parts_of(noise: float) -> tuple[Any, Any]:
    """A cart on a cubic spring, recorded in small motion, and both explanations of it."""
    given = parse_model(CART)
    super_model = SuperModel.build(given, [CUBIC, DRAG])
    simulator = Simulator(super_model.model)
    rng, time = np.random.default_rng(4), np.arange(600) * 0.02
    u = 4.0 * np.sin(1.7 * time) + 3.0 * np.sin(2.9 * time + 1.0)
    blank = Recording("a.csv", time, {"u": u, "y": np.zeros(600)})
    item = Prepared.build(given, blank)
    segments = build_segments(super_model.model, [item], [(0, 0, 600)], 2)
    theta = neutral_values(super_model)
    theta[super_model.index(0)[0]] = 6.0
    stepping = Stepping("rk4", 2)
    path = closed(simulator, stepping, segments, theta, segments.course)
    assert path is not None
    y = path[0, :, 0] + noise * rng.normal(size=600)
    prepared = [Prepared.build(given, Recording("a.csv", time, {"u": u, "y": y}))]
    arena = build_arena(super_model, prepared, stepping, 2.0, np.array([noise]), simulator)
    chosen, rival = (enter(arena, (k,), neutral_values(super_model)) for k in (0, 1))
    case = SimpleNamespace(simulator=Simulator(given), prepared=tuple(prepared), budget=Budget())
    return SimpleNamespace(case=case, arena=arena, chosen=chosen), rival


def test_signals_have_size_one():
    for _, shape in _shapes(np.linspace(0.0, 5.0, 300)):
        assert np.abs(shape).max() == pytest.approx(1.0, abs=0.01)


def test_an_excitation_is_found_that_two_springs_answer_differently():
    parts, rival = parts_of(2e-3)
    found = best_experiment(parts, rival, parts.chosen)
    assert found is not None
    assert found.separation > 3.0  # standard deviations a sample
    assert " on u " in found.text
    itself = best_experiment(parts, parts.chosen, parts.chosen)
    assert itself is not None
    assert itself.separation < 1e-6


STRIBECK = Candidate(
    "stribeck_friction",
    "dissipative",
    "equation:v",
    (ParameterSpec("Fs", None, low=0.0),),
    "",
    terms=(("v", "- {Fs}*exp(-v**2)*sign(v)"),),
)


def asked_for(monkeypatch, probabilities: list[dict[int, float]]) -> tuple[str | None, list[int]]:
    """Return what is asked for and the rivals that were simulated, for each finding's rivals."""
    given = parse_model(CART)
    arena = SimpleNamespace(super_model=SuperModel.build(given, [CUBIC, DRAG, STRIBECK]))
    tried: list[Any] = []

    def simulated(_: Any, rival: Any, __: Any) -> experiment.Experiment:
        tried.append(rival)
        return experiment.Experiment("steps of 1 N on u for 2 s", 3.0)

    monkeypatch.setattr(experiment, "best_experiment", simulated)
    parts: Any = SimpleNamespace(case=SimpleNamespace(simulator=Simulator(given)), arena=arena)
    leader, entries = cast(Any, "leader"), cast(list[Any], [0, 1, 2])
    rivals = [
        (0, [Alternative(k, p, entries[k]) for k, p in found.items()]) for found in probabilities
    ]
    return experiment.next_experiment(parts, rivals, leader), tried


def test_a_rival_that_the_recordings_reject_is_not_separated_again(monkeypatch):
    """Nothing is asked for where all are rejected; else the most probable that is left."""
    rejected = 0.9 * experiment.LEFT
    assert asked_for(monkeypatch, [{1: rejected, 2: 0.0}]) == (None, [])
    text, tried = asked_for(monkeypatch, [{1: rejected, 2: 0.04}])
    assert tried == [2]
    assert text is not None and "Stribeck friction" in text and "quadratic drag" not in text
    # Of two findings' rivals too, in whatever order they come.
    assert asked_for(monkeypatch, [{1: rejected}, {2: 0.3}])[1] == [2]
    assert asked_for(monkeypatch, [{2: 0.3}, {1: rejected}])[1] == [2]
    assert asked_for(monkeypatch, [{1: 0.2, 2: 0.3}])[1] == [2]
    assert asked_for(monkeypatch, []) == (None, [])


def test_no_excitation_is_tried_when_the_time_is_spent():
    parts, rival = parts_of(2e-3)
    parts.case.budget = Budget(1e-9)
    assert best_experiment(parts, rival, parts.chosen) is None


def test_experiments_that_do_not_hold_are_found_by_halves(monkeypatch):
    """All go side by side first; one that diverges costs a few more passes, not one for each."""
    passes = []

    def failing(simulator, stepping, segments, theta, path, stop, near):
        passes.append(segments.number)
        if np.abs(segments.inputs).max() > 100.0:
            return None
        return closed(simulator, stepping, segments, theta, path, stop, near)

    monkeypatch.setattr(experiment, "closed", failing)
    parts, rival = parts_of(2e-3)
    items = [item for _, item in experiment._excitations(parts)]
    first, second = (
        lean(parts.arena.super_model, parts.arena.problem.simulator, Stepping("rk4", 2), e.members)
        for e in (parts.chosen, rival)
    )
    sides = first, second
    noise = np.array([2e-3])

    def separations(items):
        return experiment._separations(items, sides, (parts.chosen, rival), noise, lambda: False)

    whole = separations(items)
    assert passes == [len(items)] * 2
    np.testing.assert_allclose(whole[:2], separations(items[:2]), rtol=1e-5)
    passes.clear()
    wild = replace(items[3], inputs=np.full_like(items[3].inputs, 1000.0))
    found = separations([*items[:3], wild, *items[4:]])
    assert np.isnan(found[3]) and np.isfinite(np.delete(found, 3)).all()
    np.testing.assert_allclose(np.delete(found, 3), np.delete(whole, 3), rtol=1e-5)
    assert len(passes) < len(items)
