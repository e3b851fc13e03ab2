"""Laws of joints and actuators on small plants: named, with odds against their rivals."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.evidence_plants import Dry, cart, drive
from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.loop import search
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.state import State
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms import Candidate, force_candidates
from jaxsr.diagnosis.mechanisms.load import loads
from jaxsr.diagnosis.mechanisms.presliding import bending
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import input_samples, state_scale
from jaxsr.expressions import evaluate
from jaxsr.models import Model, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.models.writing import model_text
from jaxsr.recordings import Recording

STEP, SAMPLES = 0.02, 300
TIME = STEP * np.arange(SAMPLES)
STILL = 1e-3
"""Speed within which the dry friction of a plant turns over."""
ARM = parse_model("""
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - d*v - w*sin(q)"
[inertia]
v = { v = "J" }
[readings]
y = "q"
[parameters]
J = { value = 1.0, unit = "kg*m^2", bounds = [0.3, 3.0] }
d = { value = 0.3, unit = "N*m*s/rad", bounds = [0.0, 2.0] }
w = { value = 6.0, unit = "N*m", bounds = [1.0, 20.0] }
[units]
q = "rad"
v = "rad/s"
u = "N*m"
y = "rad"
""")
WRIST = parse_model("""
[model]
states = ["q1", "q2", "v1", "v2"]
inputs = ["u1", "u2"]
outputs = ["y1", "y2"]
[equations]
q1 = "v1"
q2 = "v2"
v1 = "u1 - k*q1"
v2 = "u2 - k*q2"
[inertia]
v1 = { v1 = "J1" }
v2 = { v2 = "J2" }
[readings]
y1 = "q1"
y2 = "q2"
[parameters]
J1 = { value = 1.0, bounds = [0.3, 3.0] }
J2 = { value = 0.5, bounds = [0.1, 2.0] }
k = { value = 3.0, bounds = [0.5, 9.0] }
""")


def wave(rng: np.random.Generator, size: float, rates: Sequence[float]) -> np.ndarray:
    phases = rng.uniform(0.0, 2.0 * np.pi, len(rates))
    return size * np.sin(np.outer(TIME, rates) + phases).sum(axis=1)


def run(
    model: Model,
    rate: Callable,
    drives: Sequence[np.ndarray],
    rng: np.random.Generator,
    noise: float,
) -> Recording:
    """Follow q'' = rate(q, v, u) from rest and read the positions."""
    n = len(model.outputs)

    def field(t: float, x: np.ndarray) -> np.ndarray:
        u = np.array([np.interp(t, TIME, drive) for drive in drives])
        return np.concatenate([x[n:], np.atleast_1d(rate(x[:n], x[n:], u))])

    found = solve_ivp(
        field, (0.0, TIME[-1]), np.zeros(2 * n), "LSODA", TIME, rtol=1e-8, atol=1e-10, max_step=STEP
    )
    channels = dict(zip(model.inputs, drives, strict=True))
    for name, y in zip(model.outputs, found.y[:n], strict=True):
        channels[name] = y + noise * rng.normal(size=SAMPLES)
    return Recording("run", TIME, channels)


def searched(model: Model, recordings: Sequence[Recording], wanted: set[str]) -> State:
    prepared = [Prepared.build(model, r) for r in recordings]
    every = force_candidates(
        model, state_scale(model, prepared), None, input_samples(model, prepared)
    )
    chosen = [c for c in every if c.mechanism in wanted | {"constant_force"}]
    return search(Workspace.build(SuperModel.build(model, chosen), prepared, 10.0 * STEP))


def named(state: State) -> list[Candidate]:
    every = state.work.super_model.candidates
    return [every[i] for i in state.leader.members]


def odds_against(state: State, mechanism: str) -> float:
    """Log odds of the leader against the best set with another mechanism in its place."""
    every = state.work.super_model.candidates
    found = [
        state.log_posterior(h)
        for h in state.known.values()
        if h is not None and mechanism in {every[i].mechanism for i in h.members}
    ]
    return state.log_posterior(state.leader) - max(found, default=np.nan)


def value(state: State, name: str) -> tuple[float, float]:
    (number,) = state.leader.members
    return state.leader.constants[state.leader.names[number][name]]


DRY = {
    *("viscous_damping", "coulomb_friction", "stribeck_friction"),
    *("position_dependent_friction", "load_dependent_friction", "input_gain"),
}


def arm_with(friction: Callable, seed: int = 0) -> list[Recording]:
    rng = np.random.default_rng(seed)

    def rate(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        load = 0.5 * (u + 6.0 * np.sin(q))
        return u - 0.3 * v - 6.0 * np.sin(q) - friction(q, load) * np.tanh(v / STILL)

    drives = [wave(rng, 2.5, rates) for rates in ((0.7, 1.9, 3.7), (1.1, 2.6, 4.3))]
    return [run(ARM, rate, [drive], rng, 1e-3) for drive in drives]


@pytest.mark.long
def test_friction_that_grows_with_the_load_is_told_from_one_that_depends_on_the_place() -> None:
    state = searched(ARM, arm_with(lambda q, load: 0.2 + 0.15 * np.abs(load)), DRY)
    assert [c.mechanism for c in named(state)] == ["load_dependent_friction"]
    for name, truth in (("mu", 0.15), ("Fc", 0.2)):
        estimate, deviation = value(state, name)
        assert abs(estimate - truth) < 4.0 * deviation + 0.02
    for rival in ("coulomb_friction", "stribeck_friction", "position_dependent_friction"):
        assert odds_against(state, rival) > 5.0


@pytest.mark.slow
def test_friction_that_depends_on_the_place_is_no_friction_of_the_load() -> None:
    state = searched(ARM, arm_with(lambda q, load: 0.6 + 0.25 * q), DRY)
    assert [c.mechanism for c in named(state)] == ["position_dependent_friction"]
    assert odds_against(state, "load_dependent_friction") > 5.0


@pytest.mark.slow
def test_friction_of_constant_size_is_no_friction_of_the_load() -> None:
    state = searched(ARM, arm_with(lambda q, load: 0.6 + 0.0 * q), DRY)
    assert [c.mechanism for c in named(state)] == ["coulomb_friction"]


def test_the_sides_of_a_joint_are_read_off_its_equation() -> None:
    (site,) = sites_of(ARM, {})
    assert loads(site) == ["u", "sin(q)*w", "(u + sin(q)*w)/2"]


def test_a_load_is_written_with_the_definitions_of_the_model() -> None:
    # Written out, each level has the one before it twice: millions of characters in all.
    levels = [f'a{k + 1} = "a{k}*cos(a{k}/w)"' for k in range(20)]
    table = "\n".join(["[definitions]", 'a0 = "w*sin(q)"', *levels, "[equations]"])
    text = model_text(ARM).replace("[equations]", table).replace('w*sin(q)"\n\n', 'a20"\n\n')
    arm = parse_model(text)
    (site,) = sites_of(arm, {})
    assert loads(site) == ["u", "a20", "(u + a20)/2"]
    (edited,) = (
        c for c in force_candidates(arm, {}) if c.terms and "Abs(a20))*sign" in c.terms[0][1]
    )
    built = SuperModel.build(arm, [edited])
    term, own = built.model.equation_terms["v"], built.names[0]
    at = {"q": 0.3, "v": 0.2, "u": 0.0, "d": 0.0, "w": 6.0, own["Fc"]: 0.5, own["mu"]: 0.1}
    held = 6.0 * np.sin(0.3)
    for _ in range(20):
        held *= np.cos(held / 6.0)
    assert evaluate(term, at) == pytest.approx(-held - (0.5 + 0.1 * abs(held)))


@pytest.mark.long
@pytest.mark.parametrize("way", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_friction_on_two_speeds_is_told_from_friction_on_each(way: float) -> None:
    rng = np.random.default_rng(3)
    inertia, spring = np.array([1.0, 0.5]), 3.0

    def rate(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        both = v[0] + way * v[1]
        friction = 0.8 * np.tanh(both / STILL) + 0.3 * both
        return (u - spring * q - friction * np.array([1.0, way])) / inertia

    drives = [wave(rng, 1.6, (0.9, 2.3, 4.1)), wave(rng, 1.3, (1.3, 2.9, 3.5))]
    wanted = {"viscous_damping", "coulomb_friction", "coupling_damping", "coupled_friction"}
    state = searched(WRIST, [run(WRIST, rate, drives, rng, 1e-3)], wanted)
    (found,) = named(state)
    assert (found.mechanism, found.site) == ("coupled_friction", "equation:v1")
    assert f"v1 {'+' if way > 0 else '-'} v2" in found.terms[0][1]
    for name, truth in (("Fc", 0.8), ("Fv", 0.3)):
        estimate, deviation = value(state, name)
        assert abs(estimate - truth) < 4.0 * deviation + 0.02


INPUT = {
    *("input_gain", "input_saturation", "input_deadzone", "input_curve", "input_gain_by_state"),
    *("linear_stiffness", "cubic_stiffness", "quadratic_drag"),
}


@pytest.mark.parametrize(
    ("acting", "mechanism", "rival"),
    [
        (lambda q, v, u: u + 0.12 * u * np.abs(u), "input_curve", "input_saturation"),
        (lambda q, v, u: (1.0 + 0.25 * q) * u, "input_gain_by_state", "input_gain"),
        pytest.param(
            *(
                lambda q, v, u: (1.0 - 0.12 * np.abs(v)) * u,
                "input_gain_by_state",
                "quadratic_drag",
            ),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_an_actuator_whose_gain_varies_is_named(
    acting: Callable, mechanism: str, rival: str
) -> None:
    rng = np.random.default_rng(5)
    drives = [wave(rng, 2.0, rates) for rates in ((0.7, 1.9, 3.7), (1.1, 2.6, 4.3))]
    runs = [
        run(ARM, lambda q, v, u: acting(q, v, u) - 0.3 * v - 6.0 * np.sin(q), [d], rng, 1e-3)
        for d in drives
    ]
    state = searched(ARM, runs, INPUT)
    assert [c.mechanism for c in named(state)] == [mechanism]
    assert not odds_against(state, rival) < 5.0


CART = parse_model("""
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - d*v"
[inertia]
v = { v = "m" }
[readings]
y = "q"
[parameters]
m = { value = 1.3, bounds = [0.5, 4.0] }
d = { value = 0.4, bounds = [0.0, 3.0] }
""")


def rubbed(friction: Callable[[float, float], tuple[float, float]], seed: int) -> Recording:
    """Push a cart whose friction is F(v, z) with z' as its second value."""
    rng = np.random.default_rng(seed)
    push = wave(rng, 1.3, (0.9, 2.1, 3.3))

    def field(t: float, x: np.ndarray) -> list[float]:
        force, bend = friction(x[1], x[2])
        return [x[1], (np.interp(t, TIME, push) - 0.4 * x[1] - force) / 1.3, bend]

    found = solve_ivp(
        field, (0.0, TIME[-1]), np.zeros(3), "LSODA", TIME, rtol=1e-9, atol=1e-11, max_step=STEP
    )
    return Recording("run", TIME, {"u": push, "y": found.y[0] + 2e-4 * rng.normal(size=SAMPLES)})


def searched_with_memory(model: Model, recording: Recording) -> State:
    """Search among dry frictions, presliding offered where the residual forces ask for it."""
    course = followed(model, [Prepared.build(model, recording)])
    assert course is not None
    wanted = {"constant_force", "coulomb_friction", "stribeck_friction", "hysteresis"}
    chosen = [c for c in offered(model, course) if c.mechanism in wanted]
    work = Workspace.build(SuperModel.build(model, chosen), course.prepared, course.seconds)
    return search(work, course.null)


def test_presliding_and_slip_are_one_law() -> None:
    way = 0.02
    state = searched_with_memory(CART, rubbed(lambda v, z: (1.5 * z, (v - abs(v) * z) / way), 1))
    (found,) = named(state)
    assert found.mechanism == "hysteresis" and "{b}*(v - Abs(v)*{z})" in found.states[0].equation
    for name, truth in (("kz", 1.5), ("b", 1.0 / way)):
        estimate, deviation = value(state, name)
        assert abs(estimate - truth) < 4.0 * deviation + 0.02 * truth
    assert odds_against(state, "coulomb_friction") > 5.0  # alone or with a loop beside it


@pytest.mark.slow
def test_contacts_that_do_not_bend_are_no_presliding() -> None:
    plant = cart(dry={0: Dry(1.5, 1.5)})
    rng = np.random.default_rng(2)
    force = drive(rng, 200, 0.03, 3.0, (1.1, 2.3, 4.7))
    model = plant.simulator.model
    state = searched_with_memory(model, plant.recorded(rng, force, 0.03, 1e-4))
    assert [c.mechanism for c in named(state)] == ["coulomb_friction"]


def test_contacts_bend_along_a_path_as_their_rate_says() -> None:
    time = np.linspace(0.0, 6.0, 4001)
    path, way = np.sin(2.0 * time), 0.3

    def rate(t: float, z: np.ndarray) -> np.ndarray:
        v = 2.0 * np.cos(2.0 * t)
        return (v - abs(v) * z) / way

    exact = solve_ivp(rate, (0.0, 6.0), [0.0], t_eval=time, rtol=1e-9, atol=1e-11, max_step=0.01)
    found = bending(path, np.array([0, path.size]), np.array([way]))
    assert np.max(np.abs(found[:, 0] - exact.y[0])) < 2e-3
