"""Re-calibration, and in which weights its outputs are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_systems import SPRUNG, simulator_of, sprung_recording

from jaxsr.diagnosis.calibrating.horizon import Headline
from jaxsr.diagnosis.calibrating.opening import _recalibrated
from jaxsr.diagnosis.judging.noise_ratio import ABOVE_NOISE, in_noise, residual_to_noise
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.models import parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.recordings import Recording

FINE, COARSE = 1e-5, 0.04
# The position is read twice: finely, and by a converter of a few steps.
TWICE = SPRUNG.replace('outputs = ["y"]', 'outputs = ["y", "z"]').replace(
    'y = "q"\n', 'y = "q"\nz = "q"\n', 1
)


def arena_of(seed: int) -> Arena:
    """Return an arena of a complete model whose outputs weigh as they deviate."""
    rng = np.random.default_rng(seed)
    plain = sprung_recording(lambda q, v, u: u - 40.0 * q - 1.5 * v, rng, FINE)
    y = plain.channels["y"]
    coarse = COARSE * np.round((y + 0.3 * COARSE * rng.standard_normal(y.size)) / COARSE)
    recording = Recording("a.csv", plain.time, {**plain.channels, "z": coarse})
    model = parse_model(TWICE)
    prepared = prepare(model, [recording])
    scale = 0.01 * np.std(prepared[0].outputs, axis=0)
    super_model = SuperModel.build(model, [])
    simulator = simulator_of(super_model.model)
    return build_arena(super_model, prepared, Stepping("rk4", 4, ()), 1.5, scale, simulator)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_outputs_are_weighed_by_noise_where_other_weights_hide_the_fit(seed: int) -> None:
    arena = arena_of(seed)
    given = neutral_values(arena.super_model)
    plain = enter(arena, (), given)
    assert residual_to_noise(arena, plain) > 3.0 * ABOVE_NOISE
    weighed, found = _recalibrated(
        arena, Headline(arena.seconds, [arena.seconds]), given, lambda: False
    )
    assert residual_to_noise(weighed, found) < ABOVE_NOISE
    fine, coarse = weighed.problem.scale
    assert fine == pytest.approx(FINE, rel=0.2)
    assert coarse > COARSE / np.sqrt(12.0)
    told = dict(zip(weighed.super_model.model.parameters, found.fit.theta, strict=True))
    assert told["k"] / told["M"] == pytest.approx(20.0, rel=1e-3)


def test_weights_that_show_the_noise_are_kept() -> None:
    arena = in_noise(arena_of(0))
    slightly = replace(arena, problem=replace(arena.problem, scale=1.1 * arena.problem.scale))
    given = neutral_values(slightly.super_model)
    same, _ = _recalibrated(
        slightly, Headline(arena.seconds, [arena.seconds]), given, lambda: False
    )
    assert same is slightly
