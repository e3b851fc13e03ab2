"""Laws without a name, written by the evolution in the tangent view of a free run."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from diagnosis_systems import TWO_MASSES
from scipy.integrate import solve_ivp

from jaxsr._progress import Budget
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.laws.naming import named
from jaxsr.diagnosis.laws.newcomers import _places, with_candidates
from jaxsr.diagnosis.laws.tangent import (
    Factor,
    TangentView,
    cost_left,
    states_between,
    surface,
)
from jaxsr.diagnosis.laws.tangent_laws import chosen_among, laws_at, places
from jaxsr.diagnosis.laws.unnamed import has_a_name
from jaxsr.diagnosis.locating.responses import Responses
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate, ParameterSpec
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.expressions import Term, evaluate, parse
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

TIME = np.arange(0.0, 20.0, 0.025)
NOISE = 2e-3
MODEL = parse_model(TWO_MASSES)
Law = Callable[[float, float], float]


def film(b: float, vb: float) -> float:
    """A damping that grows with the square of the way."""
    return -0.04 * vb * b**2


def recording(seed: int, law: Law) -> Recording:
    """Two positions with noise; the law acts at the second mass, whose speed no sensor shows."""
    rng = np.random.default_rng(seed)
    drive = np.repeat(12.0 * rng.normal(size=TIME.size // 8), 8)

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b, va, vb = x
        u = np.interp(t, TIME, drive)
        forces = u - 9 * a - 0.4 * va + 6 * (b - a), -4 * b - 0.3 * vb + 6 * (a - b) + law(b, vb)
        return [va, vb, *forces]

    run = solve_ivp(
        rates, TIME[[0, -1]], np.zeros(4), t_eval=TIME, rtol=1e-9, atol=1e-11, max_step=0.2
    )
    y, z = run.y[:2] + NOISE * rng.normal(size=(2, TIME.size))
    return Recording(f"{seed}.csv", TIME, {"u": drive, "y": y, "z": z})


SPRING = Candidate(
    "cubic_stiffness",
    "elastic",
    "equation:vb",
    (ParameterSpec("k3"),),
    "",
    terms=(("vb", "- {k3}*b**3"),),
)


@cache
def field(law: Law) -> tuple[Arena, Entry]:
    """The contest of one cubic spring, and re-calibration in it."""
    prepared = tuple(Prepared.build(MODEL, recording(seed, law)) for seed in (1, 2))
    super_model = SuperModel.build(MODEL, [SPRING])
    setting = Stepping("rk4", 2), 10.0, np.full(2, NOISE), Simulator(super_model.model)
    arena = build_arena(super_model, prepared, *setting)
    return arena, enter(arena, (), neutral_values(super_model))


def viewed(arena: Arena, entry: Entry, number: int) -> tuple[Responses, TangentView]:
    responses = Responses.of(arena, entry, sites_of(MODEL, {}))
    return responses, TangentView.of(responses, number, np.ones(entry.fit.active.size, bool))


def test_compressed_the_cost_of_any_forces_stays_what_it_is():
    """Against r'G (G'G)^-1 G'r with all readings, starts and parameters projected out."""
    arena, null = field(film)
    rng = np.random.default_rng(0)
    for number in (0, 1):
        responses, view = viewed(arena, null, number)
        assert view.cost(np.zeros((view.samples, 0))) == pytest.approx(null.fit.cost, rel=1e-3)
        assert view.target.size < responses.residual.size
        for _ in range(5):
            k = rng.normal(size=(3, 4))

            def shapes(s: int, r: Responses = responses, k: np.ndarray = k) -> np.ndarray:
                path = r.path[:4, : int(r.segments.count[s]), s]
                return np.sin(k @ (0.5 * (path[:, 1:] + path[:, :-1]))).T

            columns = np.concatenate([shapes(s) for s in range(responses.segments.number)])
            gain = responses.gains(number, shapes, 3)[0][0]
            assert null.fit.cost - view.cost(columns) == pytest.approx(gain, rel=0.02)


def test_a_force_that_is_taken_away_is_found_again():
    """From the free run with a spring: without it, a cube in its place leaves the same cost."""
    arena, null = field(lambda b, vb: -0.1 * b**3)
    fitted = enter(arena, (0,), null.fit.theta)
    place = next(p for p in places(arena, fitted) if p.site.state == "vb")
    assert place.rest == () and fitted.fit.cost < 0.1 * null.fit.cost
    view = place.view
    assert view.cost(np.zeros((view.samples, 0))) > 5.0 * fitted.fit.cost
    assert view.cost(view.variables["b"][:, None] ** 3) == pytest.approx(fitted.fit.cost, rel=0.01)


def test_a_surface_tells_the_equation_that_lacks_a_law():
    arena, null = field(film)
    first, second = places(arena, null)
    assert first.site.state == "vb" and first.cost < 0.5 * second.cost
    x = np.linspace(-2.0, 3.0, 50)
    products = surface([x, x[::-1]], (2, 1))
    assert products.shape == (50, 6)
    fitted = products @ np.linalg.lstsq(products, x**2 * x[::-1], rcond=None)[0]
    np.testing.assert_allclose(fitted, x**2 * x[::-1], atol=1e-9)


@pytest.mark.slow
def test_a_law_of_two_states_is_written_though_no_sensor_shows_one_of_them():
    arena, null = field(film)
    budget = Budget(60.0)
    case = Case(Simulator(MODEL), arena.prepared, None, budget, budget)
    place = places(arena, null)[0]
    laws = laws_at(case, place, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    b, vb = rng.uniform(-1.0, 1.0, 200), rng.uniform(-2.0, 2.0, 200)
    errors = []
    for ((candidate, values),) in laws:
        names = {p.name: p.name for p in candidate.parameters}
        own = dict(zip(names, values, strict=True))
        states = {"a": 0 * b, "va": 0 * b, "b": b, "vb": vb}
        force = evaluate(parse(candidate.terms[0][1].format(**names)), {**states, **own})
        errors.append(np.std(force - film(b, vb)) / np.std(film(b, vb)))
    assert min(errors) < 0.1


@pytest.mark.slow
def test_a_law_with_a_name_goes_by_it():
    """The contest knows the spring already: it stands for itself, and no set is tried twice."""
    arena, null = field(lambda b, vb: -0.1 * b**3)
    budget = Budget(60.0)
    case = Case(Simulator(MODEL), arena.prepared, None, budget, budget)
    place = next(p for p in places(arena, null) if p.site.state == "vb")
    laws = laws_at(case, place, np.random.default_rng(0))
    ((candidate, values),) = laws[0]
    assert candidate.key == SPRING.key and values == pytest.approx([0.1], rel=0.1)
    found = with_candidates(case, (arena, [null]), null, laws[:1], ((),))
    assert found[0] is arena and [e.members for e in found[1]] == [(), (0,)]
    again = with_candidates(case, found, null, laws[:1], ((),))
    assert [e.members for e in again[1]] == [(), (0,)]


PLAIN = [
    c
    for c in force_candidates(MODEL, {})
    if [p.coefficient for p in c.parameters] == [True] and [s for s, _ in c.terms] == ["vb"]
]


@pytest.mark.long
@pytest.mark.parametrize("mechanism", PLAIN, ids=lambda c: c.mechanism)
def test_a_course_names_its_mechanism(mechanism):
    rng = np.random.default_rng(0)
    site = next(s for s in sites_of(MODEL, {}) if s.state == "vb")
    states = dict(zip(MODEL.states, rng.normal(size=(4, 300)), strict=True))
    (spec,) = mechanism.parameters
    term = parse(mechanism.terms[0][1].format(**{spec.name: "c"}))

    def law(value: float) -> Term:
        return term.substitute({"c": Term.constant(value)})

    ((found, values),) = named(site, law(0.7), states)
    assert found.key == mechanism.key and values == pytest.approx([0.7])
    driving = named(site, law(-0.7), states)
    assert (driving == ()) == (spec.low == 0.0)
    other = Term.apply("mul", law(0.7), parse("1 + 0.3*tanh(3*b*vb)"))
    assert named(site, other, states) == ()


def test_simple_laws_that_explain_nearly_all_go_before_the_shortest_description():
    def law(text: str, size: int, cost: float):
        return SimpleNamespace(terms=(parse(text),), size=size, loss=cost), cost

    laws = [
        law("x**2*v", 7, 120.0),
        law("v*exp(x)", 9, 60.0),
        law("v/(x**2 + 3)", 10, 20.0),
        law("v/(x**2 + 3.1)*cos(x)", 15, 10.0),
    ]
    kept = chosen_among(laws, 2000.0, 1000.0)
    assert [p.size for p in kept] == [9, 10, 15]  # 95 %, 99 %, shortest
    assert chosen_among(laws, 60.5, 10.0) == []  # too few residuals for any
    assert chosen_among(laws, 5.0, 1000.0) == []
    jump = law("sign(x)*v**2", 6, 9.0)
    assert [p.size for p in chosen_among([*laws, jump], 2000.0, 1000.0)] == [9, 10, 15]
    jump = law("sign(x)*v**2", 6, 4.0)  # no smooth one comes near
    assert [p.size for p in chosen_among([*laws, jump], 2000.0, 1000.0)] == [6]


def test_a_lag_of_an_input_is_no_place_for_a_law():
    """Of the families of forces, but at no equation: all equations are asked."""
    sites = (("input:u", "memory"), ("equation:vb", "elastic"), ("output:y", "measurement"))
    candidates = [SimpleNamespace(site=site, family=family) for site, family in sites]
    arena = SimpleNamespace(super_model=SimpleNamespace(candidates=candidates))
    case = SimpleNamespace(simulator=SimpleNamespace(model=MODEL))
    assert _places(case, arena, SimpleNamespace(members=(0, 2))) == [
        ("va", (0, 2)),
        ("vb", (0, 2)),
    ]
    assert _places(case, arena, SimpleNamespace(members=(0, 1, 2))) == [("vb", (0, 2))]


def test_products_of_two_states_have_no_name():
    def proposal(*texts: str):
        return SimpleNamespace(terms=tuple(parse(t) for t in texts))

    assert has_a_name(proposal("x**2*Abs(x)"))
    assert not has_a_name(proposal("x**2*v"))


def test_a_pivoted_factor_is_the_form_that_eigenvectors_give():
    """|y - R'f|^2 needs no R of eigenvectors: the products are the same to what counts."""
    rng = np.random.default_rng(0)
    smooth = np.vander(np.linspace(-1.0, 1.0, 60), 12) @ rng.normal(size=(12, 300))
    gram, moment = smooth @ smooth.T, smooth @ rng.normal(size=(300, 3))
    factor = Factor.of(gram)
    assert factor.rows.shape[1] <= 12
    np.testing.assert_allclose(factor.rows @ factor.rows.T, gram, atol=1e-9 * gram.max())
    np.testing.assert_allclose(
        factor.rows @ factor.solved(moment), moment, atol=1e-8 * np.abs(moment).max()
    )
    nothing = Factor.of(np.zeros((4, 4)))
    assert nothing.rows.shape == (4, 0) and nothing.solved(np.zeros((4, 2))).shape == (0, 2)


@pytest.mark.parametrize("number", [0, 1])
def test_the_cost_of_few_forces_needs_no_response_to_all(number):
    """Directly, by the compressed view, and by the responses to a force at every step."""
    arena, null = field(film)
    responses, view = viewed(arena, null, number)
    kept, variables = np.ones(null.fit.active.size, bool), states_between(responses)
    columns = surface([variables["b"], variables["vb"]], (3, 2))
    acting = 0.02 * variables["b"] ** 2
    direct = cost_left(responses, number, kept, columns, acting)
    assert direct == pytest.approx(view.without(acting).cost(columns), rel=1e-6)
    dense = _by_all_responses(responses, number, columns, acting)
    assert direct == pytest.approx(dense, rel=1e-8)


def _by_all_responses(responses, number, columns, acting):
    """The same with every response at once, all readings one after another."""
    rows, target, sample = [], [], 0
    for s in range(responses.segments.number):
        steps, part = int(responses.segments.count[s]) - 1, responses.parts[s]
        residual = responses.residual[:, : steps + 1, s]
        flat = part.projected(responses.to(number, s, np.eye(steps)), residual).flat
        there = slice(sample, sample + steps)
        sample += steps
        left = residual.ravel()
        left = left - (part.starts @ left) @ part.inverse @ part.starts
        rows.append(np.concatenate([part.thetas, columns[there].T @ flat]).T)
        target.append(left + acting[there] @ flat)
    every, whole = np.concatenate(rows), np.concatenate(target)
    return float(np.sum((whole - every @ np.linalg.lstsq(every, whole, rcond=1e-9)[0]) ** 2))


def test_equations_are_ranked_without_a_factor_of_all_responses(monkeypatch):
    """A view is compressed where a law is written, not where one is promised."""
    arena, null = field(film)
    calls = []
    monkeypatch.setattr(Factor, "of", staticmethod(lambda gram: calls.append(gram)))
    places.cache_clear()
    assert len(places(arena, null)) == 2 and places(arena, null) is places(arena, null)
    places.cache_clear()
    assert not calls
