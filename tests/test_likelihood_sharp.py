"""Dry friction with stick-slip at a noise of 1e-6 of the motion: the law itself, nothing beside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.evidence_plants import Dry, cart, drive
from jaxsr.diagnosis.likelihood import hypotheses, local, rounding
from jaxsr.diagnosis.likelihood.loop import begun, search
from jaxsr.diagnosis.likelihood.posterior import posterior
from jaxsr.diagnosis.likelihood.state import State
from jaxsr.diagnosis.likelihood.steps import resolved
from jaxsr.diagnosis.likelihood.workspace import Workspace, in_columns
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import state_scale
from jaxsr.diagnosis.shooting.integration import with_steps
from jaxsr.models import Simulator, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

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


@pytest.mark.parametrize(
    ("equation", "jumps"),
    [
        ("u - Fc*sign(v)", True),
        ("u - Fc*sign(v - 0.1)*Abs(v)", True),
        ("u - Fc*sign(v)*Abs(v)**1.5", False),
        ("u - Fc*sqrt(Abs(v))*sign(v)", False),
        ("u - Fc*sign(u)", False),
    ],
)
def test_a_model_that_has_dry_friction_of_its_own_jumps(equation: str, jumps: bool) -> None:
    text = f"""
[model]
states = ["v"]
inputs = ["u"]
outputs = ["y"]
[equations]
v = "{equation}"
[readings]
y = "v"
[parameters]
Fc = {{ value = 1.0 }}
"""
    assert SuperModel.build(parse_model(text), ()).given_jumps is jumps


def test_friction_that_the_model_has_is_not_told_once_more() -> None:
    """A conveyor that all but sticks, read by an encoder; its damping is given wrong."""
    rng, step, resolution = np.random.default_rng(0), 0.02, 2e-3
    time = np.arange(900) * step
    phases = rng.uniform(0.0, 6.0, 4)
    waves = np.sin(np.outer(time, rng.uniform(0.3, 2.0, 4)) + phases).sum(axis=1)
    u, v = np.maximum(1.5 + 1.5 * waves, 0.0), np.zeros(time.size)
    for k in range(time.size - 1):
        speed, fine = v[k], step / 200.0
        for _ in range(200):
            speed += fine * (u[k] - speed - 2.0 * np.tanh(speed / 2e-3)) / 3.0
        v[k + 1] = speed
    text = """
[model]
input_hold = "zero"
states = ["v"]
inputs = ["u"]
outputs = ["y"]
[equations]
v = "(u - c*v - 2.0*sign(v))/3.0"
[readings]
y = "v"
[parameters]
c = { value = 0.8, bounds = [0.0, 5.0] }
"""
    model = Simulator(parse_model(text)).model
    readings = resolution * np.round(v / resolution)
    found = posterior(model, [Prepared.build(model, Recording("a", time, {"u": u, "y": readings}))])
    assert found is not None
    assert found.leader.members == ()
    assert found.leader.share == 0.0
    value, deviation = found.leader.constants["c"]
    assert abs(value - 1.0) < 4.0 * deviation
