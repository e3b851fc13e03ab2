"""Search by evidence on small plants: what was left out, nothing, and a wrong value."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.likelihood import estimate, loop
from jaxsr.diagnosis.likelihood import state as states
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.loop import better
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.posterior import Posterior, posterior, posterior_along
from jaxsr.diagnosis.likelihood.scales import log_odds, sizes_about
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.state import State
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import seen_by
from jaxsr.models import Simulator, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

MODEL = """
[model]
name = "sprung cart"
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
input_hold = "linear"
[equations]
q = "v"
v = "u - k*q - d*v"
[inertia]
v = { v = "m" }
[readings]
y = "q"
[parameters]
m = { value = 1.3, bounds = [0.5, 4.0] }
k = { value = 6.0, bounds = [1.0, 20.0] }
d = { value = 0.4, bounds = [0.0, 3.0] }
"""
SIGMA = 2e-3
TIME = np.arange(300) * 0.03


def recorded(rng: np.random.Generator, force, k: float = 6.0) -> Recording:
    """A run of the cart with one more force, its position read with white noise."""
    amplitudes, phases = rng.uniform(0.5, 2.0, 3), rng.uniform(0.0, 6.0, 3)
    rates = np.array([1.1, 2.3, 4.7])
    drive = (amplitudes * np.sin(np.outer(TIME, rates) + phases)).sum(axis=1)

    def rate(t: float, x: np.ndarray) -> list[float]:
        u = np.interp(t, TIME, drive)
        return [x[1], (u - k * x[0] - 0.4 * x[1] + force(*x)) / 1.3]

    run = solve_ivp(rate, (0.0, TIME[-1]), [0.2, 0.0], t_eval=TIME, rtol=1e-8, atol=1e-10)
    y = run.y[0] + SIGMA * rng.normal(size=TIME.size)
    return Recording("run", TIME, {"u": drive, "y": y})


def searched(seed: int, force, k: float = 6.0) -> Posterior:
    rng = np.random.default_rng(seed)
    simulator = Simulator(parse_model(MODEL))
    prepared = [Prepared.build(simulator.model, recorded(rng, force, k)) for _ in range(2)]
    found = posterior(simulator.model, prepared, seen_by(simulator, prepared))
    assert found is not None
    return found


@pytest.mark.long
@pytest.mark.parametrize(
    ("force", "mechanism", "constant", "value"),
    [
        (lambda q, v: -0.5 * v * abs(v), "quadratic_drag", "kd", 0.5),
        (lambda q, v: -3.0 * q**3, "cubic_stiffness", "k3", 3.0),
    ],
)
def test_a_law_that_was_left_out_is_the_most_probable(
    force, mechanism: str, constant: str, value: float
) -> None:
    found = searched(1, force)
    (number,) = found.leader.members
    assert found.candidates[number].mechanism == mechanism
    estimate, deviation = found.leader.constants[found.leader.names[number][constant]]
    assert abs(estimate - value) < 4.0 * deviation
    assert found.leader.share < 1e-2
    assert next(iter(found.of_labels().values())) > 0.9


@pytest.mark.slow
def test_nothing_is_claimed_where_nothing_is_missing() -> None:
    """At most one of twenty: more have a probability below 0.08 if each is wrong at 2 %."""
    claimed = [bool(searched(seed, lambda q, v: 0.0).leader.members) for seed in range(20)]
    assert sum(claimed) <= 1


@pytest.mark.long
def test_a_wrong_value_is_told_from_a_missing_force() -> None:
    found = searched(2, lambda q, v: 0.0, k=6.6)
    assert not found.leader.members
    (wrong,) = found.wrong
    assert wrong.name == "k"
    assert abs(wrong.value - 6.6) < 4.0 * wrong.deviation


@pytest.mark.long
def test_a_model_without_free_parameters_is_searched_too() -> None:
    text = "\n".join(line.split(", bounds")[0] + " }" if "bounds" in line else line
                     for line in MODEL.splitlines())  # fmt: skip
    simulator = Simulator(parse_model(text))
    assert not simulator.model.free_parameters
    rng = np.random.default_rng(5)
    prepared = [
        Prepared.build(simulator.model, recorded(rng, lambda q, v: -0.5 * v * abs(v)))
        for _ in range(2)
    ]
    found = posterior(simulator.model, prepared)
    assert found is not None
    (number,) = found.leader.members
    assert found.candidates[number].mechanism == "quadratic_drag"


@pytest.mark.long
def test_what_a_neighbouring_set_has_does_nothing_in_a_set_without_it() -> None:
    """A constant force stays in every model as what stands for unknown forces: at nothing."""
    rng = np.random.default_rng(7)
    simulator = Simulator(parse_model(MODEL))
    runs = [recorded(rng, lambda q, v: 1.5 - 3.0 * q**3) for _ in range(2)]
    found = posterior(simulator.model, [Prepared.build(simulator.model, r) for r in runs])
    assert found is not None
    labels = {found.candidates[i].mechanism for i in found.leader.members}
    assert labels == {"constant_force", "cubic_stiffness"}
    alone = [h for h in found.hypotheses if len(h.members) == 1]
    assert max(h.log_evidence for h in alone) < found.leader.log_evidence - 20.0


def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """What grows by one with every linearisation of an estimate."""
    done, linearised = [], estimate.linearised

    def one_more(*args):
        done.append(1)
        return linearised(*args)

    monkeypatch.setattr(estimate, "linearised", one_more)
    return done


def test_an_estimate_ends_with_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    done = counted(monkeypatch)
    model = Simulator(parse_model(MODEL)).model
    run = recorded(np.random.default_rng(1), lambda q, v: -3.0 * q**3)
    assert followed(model, [Prepared.build(model, run)], lambda: len(done) >= 2) is None
    assert len(done) <= 2 + len(estimate.HALVED)


def test_a_search_that_time_ends_amid_a_step_has_not_looked_at_everything(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done = counted(monkeypatch)
    model = Simulator(parse_model(MODEL)).model
    run = recorded(np.random.default_rng(1), lambda q, v: 0.0)
    course = followed(model, [Prepared.build(model, run)])
    assert course is not None
    before = len(done)
    found = posterior_along(model, course, stop=lambda: len(done) > before + 12)
    assert found is not None and not found.timely
    assert len(done) <= before + 13 + len(estimate.HALVED)


def test_a_latent_force_as_large_as_the_net_force_is_improbable_beforehand() -> None:
    none, small, net, twice = log_odds(np.array([0.0, 1e-6, 1.0, 2.0]))
    assert none == 0.0
    assert np.exp(small) == pytest.approx(1.0 / 7.0, rel=1e-5)
    assert np.exp(net - small) == pytest.approx(0.05, rel=1e-5)
    assert net - twice == pytest.approx(small - net, rel=1e-5)
    assert not sizes_about(0.0, np.zeros(1)).any()


def found(
    log: float, settled: bool, members: tuple[int, ...] = (), share: float = 0.0
) -> Hypothesis:
    """An estimate of some log evidence, and nothing else."""
    nothing, noise = np.zeros(0), Noise(np.ones(1), np.zeros(1), np.zeros(1))
    return Hypothesis(members, log, share, {}, {}, nothing, nothing, settled, noise, 0.0)


@pytest.mark.parametrize(
    ("passes", "kept", "rests"),
    [
        ([(50.0, False), (60.0, False), (58.0, True), (99.0, True)], 58.0, True),
        ([(50.0, False), (50.5, False), (99.0, True)], 50.5, True),
        ([(50.0, False), (30.0, False), (30.5, False), (99.0, True)], 30.5, True),
        ([(50.0, False), (30.0, False), (9.0, False), (99.0, True)], 9.0, False),
        ([(3.0, False), (99.0, True)], 3.0, False),
    ],
)
def test_what_would_lead_is_followed_until_it_rests_or_ends_alike(
    monkeypatch: pytest.MonkeyPatch,
    passes: list[tuple[float, bool]],
    kept: float,
    rests: bool,
) -> None:
    """What it was promised and has not where its steps lead is gone; what is behind is left."""
    candidate = SimpleNamespace(label="drag@v", physical=None, tried=1)
    every = SimpleNamespace(candidates=(candidate, candidate))
    work: Any = SimpleNamespace(super_model=every, stop=lambda: False)
    null, made, table = found(10.0, True), iter(passes), cast(Any, None)
    state = State(work, table, {(): null})
    monkeypatch.setattr(loop, "hypothesis", lambda *_: found(*next(made), members=(0,)))
    known, due = loop._estimated(state, null, [(0,)])
    assert not due
    estimate = known[(0,)]
    assert estimate is not None
    assert (estimate.log_evidence, estimate.settled) == (kept, rests)


@pytest.mark.parametrize(
    ("settled", "share", "asked"), [(True, 0.0, 2), (True, 0.1, 3), (False, 0.0, 3)]
)
def test_additions_end_with_one_that_leads_and_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, settled: bool, share: float, asked: int
) -> None:
    """What may stand in its place is asked about its own path; rivals are all estimated."""
    every = SimpleNamespace(
        candidates=[SimpleNamespace(label=f"{i}@v", physical=None, tried=1) for i in range(4)]
    )
    work: Any = SimpleNamespace(super_model=every, stop=lambda: False)
    leader, table = found(10.0, True, (3,), share=0.2), cast(Any, None)
    logs: dict[tuple[int, ...], float] = {(0, 3): 5.0, (1, 3): 50.0, (2, 3): 20.0}

    away = cycle((0.0, 0.0 if settled else 2.0))  # what does not rest ends elsewhere every time

    def estimate(w: Any, t: Any, m: tuple[int, ...], *_: Any) -> Hypothesis:
        return found(logs[m] + next(away), settled, m, share if logs[m] > 10.0 else 0.2)

    monkeypatch.setattr(loop, "hypothesis", estimate)
    for module in (loop, states):
        monkeypatch.setattr(module, "believable", lambda *_: True)
    state = State(work, table, {(3,): leader})
    known, due = loop._estimated(state, leader, list(logs))
    assert len(known) == 1 + asked and not due
    known, _ = loop._estimated(state, leader, list(logs), again=True)
    assert len(known) == 4
    null = found(10.0, True, share=0.2)  # beside re-calibration all are asked
    known, _ = loop._estimated(State(work, table, {(): null}), null, list(logs))
    assert len(known) == 4


def test_of_two_estimates_alike_the_one_at_rest_stands() -> None:
    """A set that never comes to rest by a hair is no other set; one that gains clearly is ahead."""
    restless, rested = found(100.2, False), found(100.1, True)
    assert better(restless, rested) is better(rested, restless) is rested
    ahead = found(100.2, False)
    assert better(ahead, found(90.0, True)) is ahead
    assert better(None, rested) is rested and better(None, None) is None


def test_what_there_was_no_time_for_was_not_asked_about(monkeypatch: pytest.MonkeyPatch) -> None:
    labels = ("drag@v", "spring@v", "lag@u")
    every = SimpleNamespace(
        candidates=[SimpleNamespace(label=x, physical=None, tried=1) for x in labels]
    )
    over = iter([False, False, True, True])  # asked once a proposal
    work: Any = SimpleNamespace(
        super_model=every,
        stop=lambda: next(over),
        prepared=(),
        rows=(),
        force_states=(0,),
    )
    null, table = found(10.0, True), cast(Any, None)
    state = State(work, table, {(): null})
    monkeypatch.setattr(loop, "hypothesis", lambda w, t, m, *_: found(0.0, True, members=m))
    for module in (loop, states):
        monkeypatch.setattr(module, "believable", lambda *_: True)
    known, due = loop._estimated(state, null, [(0,), (1,), (2,)])
    assert set(known) == {(), (0,), (1,)} and due == ((2,),)
    told = Posterior.of(replace(state, known=known, due=due))
    assert not told.timely
    assert told.asked == {"drag@v", "spring@v"}
    after = replace(state, known=known, due=due, rivalled={(): 10.0})
    assert Posterior.of(after).asked == {"drag@v", "spring@v"}
    assert Posterior.of(replace(after, due=())).asked == set(labels)


CAR = """
[model]
name = "car"
states = ["v", "F"]
inputs = ["u"]
outputs = ["y"]
input_hold = "linear"
[equations]
v = "(F - m*9.81*f - c*v*Abs(v))/m"
F = "(u - F)/T"
[readings]
y = "v"
[parameters]
m = { value = 1300.0 }
f = { value = 0.015, bounds = [0.005, 0.05] }
c = { value = 0.36, bounds = [0.1, 1.0] }
T = { value = 0.33, bounds = [0.1, 1.0] }
"""


def car(rng: np.random.Generator) -> Recording:
    """A car whose speed is read with noise that keeps its sign for half a second."""
    time, noise = 0.1 * np.arange(300), np.zeros(300)
    drive = np.repeat(rng.choice([-1000.0, 0.0, 1500.0], 15), 20)

    def rate(t: float, x: np.ndarray) -> list[float]:
        drag = 1300.0 * 9.81 * 0.015 + 0.36 * x[0] * abs(x[0])
        return [(x[1] - drag) / 1300.0, (np.interp(t, time, drive) - x[1]) / 0.33]

    run = solve_ivp(rate, (0.0, time[-1]), [20.0, drive[0]], t_eval=time, rtol=1e-9, max_step=0.1)
    for k in range(1, 300):
        noise[k] = 0.8 * noise[k - 1] + 0.6 * rng.normal()
    return Recording("run", time, {"u": drive, "y": run.y[0] + 5e-3 * noise})


@pytest.mark.slow
def test_no_force_stands_where_re_calibration_without_one_is_likelier() -> None:
    """Noise that keeps its sign, and a force that does, are two modes of the same recordings."""
    simulator = Simulator(parse_model(CAR))
    odds = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        prepared = [Prepared.build(simulator.model, car(rng)) for _ in range(2)]
        course = followed(simulator.model, prepared)
        assert course is not None
        every = SuperModel.build(simulator.model, offered(simulator.model, course, ()))
        work = Workspace.build(every, course.prepared, course.seconds, course.null.noise)
        state = loop.begun(work, course.null)
        odds.append(loop.odds_of_force(state, state.leader))
    assert min(odds) > -loop.RENEWED
