"""Dry friction with stick-slip at a noise of 1e-6 of the motion: the law itself, nothing beside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.evidence_plants import Dry, cart, drive
from jaxsr.diagnosis.contest.integration import with_steps
from jaxsr.diagnosis.likelihood import hypotheses, local, rounding
from jaxsr.diagnosis.likelihood.loop import begun, search
from jaxsr.diagnosis.likelihood.state import State
from jaxsr.diagnosis.likelihood.steps import resolved
from jaxsr.diagnosis.likelihood.workspace import Workspace, in_columns
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import state_scale
from jaxsr.models.segments import Prepared

OFFERED = {"constant_force", "viscous_damping", "coulomb_friction", "stribeck_friction"}
INTERVAL, SAMPLES, MASS = 0.03, 200, 1.3


def offered(dry: Dry, noise: float) -> Workspace:
    """Frictions that a cart may rub by, and recordings of one."""
    rng = np.random.default_rng(2)
    force = drive(rng, SAMPLES, INTERVAL, 3.0, (1.1, 2.3, 4.7))
    plant = cart(dry={0: dry})
    model = plant.simulator.model
    prepared = [Prepared.build(model, plant.recorded(rng, force, INTERVAL, noise))]
    every = force_candidates(model, state_scale(model, prepared))
    among = SuperModel.build(model, [c for c in every if c.mechanism in OFFERED])
    return Workspace.build(among, prepared, 10.0 * INTERVAL)


def searched(dry: Dry, noise: float) -> State:
    """Search among frictions for what a cart rubs by."""
    return search(offered(dry, noise))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [1e-6, 1e-4])
def test_coulomb_friction_is_named_alone_and_no_force_is_left(noise: float) -> None:
    state = searched(Dry(2.0 / MASS, 2.0 / MASS), noise)
    every, leader = state.work.super_model, state.leader
    assert [every.candidates[i].mechanism for i in leader.members] == ["coulomb_friction"]
    assert leader.share == 0.0
    (number,) = leader.members
    value, deviation = leader.constants[leader.names[number]["Fc"]]
    assert abs(value - 2.0) < 4.0 * deviation
    assert deviation < 10.0 * noise


@pytest.mark.slow
def test_a_stribeck_peak_is_told_from_coulomb_friction() -> None:
    state = searched(Dry(0.8 / MASS, 1.2 / MASS, 0.15), 1e-6)
    every, leader = state.work.super_model, state.leader
    assert [every.candidates[i].mechanism for i in leader.members] == ["stribeck_friction"]
    assert leader.share == 0.0
    (number,) = leader.members
    found = {own: leader.constants[name] for own, name in leader.names[number].items()}
    for own, value in (("Fc", 0.8), ("Fs", 1.2), ("vs", 0.15)):
        assert abs(found[own][0] - value) < 4.0 * found[own][1]


@pytest.mark.long
def test_steps_that_do_for_a_law_that_is_off_are_not_kept_once_it_acts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    work = offered(Dry(2.0 / MASS, 2.0 / MASS), 1e-3)
    state = begun(work)
    table = state.table
    coulomb = [c.mechanism for c in work.super_model.candidates].index("coulomb_friction")
    led = hypotheses.hypothesis(work, table, (coulomb,))
    assert led is not None
    estimate, kept = hypotheses.at_its_mode, []

    def watched(problem, sharp, values, path, follow, scales):
        kept.append((estimate(problem, sharp, values, path, follow, scales), scales))
        return kept[-1][0]

    monkeypatch.setattr(hypotheses, "at_its_mode", watched)
    monkeypatch.setattr(rounding, "switched", lambda problem, theta: None)  # rounded jumps,
    monkeypatch.setattr(rounding, "width_step", lambda *_: None)  # of the leader's width alone
    null = state.known[()]
    assert null is not None
    near = hypotheses.replace(null, width=1.0, noise=led.noise, path=led.path)
    assert hypotheses.hypothesis(work, table, (coulomb,), near) is not None
    (problem, found, _), scales = kept[0]
    again = resolved(problem, found.theta, found.path, scales.noise, scales.start)
    assert again.stepping == problem.stepping
    assert problem.stepping.substeps * problem.stepping.parts > 1


def test_a_linearisation_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is asked again, or a part of it, is what was found; another path is another one."""
    work = offered(Dry(2.0 / MASS, 2.0 / MASS), 1e-4)
    made, original = [], local._linearised

    def counted(*args: Any) -> local.LocalModel:
        made.append(args)
        return original(*args)

    monkeypatch.setattr(local, "_linearised", counted)
    problem, path = work.narrow, work.narrow.segments.course
    values = in_columns(work, work.theta)
    place = problem.simulator, problem.stepping, problem.segments, values
    active = list(work.columns.base_index())
    whole = local.linearised(*place, path, active)
    assert local.linearised(*place, path.copy(), active) is whole
    part = local.linearised(*place, path, active[:1])
    assert len(made) == 1
    np.testing.assert_array_equal(part.by_constant, whole.by_constant[..., :1])
    np.testing.assert_allclose(
        part.by_constant, original(*place, path, active[:1]).by_constant, rtol=1e-12
    )
    local.linearised(*place, path + 1e-9, active)
    finer = with_steps(problem, "rk4", 2 * problem.stepping.substeps)
    local.linearised(finer.simulator, finer.stepping, finer.segments, values, path, active)
    assert len(made) == 3
