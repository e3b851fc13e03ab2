"""What the sensors see of candidates about a free run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_systems import SPRUNG, simulator_of, sprung_recording

from jaxsr.diagnosis.mechanisms import force_candidates, sensor_candidates
from jaxsr.diagnosis.mechanisms.candidate import UNNAMED
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare, state_scale
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.uncertainty import sensitivities
from jaxsr.models import parse_model
from jaxsr.models.rollout import Stepping

NOISE = 1e-4
KINDS = (
    "cubic_stiffness",
    "quadratic_stiffness",
    "quadratic_drag",
    "constant_force",
    "asymmetric_friction",
    "input_saturation",
    "sensor_gain",
)
Force = Callable[[float, float, float], float]


def linear(q: float, v: float, u: float) -> float:
    return u - 30.0 * q - 2.0 * v


def hard(q: float, v: float, u: float) -> float:
    return linear(q, v, u) - 40.0 * q**3 - 1.5


def arena_of(force: Force, seed: int, nameless: str = "") -> Arena:
    recording = sprung_recording(force, np.random.default_rng(seed), NOISE)
    model = parse_model(SPRUNG)
    prepared = prepare(model, [recording])
    u, y = (recording.channels[name] for name in ("u", "y"))
    offered = force_candidates(model, state_scale(model, prepared), inputs={"u": u})
    offered += sensor_candidates(model, {"y": y})
    chosen = {c.mechanism: c for c in reversed(offered) if c.mechanism in KINDS}
    if nameless:
        chosen[nameless] = replace(chosen[nameless], mechanism=UNNAMED)
    super_model = SuperModel.build(model, [chosen[kind] for kind in KINDS])
    simulator = simulator_of(super_model.model)
    setting = Stepping("rk4", 2, ()), 1.5, np.array([NOISE]), simulator
    return build_arena(super_model, prepared, *setting)


def entered(arena: Arena, *kinds: str) -> Entry:
    members = tuple(sorted(KINDS.index(kind) for kind in kinds))
    start = arena.super_model.seeded(members, neutral_values(arena.super_model))
    return enter(arena, members, start)


def test_what_the_sensors_see_of_a_mechanism_does_not_depend_on_its_company(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Candidates are differentiated by a few at a time."""
    arena = arena_of(hard, 0)
    centre = entered(arena, "cubic_stiffness")
    tables = []
    for together in (1, 3, 100):
        monkeypatch.setattr("jaxsr.diagnosis.shooting.tangent.TOGETHER", together)
        tables.append(sensitivities(arena, centre.fit, centre.members))
    one, three, every = tables
    assert one.candidates == every.candidates == tuple(i for i in range(len(KINDS)) if i != 0)
    for table in (one, three):
        np.testing.assert_allclose(table.error, every.error, rtol=1e-6)
        np.testing.assert_allclose(table.angle_to_parameters, every.angle_to_parameters, rtol=1e-6)
        size = np.sqrt(np.diag(every.gram))
        np.testing.assert_allclose(table.gram, every.gram, atol=1e-6 * np.outer(size, size).max())
