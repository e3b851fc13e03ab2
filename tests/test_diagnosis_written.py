"""Laws that the evolution writes for what a search by evidence leaves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.laws.place import Place
from jaxsr.diagnosis.laws.unnamed import as_candidate
from jaxsr.diagnosis.laws.written import CONFIG, Writer
from jaxsr.diagnosis.likelihood.course import Course, followed
from jaxsr.diagnosis.likelihood.later import Written, with_laws
from jaxsr.diagnosis.likelihood.loop import search
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.posterior import Posterior, posterior
from jaxsr.diagnosis.likelihood.proposals import exclusive
from jaxsr.diagnosis.likelihood.state import State
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.evolution.loop import SearchInfo
from jaxsr.evolution.propose import propose
from jaxsr.expressions import evaluate, parse
from jaxsr.models import Model, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording
from tests.test_diagnosis_selection import proposal

MODEL = """
[model]
name = "sprung cart"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
input_hold = "linear"
[equations]
q = "v"
v = "u - k*q - 0.4*v"
[readings]
y = "q"
[parameters]
k = { value = 6.0, bounds = [1.0, 20.0] }
"""
TIME = np.arange(500) * 0.03


def prepared(rng: np.random.Generator, force: Any, runs: int = 2) -> list[Prepared]:
    """Runs of the cart with one more force, its position read with white noise."""
    made = []
    for _ in range(runs):
        waves = np.sin(np.outer(TIME, [1.1, 2.3, 4.7]) + rng.uniform(0.0, 6.0, 3))
        drive = waves @ rng.uniform(1.5, 4.0, 3)

        def rate(t: float, x: np.ndarray, drive: np.ndarray = drive) -> list[float]:
            u = float(np.interp(t, TIME, drive))
            return [x[1], u - 6.0 * x[0] - 0.4 * x[1] + force(*x, u)]

        run = solve_ivp(rate, (0.0, TIME[-1]), [0.2, 0.0], t_eval=TIME, rtol=1e-8, atol=1e-10)
        y = run.y[0] + 2e-3 * rng.normal(size=TIME.size)
        recording = Recording("run", TIME, {"u": drive, "y": y})
        made.append(Prepared.build(parse_model(MODEL), recording))
    return made


def begun(runs: list[Prepared]) -> tuple[Model, Course, SuperModel, State]:
    """The cart's model, its course, what is offered, and a search for one member."""
    model = parse_model(MODEL)
    course = followed(model, runs)
    assert course is not None
    every = SuperModel.build(model, offered(model, course))
    work = Workspace.build(every, course.prepared, course.seconds, course.null.noise)
    return model, course, every, search(work, course.null, most=1)


def told(found: Posterior) -> list[str]:
    return [found.candidates[i].mechanism for i in found.leader.members]


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_law_outside_the_family_is_written_and_leads(seed: int) -> None:
    """Van der Pol's damping is a member of none of the laws offered: all that they do is imitate.

    The law that leads is it: along the motion it differs by less than 1 %, beside the right k.
    """
    rng = np.random.default_rng(seed)
    runs = prepared(rng, lambda q, v, _: -1.5 * (q**2 - 0.5) * v)
    model = parse_model(MODEL)
    named = posterior(model, runs)
    found = posterior(model, runs, write=Writer(rng, lambda: 60.0))
    assert named is not None and found is not None
    assert told(found) == ["unnamed"]
    leader, (number,) = found.leader, found.leader.members
    assert leader.log_evidence > named.leader.log_evidence + 20.0
    law, names = found.candidates[number], leader.names[number]
    term = parse(law.terms[0][1].format(**names).removeprefix("+ "))
    q, v = rng.uniform(-1.0, 1.0, 200), rng.uniform(-2.0, 2.0, 200)
    values = {full: leader.constants[full][0] for full in names.values()}
    force, truth = evaluate(term, {"q": q, "v": v, **values}), -1.5 * (q**2 - 0.5) * v
    k, deviation = leader.constants["k"]
    assert abs(k - 6.0) < 5.0 * deviation
    assert np.std(force - truth) < 0.01 * np.std(truth)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_a_law_may_hang_on_an_input(seed: int) -> None:
    """A drive that gains with the speed in its direction is none of the gains that have a name."""
    rng = np.random.default_rng(seed)
    runs = prepared(rng, lambda q, v, u: 0.3 * u * v)
    found = posterior(parse_model(MODEL), runs, write=Writer(rng, lambda: 60.0))
    assert found is not None
    assert told(found) == ["unnamed"]
    (number,) = found.leader.members
    law, names = found.candidates[number], found.leader.names[number]
    term = parse(law.terms[0][1].format(**names).removeprefix("+ "))
    signals = dict(zip("qvu", rng.uniform(-1.0, 1.0, (3, 200)), strict=True))
    values = {full: found.leader.constants[full][0] for full in names.values()}
    truth = 0.3 * signals["u"] * signals["v"]
    assert np.std(evaluate(term, signals | values) - truth) < 0.03 * np.std(truth)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_forces_that_have_names_keep_them(seed: int) -> None:
    """Two named forces at one equation ask for a law; none is worth its bits beside them."""
    rng = np.random.default_rng(seed)
    runs = prepared(rng, lambda q, v, _: -0.9 * v * abs(v) - 5.0 * q**3)
    found = posterior(parse_model(MODEL), runs, write=Writer(rng, lambda: 60.0))
    assert found is not None
    assert sorted(told(found)) == ["cubic_stiffness", "quadratic_drag"]


def test_a_law_begins_with_the_constants_it_was_written_with() -> None:
    """And what was known of sets before stands, to the last digit, beside more candidates."""
    rng = np.random.default_rng(3)
    runs = prepared(rng, lambda q, v, _: -1.5 * (q**2 - 0.5) * v)
    model, course, every, state = begun(runs)
    law, values = as_candidate(model, course.prepared, 1, proposal("q**2*v ; v", 1.0, (-1.0, 0.5)))
    base = state.leader.theta[every.base_index()]
    asked = []

    def write(seen: Any, _: Any) -> list[Written]:
        asked.append(seen)
        return [Written(law, values, (), base)] if len(asked) == 1 else []

    after = with_laws(state, course, write)
    number = len(every.candidates)
    assert after.leader.members == (number,)
    assert len(asked) == 2  # once more, for it leads
    for members, before in state.known.items():
        now = after.known[members]
        assert (before is None) == (now is None)
        if before is not None and now is not None:
            assert now.log_evidence >= before.log_evidence
            np.testing.assert_array_equal(now.theta[: len(before.theta)], before.theta)
    spring = next(i for i, c in enumerate(every.candidates) if c.mechanism == "cubic_stiffness")
    assert exclusive(after.work.super_model, (spring, number))


def test_named_forces_are_asked_to_their_end_where_a_law_leaves_a_force() -> None:
    """v**3 for v*abs(v) leaves a force, and leads while but one named force has been asked.

    The two that act leave none: they lead once they are asked, and are not where the law is exact.
    """
    rng = np.random.default_rng(0)
    runs = prepared(rng, lambda q, v, _: -0.9 * v * abs(v) - 5.0 * q**3)
    model, course, every, state = begun(runs)
    base = state.leader.theta[every.base_index()]

    def after(text: str, coefficients: tuple[float, ...]) -> State:
        law, values = as_candidate(model, course.prepared, 1, proposal(text, 1.0, coefficients))
        laws = [Written(law, values, (), base)]
        return with_laws(state, course, lambda *_: [laws.pop()] if laws else [])

    found, number = after("q**3 ; v**3", (-5.0, -0.3)), len(every.candidates)
    imposter = found.known[(number,)]
    assert imposter is not None and imposter.share > 0.0
    assert imposter.log_evidence > state.leader.log_evidence + 20.0
    names = [every.candidates[i].mechanism for i in found.leader.members]
    assert sorted(names) == ["cubic_stiffness", "quadratic_drag"]
    exact = after("q**3 ; v*Abs(v)", (-5.0, -0.9))
    assert exact.leader.members == (number,)
    assert all(len(members) < 2 for members in exact.known)


def written(seed: int, seconds: float | None) -> tuple[int, list[Any]]:
    """Search for a law that the family lacks: generations, and what was found."""
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-1.0, 1.0, 300), rng.uniform(-2.0, 2.0, 300)
    force = -1.5 * (q**2 - 0.5) * v + 0.02 * rng.normal(size=300)
    reached: list[int] = []

    def tell(info: SearchInfo) -> None:
        reached.append(info.generation)

    signals = {"q": q, "v": v}
    found = propose(rng, force, signals, config=CONFIG, budget=seconds, progress=tell)
    return max(reached), [(p.terms, *p.coefficients) for p in found]


@pytest.mark.parametrize("seed", [0, 1])
def test_the_search_for_a_law_ends_by_itself(seed: int) -> None:
    """Not by time: given more, it finds the same."""
    generations, found = written(seed, None)
    assert generations < CONFIG.generations
    assert (generations, found) == written(seed, 600.0)


def test_what_a_parameter_would_do_beyond_its_bound_is_left_for_the_law() -> None:
    """Two parameters at 0.3 and 2; the first would go to -0.9, and is held at 0.

    Inside the bounds nothing is, however numbers are rounded.
    """
    rng = np.random.default_rng(0)
    reach, law = rng.normal(size=(50, 2)), rng.normal(size=50)
    site = next(s for s in sites_of(parse_model(MODEL), {}) if s.state == "v")
    force = reach @ [-1.2, 0.5] + law
    bounds = np.array([0.3, 2.0]), np.ones(2), np.array([0.0, 1.0]), np.array([3.0, 4.0])
    place = Place(site, (), force, 0.0 * force, reach, {}, *bounds)
    held = place.held(np.array([-1.2, 0.5]))
    assert held is not None
    np.testing.assert_array_equal(held.reach[:, 0], 0.0)
    np.testing.assert_array_equal(held.reach[:, 1], reach[:, 1])
    left = held.force - held.reach @ [0.0, 0.5]
    np.testing.assert_allclose(left, law - 0.9 * reach[:, 0], atol=1e-12)
    assert held.held(np.array([0.0, 0.5])) is None
    for _ in range(100):
        assert place.held(rng.uniform([-0.3, -1.0], [2.7, 2.0])) is None
