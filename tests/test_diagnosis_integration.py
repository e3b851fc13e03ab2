"""How finely sets with laws that jump are integrated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnosis_systems import on_an_axis, simulator_of

from jaxsr.diagnosis.judging.plausible import STEEPEST, plausible, sound_members
from jaxsr.diagnosis.mechanisms.dissipative import dissipative
from jaxsr.diagnosis.mechanisms.elastic import elastic
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, in_steps_of, neutral_values
from jaxsr.diagnosis.shooting.enter import ITERATIONS, enter
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.diagnosis.shooting.integration import (
    FINEST,
    STABLE,
    TOLERABLE,
    _substeps,
    accurate,
    steady,
    with_steps,
)
from jaxsr.diagnosis.shooting.reduced import reduce
from jaxsr.diagnosis.shooting.uncertainty import half_widths
from jaxsr.models import Simulator, parse_model
from jaxsr.models.lifting import carried_errors
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

PENDULUM = on_an_axis(
    "u - k*sin(q) - c*v",
    {
        "M": "value = 1.0",
        "k": "value = 20.0, bounds = [1.0, 100.0]",
        "c": "value = 0.1, bounds = [0.0, 5.0]",
    },
)
FRICTION, STEP, SAMPLES, NOISE = 0.25, 0.03, 500, 2e-3
STEEP = PENDULUM.replace("- c*v", "- c*v - 0.25*tanh(v/0.004)")
CUBIC, SETS = "cubic_stiffness@equation:v", ((), (0,))


def swinging(seed: int, friction: float = FRICTION, noise: float = NOISE) -> Recording:
    """A pendulum with dry friction and viscous damping, integrated in 200 steps a sample."""
    rng = np.random.default_rng(seed)
    tones = rng.uniform(0.5, 7.0, 4), rng.uniform(0.0, 6.0, 4)
    time = STEP * np.arange(SAMPLES)
    push = np.sin(np.outer(time, tones[0]) + tones[1]).sum(1)
    fine, q, v, angle = 200, 0.3, 0.0, np.empty(SAMPLES)
    h = STEP / fine
    for k in range(SAMPLES):
        angle[k] = q
        following = push[min(k + 1, SAMPLES - 1)]
        for j in range(fine):
            u = push[k] + (following - push[k]) * j / fine
            free = v + h * (u - 20.0 * np.sin(q) - 0.1 * v)
            # Friction takes away as much momentum as it can, and never turns it round.
            v = np.sign(free) * max(abs(free) - h * friction, 0.0)
            q += h * v
    y = angle + noise * rng.normal(size=SAMPLES)
    return Recording("run.csv", time, {"u": push, "y": y})


def arena_of(seed: int, stepping: Stepping, friction: float = FRICTION) -> tuple[Arena, Entry]:
    """An arena of friction laws, and re-calibration in it."""
    model = parse_model(PENDULUM)
    prepared = [Prepared.build(model, swinging(seed, friction))]
    quantiles = np.linspace(0.0, 1.0, 21)
    scale = {
        s: np.nanquantile(prepared[0].states.values[:, i], quantiles)
        for i, s in enumerate(model.states)
    }
    laws = [c for c in dissipative(sites_of(model, scale)[0]) if "Fc" in c.terms[0][1]]
    super_model = SuperModel.build(model, laws[:2])
    simulator = simulator_of(super_model.model)
    widths = tuple(2e-3 * float(np.std(scale["v"])) for _ in simulator.smoothed_arguments)
    stepping = replace(stepping, widths=widths)
    arena = build_arena(super_model, prepared, stepping, None, np.array([NOISE]), simulator)
    return arena, enter(arena, (), neutral_values(super_model))


def test_as_many_steps_as_make_rk4_stable() -> None:
    """|R(-z)| <= 1 with R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24 for each of them."""
    for product in np.random.default_rng(0).uniform(0.0, 60.0, 300):
        number = _substeps(product)
        z = -product / number
        assert abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) <= 1.0
        assert number == 1 or product / (number / 2) > STABLE


def test_finer_steps_and_back_are_the_same_problem() -> None:
    arena, _ = arena_of(0, Stepping("rk4", 2))
    finer = with_steps(arena.problem, "rk4", 8)
    assert finer.segments.length.shape[1] == 8
    back = with_steps(finer, "rk4", 2).segments
    np.testing.assert_allclose(back.length, arena.problem.segments.length, rtol=1e-12)
    np.testing.assert_allclose(back.stages, arena.problem.segments.stages, atol=1e-12)
    free = arena.problem.segments  # a system without inputs
    free = replace(free, stages=free.stages[:, :0], inputs=free.inputs[:0])
    assert free.refined(4).stages.shape == (3, 0, free.time.shape[0] - 1, 8, free.number)


@pytest.mark.parametrize("seed", range(3))
def test_errors_of_steps_leave_the_fit_of_a_law_that_jumps_alone(seed: int) -> None:
    """From one step a sample on: the estimate is that of many steps, and so is the cost."""
    arena, null = arena_of(seed, Stepping("rk4", 1))
    entry = enter(arena, (0,), null.fit.theta, null.fit.path)
    assert entry.stepping is not None
    assert entry.stepping.substeps > 1
    (number,) = arena.super_model.index(0)
    half = half_widths(arena, entry.fit)[list(entry.fit.active).index(number)]
    assert abs(entry.fit.theta[number] - FRICTION) < 2.0 * half
    # the error that is left, by its definition
    own = reduce(arena.problem, arena.super_model, (0,))
    coarse, fine = (with_steps(own.problem, "rk4", n) for n in (entry.stepping.substeps, 64))
    setting = (coarse.stepping, coarse.segments), (fine.stepping, fine.segments)
    theta, path = entry.fit.theta[own.parameters], entry.fit.path
    assert path is not None
    apart = carried_errors(coarse.simulator, *setting, theta, path) / NOISE
    left = float(np.sum(coarse.segments.weights * apart**2))
    reached = left <= 4.0 * TOLERABLE**2 * entry.fit.cost
    assert reached or entry.stepping.substeps == FINEST["rk4"]


def test_after_a_decision_all_is_stepped_as_its_laws_ask() -> None:
    arena, null = arena_of(0, Stepping("rk4", 1))
    entry = enter(arena, (0,), null.fit.theta, null.fit.path)
    assert entry.stepping is not None
    same = in_steps_of(arena, entry).problem
    assert same.stepping.substeps == entry.stepping.substeps == same.segments.length.shape[1]
    coarse, _ = arena_of(0, Stepping("rk4", 1), friction=0.0)
    assert in_steps_of(coarse, enter(coarse, (), null.fit.theta)) is coarse


@pytest.mark.parametrize("seed", range(3))
def test_recalibration_is_not_charged_with_steps_that_are_too_few(seed: int) -> None:
    """Steep friction that the given model has, in steps that a spring would have to make up for."""
    simulator = simulator_of(parse_model(STEEP))
    prepared = (Prepared.build(simulator.model, swinging(seed, noise=0.2 * NOISE)),)
    offered = [c for s in sites_of(simulator.model, {}) for c in elastic(s) if c.label == CUBIC]
    super_model = SuperModel.build(simulator.model, offered[:1])
    own, scale = Simulator(super_model.model), np.full(1, 0.2 * NOISE)
    costs = []
    for stepping in (Stepping("rk4", 1), Stepping("rk4", 64)):
        arena = build_arena(super_model, prepared, stepping, None, scale, own)
        costs += [enter(arena, members, neutral_values(super_model)).fit.cost for members in SETS]
    coarse, fine = costs[: len(SETS)], costs[len(SETS) :]
    np.testing.assert_allclose(coarse, fine, rtol=0.03)
    quick = build_arena(super_model, prepared, Stepping("rk4", 1), None, scale, own)
    glance = enter(quick, (), neutral_values(super_model), max_iterations=ITERATIONS - 1)
    assert glance.fit.cost > 1.1 * fine[0]


def test_a_peak_above_three_times_the_friction_counts_where_the_data_allow_less() -> None:
    arena, null = arena_of(0, Stepping("rk4", 1))
    peak = enter(arena, (1,), null.fit.theta, null.fit.path)
    order = list(arena.super_model.model.parameters)
    names = arena.super_model.names[1]
    half = half_widths(arena, peak.fit)
    room = {order[j]: half[k] for k, j in enumerate(peak.fit.active)}
    theta = peak.fit.theta.copy()
    theta[order.index(names["Fc"])], theta[order.index(names["vs"])] = 1.0, 1.0
    most = room[names["Fs"]] + STEEPEST * room[names["Fc"]]
    for above, sound in ((0.9, True), (1.5, False)):
        theta[order.index(names["Fs"])] = STEEPEST + above * most
        entry = replace(peak, fit=replace(peak.fit, theta=theta.copy()))
        assert plausible(arena, entry) is sound
        assert sound_members(arena, entry) == ((1,) if sound else ())


def test_without_jumps_nothing_is_refined() -> None:
    arena, null = arena_of(0, Stepping("rk4", 1), friction=0.0)
    assert null.stepping is None
    own = reduce(arena.problem, arena.super_model, ())
    assert null.fit.path is not None
    same = accurate(own.problem, null.fit.theta[own.parameters], null.fit.path)
    assert same is own.problem


def test_friction_that_holds_a_mass_still_is_stepped_stably() -> None:
    """Stiffness of tanh(v/w) at standstill is F/(M w): more steps first, then the L-stable way."""
    arena, _ = arena_of(0, Stepping("rk4", 1))
    own = reduce(arena.problem, arena.super_model, (0,))
    (width,) = own.problem.stepping.widths
    (friction,) = own.active(np.array(arena.super_model.index(0)))
    theta = neutral_values(arena.super_model)[own.parameters]
    for product, method, substeps in ((1.0, "rk4", 1), (6.0, "rk4", 4), (60.0, "rodas3", 2)):
        theta[friction] = product * width / STEP
        stepping = steady(own.problem, theta).stepping
        assert (stepping.method, stepping.substeps) == (method, substeps)
