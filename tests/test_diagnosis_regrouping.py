"""Sets altogether different from one that follows the recordings, told by its path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_systems import SPRUNG, simulator_of, sprung_recording

from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.tangent import linearised
from jaxsr.diagnosis.contest.uncertainty import sensitivities
from jaxsr.diagnosis.judging.criteria import most_credible, nearest_given
from jaxsr.diagnosis.judging.plausible import plausible
from jaxsr.diagnosis.mechanisms import force_candidates, sensor_candidates
from jaxsr.diagnosis.mechanisms.candidate import UNNAMED
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.search.regrouping import Regrouping, regrouped, settled
from jaxsr.diagnosis.search.tangents import tangent_about
from jaxsr.diagnosis.setup import prepare, state_scale
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


def dragged(q: float, v: float, u: float) -> float:
    return linear(q, v, u) - 3.0 * v * abs(v) - 20.0 * q**2


def limited(q: float, v: float, u: float) -> float:
    return linear(q, v, float(np.clip(u, -7.0, 7.0))) - 40.0 * q**3


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


def names(entry: Entry) -> set[str]:
    return {KINDS[i] for i in entry.members}


def test_of_the_set_itself_what_it_left_is_expected() -> None:
    arena = arena_of(hard, 0)
    centre = entered(arena, "cubic_stiffness", "constant_force")
    own = Regrouping.of(arena, centre).expected(centre.members)
    assert own is not None
    assert own.fit.cost == pytest.approx(centre.fit.cost, rel=1e-4)
    np.testing.assert_allclose(own.fit.theta, centre.fit.theta, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("kinds", [("cubic_stiffness", "constant_force"), ("quadratic_drag",), ()])
def test_another_set_is_expected_to_leave_about_what_it_leaves(kinds: tuple[str, ...]) -> None:
    """A wrong set of two follows well enough to tell others to 30 % of the root mean square."""
    arena = arena_of(hard, 1)
    centre = entered(arena, "quadratic_stiffness", "asymmetric_friction")
    full = entered(arena, *kinds)
    expected = Regrouping.of(arena, centre).expected(full.members)
    assert expected is not None
    if kinds == ("cubic_stiffness", "constant_force"):
        # the truth: far better than the centre, but to first order only
        assert expected.fit.cost < 0.05 * centre.fit.cost
    else:
        assert 0.5 * np.log(expected.fit.cost / full.fit.cost) == pytest.approx(0.0, abs=0.3)


def test_a_limit_is_taken_away_as_a_whole() -> None:
    """No derivative by a limit tells what is left without it; the force along the path does."""
    arena = arena_of(limited, 2)
    centre = entered(arena, "cubic_stiffness", "input_saturation")
    full = entered(arena, "cubic_stiffness")
    expected = Regrouping.of(arena, centre).expected(full.members)
    assert expected is not None
    assert full.fit.cost > 100.0 * centre.fit.cost
    assert 0.5 * np.log(expected.fit.cost / full.fit.cost) == pytest.approx(0.0, abs=0.3)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("force", "planted"),
    [
        (hard, {"cubic_stiffness", "constant_force"}),
        (dragged, {"quadratic_drag", "quadratic_stiffness"}),
        (limited, {"cubic_stiffness", "input_saturation"}),
    ],
)
def test_two_effects_at_once_are_found_from_re_calibration(
    force: Force, planted: set[str], seed: int
) -> None:
    arena = arena_of(force, seed)
    entries = [entered(arena)]
    arena, found = settled(arena, entries, lambda: False)
    good = [e for e in found if not e.members or plausible(arena, e)]
    best = most_credible(arena.super_model, good)
    assert names(best) == planted
    # at the noise: one parameter set explains 1200 readings
    rms = np.sqrt(np.sum(best.fit.residual**2) / 1200.0) * arena.problem.scale[0]
    assert rms == pytest.approx(NOISE, rel=0.1)


def test_a_law_without_a_name_is_joined_to_none_about_a_path() -> None:
    """Nor are sets told from its own path: it stands where no named ones do."""
    named, cubic = arena_of(hard, 0), KINDS.index("cubic_stiffness")
    assert any(cubic in e.members for e in Regrouping.of(named, entered(named)).best([]))
    arena = arena_of(hard, 0, nameless="cubic_stiffness")
    offered = Regrouping.of(arena, entered(arena)).best([])
    assert offered and not any(cubic in e.members for e in offered)
    own = entered(arena, "cubic_stiffness")
    assert regrouped(arena, own, [own], lambda: False) == [own]


def test_columns_are_those_of_one_linearisation_and_asked_for_once() -> None:
    arena = arena_of(hard, 0)
    centre = entered(arena, "cubic_stiffness")
    tangent, every = tangent_about(arena, centre), range(len(KINDS))
    assert tangent_about(arena, centre) is tangent
    setting = arena.problem, arena.super_model, centre.members, centre.fit
    reduced, fit, _ = linearised(*setting, every)
    columns = dict(zip(reduced.parameters[fit.active].tolist(), fit.jacobian, strict=True))
    for j, k in tangent.columns.items():
        np.testing.assert_allclose(tangent.fit.jacobian[k], columns[j], rtol=1e-7, atol=1e-9)
    limit = arena.super_model.index(KINDS.index("input_saturation"))
    assert not set(limit) & set(tangent.columns)


def test_what_the_sensors_see_of_a_mechanism_does_not_depend_on_its_company(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Candidates are differentiated by a few at a time."""
    arena = arena_of(hard, 0)
    centre = entered(arena, "cubic_stiffness")
    tables = []
    for together in (1, 3, 100):
        monkeypatch.setattr("jaxsr.diagnosis.contest.tangent.TOGETHER", together)
        tables.append(sensitivities(arena, centre.fit, centre.members))
    one, three, every = tables
    assert one.candidates == every.candidates == tuple(i for i in range(len(KINDS)) if i != 0)
    for table in (one, three):
        np.testing.assert_allclose(table.error, every.error, rtol=1e-6)
        np.testing.assert_allclose(table.angle_to_parameters, every.angle_to_parameters, rtol=1e-6)
        size = np.sqrt(np.diag(every.gram))
        np.testing.assert_allclose(table.gram, every.gram, atol=1e-6 * np.outer(size, size).max())


def test_of_two_sets_that_fit_alike_the_one_nearer_to_the_model_is_believed() -> None:
    """A free mass, spring and damper make up for a sensor's gain: the motion shows ratios alone."""
    arena = arena_of(linear, 0)
    plain = entered(arena, "sensor_gain")
    base = arena.super_model.base_index()

    def moved(factor: float, members: tuple[int, ...]) -> Entry:
        theta = plain.fit.theta.copy()
        theta[base] = neutral_values(arena.super_model)[base] * factor
        return replace(plain, members=members, fit=replace(plain.fit, theta=theta))

    near, far = moved(1.01, plain.members), moved(1.2, plain.members)
    worse = replace(near, fit=replace(near.fit, cost=1.1 * near.fit.cost))
    assert nearest_given(arena.super_model, far, [far, near]) is near
    assert nearest_given(arena.super_model, near, [far, near]) is near
    assert nearest_given(arena.super_model, far, [far, worse]) is far
    assert nearest_given(arena.super_model, far, [far, moved(1.01, ())]) is far


def test_nothing_is_estimated_once_the_time_is_up() -> None:
    arena = arena_of(hard, 0)
    entries = [entered(arena)]
    assert settled(arena, entries, lambda: True) == (arena, entries)
