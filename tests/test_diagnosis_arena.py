"""The arena's segments: where they begin, where readings come late."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis_systems import ARM, DEMO, simulator_of

from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import timing_candidates
from jaxsr.diagnosis.setup import prepare, state_scale
from jaxsr.diagnosis.shooting.arena import MARGIN, Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.models import Model, Simulator, parse_model
from jaxsr.models.lifting import closed
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.recordings import Recording

SLIDER = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - k*q - Fc*sign(v)"
[readings]
y = "q"
[delays]
y = "lag"
[parameters]
k = { value = 3.0, bounds = [0.5, 100] }
Fc = { value = 0.6, bounds = [0, 10] }
lag = { value = 0.0 }
"""
"""A slider on a spring with dry friction, whose reading can be late."""
STEP, COUNT, NOISE, TRUE = 0.02, 900, 1e-3, (4.0, 1.0, 0.0)
STEPPING, FINE = (Stepping("rodas3", n, (2e-3,)) for n in (2, 32))


def recorded(seed: int) -> tuple[Model, Recording]:
    """The slider thrown at first, then stuck until after `MARGIN` samples, then driven."""
    rng, model = np.random.default_rng(seed), parse_model(SLIDER)
    time = np.arange(COUNT) * STEP
    late = np.clip(time - 0.8, 0.0, None)
    u = 3.0 * np.sin(1.3 * late) + 2.0 * np.sin(2.9 * late)
    blank = Recording("a.csv", time, {"u": u, "y": np.zeros(COUNT)})
    item = Prepared.build(model, blank)
    segments = build_segments(model, [item], [(0, 0, COUNT)], FINE.substeps)
    path = segments.course.copy()
    path[:, 0, 0] = rng.normal(0.0, 0.05), rng.uniform(0.2, 0.4)
    found = closed(simulator_of(model), FINE, segments, np.array(TRUE), path)
    assert found is not None
    y = found[0, :, 0] + NOISE * rng.standard_normal(COUNT)
    return model, Recording("a.csv", time, {"u": u, "y": y})


def arena_of(model: Model, recording: Recording) -> Arena:
    prepared = [Prepared.build(model, recording)]
    super_model = SuperModel.build(model, [])
    scale = np.array([NOISE])
    return build_arena(super_model, prepared, STEPPING, 3.6, scale, simulator_of(model))


@pytest.mark.long
@pytest.mark.parametrize("initial", ["", '[initial]\nq = "free"\nv = "free"\n'])
def test_a_segment_starts_at_its_first_judged_reading(initial: str) -> None:
    arena = arena_of(parse_model(SLIDER + initial), recorded(0)[1])
    segments = arena.problem.segments
    assert segments.start[0] == MARGIN
    assert np.isfinite(segments.outputs[:, 0]).all()
    assert arena.wide is not None
    assert arena.problem.segments.weights.sum() == arena.wide.segments.weights.sum()


def test_a_given_start_is_kept() -> None:
    model = parse_model(SLIDER + "[initial]\nq = 0.0\nv = 0.3\n")
    segments = arena_of(model, recorded(0)[1]).problem.segments
    assert segments.start[0] == 0
    assert not np.isfinite(segments.outputs[:, :MARGIN, 0]).any()


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_a_body_that_stuck_before_it_is_judged_is_estimated_to_the_noise(seed: int) -> None:
    """chi^2 per reading is 1 +- 5 standard deviations, one in a million draws beyond."""
    model, recording = recorded(seed)
    arena = arena_of(model, recording)
    start = np.array([p.value for p in model.parameters.values()])
    entry = enter(arena, (), start)
    used = arena.problem.segments.weights.sum()
    assert entry.fit.cost / used == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / used))
    np.testing.assert_allclose(entry.fit.theta[:2], TRUE[:2], rtol=5e-3)


@pytest.mark.long
def test_a_reversal_before_the_first_judged_reading_catches_no_estimate() -> None:
    """The arm's second joint slows down there, and would stick wherever its start were sought."""
    given = Simulator.from_file(ARM).model
    prepared = prepare(given, [DEMO / "set1_train.csv"])
    forces = force_candidates(given, state_scale(given, prepared))
    friction = next(c for c in forces if c.label == "coulomb_friction@equation:w2")
    super_model = SuperModel.build(given, [friction, *timing_candidates(given, 0.01, 20.0)])
    simulator, noise = Simulator(super_model.model), np.full(2, 4.57e-4)  # and steps of the encoder
    stepping = Stepping("rodas3", 2, tuple(3e-3 for _ in simulator.smoothed_arguments))
    arena = build_arena(super_model, prepared, stepping, 1.6, noise, simulator)
    used = arena.problem.segments.weights.sum()
    null = enter(arena, (), neutral_values(super_model)).fit
    starts = (neutral_values(super_model), None), (null.theta, None), (null.theta, null.path)
    for theta, path in starts:
        entry = enter(arena, (0,), theta, path)
        assert entry.fit.cost / used < 1.5
        assert entry.fit.theta[super_model.index(0)[0]] == pytest.approx(0.5, abs=0.001)
