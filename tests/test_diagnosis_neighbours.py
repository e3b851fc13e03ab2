"""What other sets would leave, told by one linearisation about an estimate."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from diagnosis_systems import SPRUNG, simulator_of, sprung_recording

from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.mechanisms import force_candidates, sensor_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.screen import redundant
from jaxsr.diagnosis.search.believed import estimated
from jaxsr.diagnosis.search.neighbours import Neighbours
from jaxsr.diagnosis.setup import prepare, state_scale
from jaxsr.models import parse_model
from jaxsr.models.rollout import Stepping

NOISE, CUBIC = 1e-4, 40.0
KINDS = ("cubic_stiffness", "quadratic_stiffness", "quadratic_drag", "input_gain", "sensor_gain")


@cache
def arena(seed: int = 0) -> Arena:
    """A driven mass on a spring that hardens, `CUBIC` in N/m^3; its model's spring is linear."""

    def force(q: float, v: float, u: float) -> float:
        return u - 30.0 * q - CUBIC * q**3 - 2.0 * v

    recording = sprung_recording(force, np.random.default_rng(seed), NOISE)
    model = parse_model(SPRUNG)
    prepared = prepare(model, [recording])
    offered = force_candidates(model, state_scale(model, prepared))
    offered += sensor_candidates(model, {"y": recording.channels["y"]})
    chosen = {c.mechanism: c for c in reversed(offered) if c.mechanism in KINDS}
    super_model = SuperModel.build(model, [chosen[kind] for kind in KINDS])
    simulator = simulator_of(super_model.model)
    setting = Stepping("rk4", 2, ()), 1.5, np.array([NOISE]), simulator
    return build_arena(super_model, prepared, *setting)


@cache
def entered(*members: int) -> Entry:
    return enter(arena(), members, neutral_values(arena().super_model))


def test_what_is_expected_of_the_set_itself_is_what_it_left() -> None:
    own = Neighbours.of(arena(), entered(0)).entry((0,))
    assert own is not None
    np.testing.assert_allclose(own.errors, entered(0).errors, rtol=1e-6)
    np.testing.assert_allclose(own.fit.theta, entered(0).fit.theta, rtol=1e-4)
    assert own.fit.cost == pytest.approx(entered(0).fit.cost, rel=1e-3)


def test_sets_near_a_set_lack_replace_or_add_one() -> None:
    around = Neighbours.of(arena(), entered(0))
    sets = list(around.sets())
    assert len(sets) == len(set(sets))
    assert {m for m in sets if len(m) == 0} == {()}
    # forces at the same equation come in its place, a sensor or an input beside it
    assert {m for m in sets if len(m) == 1} >= {(1,), (2,)}
    assert (4,) not in sets
    assert {m for m in sets if len(m) == 2} == {(0, i) for i in (1, 2, 3, 4)}
    assert not any(redundant(arena().super_model, m) for m in sets)


@pytest.mark.parametrize("members", [(), (1,), (2,), (0, 1), (0, 2), (0, 3), (0, 4)])
def test_what_is_expected_of_other_sets_is_near_what_they_leave(members: tuple[int, ...]) -> None:
    """To 5 % of the mean square where the change is small, to a factor of 2 without the spring."""
    expected = Neighbours.of(arena(), entered(0)).entry(members)
    full = entered(*members)
    if expected is None:  # a constant with the wrong sign, which the full estimate holds at 0
        value = full.fit.theta[arena().super_model.index(*set(members) - {0})]
        assert value == pytest.approx(0.0, abs=1e-9)
        return
    assert expected.members == members
    far = 0 not in members
    assert (full.error > 20.0 * entered(0).error) is far
    assert np.log(expected.error / full.error) == pytest.approx(0.0, abs=0.7 if far else 0.05)
    # beside a free mass, spring and damper nothing tells a gain from none
    if not far and not {3, 4} & set(members):
        new = arena().super_model.index(*set(members) - {0})
        told = np.abs(full.fit.theta[new] - neutral_values(arena().super_model)[new]).max()
        np.testing.assert_allclose(expected.fit.theta[new], full.fit.theta[new], atol=0.1 * told)


def test_a_set_that_was_only_expected_is_estimated_before_it_is_told() -> None:
    around = Neighbours.of(arena(), entered(0, 4))
    expected, before = around.entry((0,)), entered(0, 4)
    assert expected is not None and not expected.fit.linearised
    entries, chosen = estimated(arena(), expected, [before, expected], before)
    assert chosen.fit.linearised and chosen in entries and expected not in entries
    assert chosen.fit.cost == pytest.approx(entered(0).fit.cost, rel=1e-6)
    assert estimated(arena(), before, [before], before) == ([before], before)
