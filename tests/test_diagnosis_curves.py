"""A force as a free curve over one state, and the law that is read off it."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from diagnosis_systems import CART, TWO_MASSES
from scipy.integrate import solve_ivp

from jaxsr import diagnose
from jaxsr._progress import Budget
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.contest.arena import build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.diagnose import leaving_time
from jaxsr.diagnosis.judging.noise_ratio import residual_to_noise
from jaxsr.diagnosis.laws.curves import BUMPS, Curve, _root_of_precision, _sight, curves_at
from jaxsr.diagnosis.laws.newcomers import _with_curves, with_candidates
from jaxsr.diagnosis.laws.unnamed import (
    crowded,
    crowded_over_position,
    has_a_name,
    worth_no_name,
)
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare
from jaxsr.expressions import evaluate, parse
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.recordings import Recording

CURVE = Curve("v", "q", -0.3, 0.5)


def detent(q):
    """A force that pulls to the middle near it, and far away no longer."""
    s = q / 0.4
    return -4.0 * s / (1.0 + s**2) ** 2


def test_a_curve_is_written_as_it_is_computed():
    candidate, zeros = CURVE.proposed()
    assert candidate.site == "equation:v" and not zeros.any() and not candidate.sharp
    rng = np.random.default_rng(0)
    x, c = rng.uniform(-0.3, 0.5, 50), rng.normal(size=BUMPS)
    names = {f"c{k}": f"c{k}" for k in range(1, BUMPS + 1)}
    text = candidate.terms[0][1].format(**names).removeprefix("+ ")
    values = evaluate(parse(text), {"q": x, **dict(zip(names, c, strict=True))})
    np.testing.assert_allclose(values, CURVE.basis(x) @ c, rtol=1e-4, atol=1e-4)


def test_bumps_follow_a_smooth_law_within_a_fiftieth():
    x = np.linspace(-0.3, 0.5, 400)
    s = (x - 0.1) / 0.4
    for law in (np.sin(3.0 * s), s**3, np.tanh(2.4 * s), 1.0 / (1.0 + (1.6 * s) ** 2), s):
        fitted = CURVE.basis(x) @ np.linalg.lstsq(CURVE.basis(x), law, rcond=1e-10)[0]
        assert np.std(fitted - law) < 0.02 * np.std(law)


def test_the_precision_of_some_parameters_is_that_of_their_own_covariance():
    """The inverse of a block of the covariance, others estimated along; what is blind is left."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        jacobian = rng.normal(size=(200, 6))
        residual = rng.normal(size=(1, 200, 1))
        fit = SimpleNamespace(
            normal_equations=lambda j=jacobian: ((j.T @ j)[None], None),
            active=np.array([2, 3, 5, 7, 8, 9]),
            cost=float(np.sum(residual**2)),
            residual=residual,
        )
        root = _root_of_precision(SimpleNamespace(fit=fit, converters=None), [5, 8, 9])
        own = np.linalg.inv(np.linalg.inv(jacobian.T @ jacobian)[np.ix_([2, 4, 5], [2, 4, 5])])
        ratio = (root.T @ root) / own
        np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-6)
        assert 0.5 < ratio[0, 0] < 2.0  # independent residuals of unit variance


def test_a_law_counts_by_how_well_the_data_tell_it_from_the_curve():
    """(c - c_g)' P (c - c_g) for a law of bumps; more for one that no bumps follow."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(BUMPS, BUMPS))
    grid, onto = _sight(CURVE, rng.uniform(-0.3, 0.5, 5000), root)
    for _ in range(20):
        c = rng.normal(size=BUMPS)
        seen = onto @ (CURVE.basis(grid) @ c)
        assert seen @ seen == pytest.approx(np.sum((root @ c) ** 2), rel=1e-4)
    jagged = onto @ np.sign(np.sin(60.0 * grid))
    assert jagged @ jagged > 0.1 * np.sum(root**2)


def test_powers_drags_and_ripples_have_names():
    def proposal(*texts: str):
        return SimpleNamespace(terms=tuple(parse(t) for t in texts))

    for named in (("q",), ("q**3", "q"), ("q*Abs(q)",), ("sin(3.1*q + 0.2)", "q"), ("q**2*q",)):
        assert has_a_name(proposal(*named)), named
    for law in (("q*exp(-q**2)",), ("q/(q**4 + 1.7)",), ("q**5",), ("q", "tanh(3*q)"), ("1/q",)):
        assert not has_a_name(proposal(*law)), law


@cache
def _cart(law):
    """A cart whose spring lacks a force over the way, and the case of its diagnosis."""
    rng = np.random.default_rng(3)
    time, phases = np.arange(0.0, 30.0, 0.01), rng.uniform(0.0, 6.0, 8)
    waves = np.linspace(0.15, 2.0, 8)
    u = 4.0 * np.sin(2 * np.pi * waves * time[:, None] + phases).sum(1)

    def rates(t, x):
        return [x[1], (np.interp(t, time, u) - 3.0 * x[1] - 8.0 * x[0] + law(x[0])) / 2.0]

    path = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-9, max_step=0.01)
    y = path.y[0] + 1e-3 * rng.normal(size=time.size)
    simulator = Simulator(parse_model(CART))
    data = prepare(simulator.model, [Recording("cart.csv", time, {"u": u, "y": y})])
    return Case(simulator, data, None, Budget(), Budget()), path.y[0]


def _field(case):
    super_model = SuperModel.build(case.simulator.model, [])
    setting = Stepping("rk4", 1), 2.0, np.array([1e-3]), case.simulator
    arena = build_arena(super_model, case.prepared, *setting)
    return arena, [enter(arena, (), neutral_values(super_model))]


@pytest.mark.long
def test_a_curve_in_free_run_is_the_force_that_is_missing():
    """Up to a line, which the free spring of the model takes as well."""
    case, way = _cart(detent)
    arena, entries = _field(case)
    curves = curves_at(case, entries[0], "v")
    assert [c.variable for c in curves] == ["q", "v"]
    wider, found = _with_curves(
        case, (arena, entries), entries[0], curves, (), np.random.default_rng(0)
    )
    over_q, over_v = (next(e for e in found if e.members == (k,)) for k in (0, 1))
    assert over_q.fit.cost < 0.05 * over_v.fit.cost
    assert residual_to_noise(wider, over_q) < 1.2 < 5.0 < residual_to_noise(arena, entries[0])
    own = wider.super_model.index(0)
    force = curves[0].basis(way) @ over_q.fit.theta[own]
    line = np.stack([way, np.ones_like(way)], axis=1)
    left = force - detent(way)
    left -= line @ np.linalg.lstsq(line, left, rcond=None)[0]
    assert np.std(left) < 0.08 * np.std(detent(way))
    # what is read off the curve keeps to it in free run
    laws = [e for e in found if e.members and e.members[-1] > 1]
    assert laws and min(e.fit.cost for e in laws) < 1.3 * over_q.fit.cost


def test_candidates_enter_by_themselves_and_what_was_known_stays():
    case, _ = _cart(detent)
    arena, entries = _field(case)
    proposals = [(c.proposed(),) for c in curves_at(case, entries[0], "v")]
    wider, found = with_candidates(case, (arena, entries), entries[0], proposals, ((), ()))
    assert [e.members for e in found] == [(), (0,), (1,)]
    assert found[0].fit.cost == entries[0].fit.cost
    assert len(wider.super_model.candidates) == 2


def test_springs_and_ripples_at_one_equation_are_one_law_of_its_position():
    names = "linear_stiffness viscous_damping position_ripple cubic_stiffness".split()
    sites = ("equation:v", "equation:v", "equation:v", "equation:w")
    shaped = (False, False, True, False)
    candidates = [
        SimpleNamespace(mechanism=m, site=s, parameters=[SimpleNamespace(coefficient=not inner)])
        for m, s, inner in zip(names, sites, shaped, strict=True)
    ]
    arena = SimpleNamespace(super_model=SimpleNamespace(candidates=candidates))
    crowds = crowded_over_position(arena, SimpleNamespace(members=(0, 1, 2, 3)))
    assert crowds == [("v", (1, 3))]
    assert crowded_over_position(arena, SimpleNamespace(members=(0, 1, 3))) == []
    candidates[2].parameters[0].coefficient = True  # powers alone are the series of a spring
    assert crowded_over_position(arena, SimpleNamespace(members=(0, 1, 2, 3))) == []


@pytest.mark.parametrize(("alone", "asked"), [(0.5, True), (0.01, False)])
def test_a_push_beside_a_force_asks_for_one_law_unless_one_alone_does_most(alone, asked):
    """A push can stand for what a law does once: it counts as one of the forces."""
    kinds = (("dissipative", False), ("external", True), ("measurement", False))
    candidates = [
        SimpleNamespace(family=family, passing=passing, site=f"{where}:v")
        for (family, passing), where in zip(kinds, ("equation", "input", "sensor"), strict=True)
    ]
    arena = SimpleNamespace(super_model=SimpleNamespace(candidates=candidates))
    costs = {(): 1.0, (2,): 1.0, (0, 2): alone, (1, 2): 0.6, (0, 1, 2): 0.001}
    entries = [
        SimpleNamespace(members=members, fit=SimpleNamespace(cost=cost))
        for members, cost in costs.items()
    ]
    found = crowded(arena, entries[-1], entries)
    assert found == ([("v", (2,))] if asked else [])
    # a fault of the sensor is no force
    assert crowded(arena, SimpleNamespace(members=(0, 2)), entries) == []


def test_a_nameless_law_at_the_noise_must_be_the_shorter_one(monkeypatch):
    """n log(cost) + k log(n): eight constants more pay for log(n)/n of the cost each."""
    monkeypatch.setattr("jaxsr.diagnosis.laws.unnamed.residual_to_noise", lambda *_: 1.0)
    noise = np.random.default_rng(4).normal(size=(1, 2000, 1))

    def entry(cost: float, constants: int):
        fit = SimpleNamespace(cost=cost, active=np.arange(constants), residual=noise)
        return SimpleNamespace(fit=fit, converters=None, constants=constants)

    named = entry(1000.0, 4)
    assert not worth_no_name(None, entry(999.0, 12), named)
    assert worth_no_name(None, entry(960.0, 12), named)
    assert not worth_no_name(None, entry(1001.0, 4), named)
    assert worth_no_name(None, entry(1000.0, 2), named)


@pytest.mark.parametrize(
    ("took", "reading", "kept"),
    [(0.1, 1.0, 13.2), (0.1, 9.0, 18.0), (2.0, 1.0, 20.0), (2.0, 12.0, 24.0), (9.0, 1.0, 27.0)],
)
def test_a_slow_leading_set_or_slow_reading_leaves_more_time_for_the_report(took, reading, kept):
    budget = Budget(60.0)
    case = Case(SimpleNamespace(), (), None, budget, budget.keeping(20.0))
    entries = [
        SimpleNamespace(fit=SimpleNamespace(cost=c), seconds=s)
        for c, s in ((9.0, 30.0), (1.0, took))
    ]
    left = leaving_time(case, entries, reading)
    assert budget.remaining - left.search.remaining == pytest.approx(kept, abs=0.1)


@pytest.mark.long
def test_a_law_without_a_name_is_found_where_its_equation_hides():
    """Only the first of two masses is measured; a detent acts on the second."""
    rng = np.random.default_rng(5)
    time, phases = np.arange(0.0, 60.0, 0.02), rng.uniform(0.0, 6.0, 8)
    u = 3.0 * np.sin(2 * np.pi * np.linspace(0.1, 1.2, 8) * time[:, None] + phases).sum(1)

    def rates(t, x):
        a, b, va, vb = x
        first = np.interp(t, time, u) - 9.0 * a - 0.4 * va + 6.0 * (b - a)
        return [va, vb, first, -4.0 * b - 0.3 * vb + 6.0 * (a - b) + 1.6 * detent(b)]

    path = solve_ivp(rates, (0.0, time[-1]), np.zeros(4), t_eval=time, rtol=1e-9, max_step=0.02)
    y = path.y[0] + 2e-3 * rng.normal(size=time.size)
    model = parse_model(TWO_MASSES.replace('"y", "z"', '"y"').replace('z = "b"\n', ""))
    found = diagnose(Simulator(model), [Recording("a.csv", time, {"u": u, "y": y})], budget=120.0)
    first = found.findings[0]
    assert (first["mechanism"], first["site"]) == ("unnamed", "equation:vb")
    train = found.fit["train"]
    assert train["explained"][-1] < 0.5 * train["recalibrated"][-1]


@pytest.mark.long
def test_damping_by_the_square_of_the_way_is_no_friction_that_jumps():
    """Dry friction by the position, its jump rounded over all speeds, would be the same law.

    The explained model, run as it is written, has the errors that are reported.
    """

    def squeezed(t, x):
        force = np.interp(t, time, u) - 3.0 * x[1] - 8.0 * x[0] - 4.0 * x[0] ** 2 * x[1]
        return [x[1], force / 2.0]

    rng = np.random.default_rng(8)
    time, phases = np.arange(0.0, 20.0, 0.02), rng.uniform(0.0, 6.0, 8)
    u = 8.0 * np.sin(2 * np.pi * np.linspace(0.1, 1.2, 8) * time[:, None] + phases).sum(1)
    path = solve_ivp(squeezed, (0.0, 20.0), [0.0, 0.0], t_eval=time, rtol=1e-9, max_step=0.02)
    y = path.y[0] + 2e-3 * rng.normal(size=time.size)
    recording = Recording("a.csv", time, {"u": u, "y": y})
    found = diagnose(Simulator(parse_model(CART)), [recording], budget=60.0)
    first = found.findings[0]
    assert (first["mechanism"], first["site"]) == ("unnamed", "equation:v")
    run = found.explained.simulate(recording)
    error = np.sqrt(np.mean((run.channels["y"] - y) ** 2)) / np.std(y)
    train = found.fit["train"]
    assert train["explained"][-1] < 0.5 * train["recalibrated"][-1]
    assert error < 1.5 * train["explained"][-1]
