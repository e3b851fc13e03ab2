"""Hidden resonators located in free run: reaction, frequency, mass, silence in noise."""

from __future__ import annotations

import numpy as np
import pytest
from diagnosis_systems import TWO_MASSES
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.locating.located import with_located
from jaxsr.diagnosis.locating.resonances import reaction, resonance_candidates
from jaxsr.diagnosis.locating.responses import Responses
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.search.stepwise import expected
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

TIME = np.arange(0.0, 20.0, 0.025)
NOISE = 2e-4
PACE, DAMPING, MASS = 2.9, 0.06, 0.15  # slower than both modes


def recording(name: str, rng: np.random.Generator, mass: float) -> Recording:
    """A run with a random staircase as input and a resonator on the second mass."""
    drive = np.repeat(6.0 * rng.normal(size=TIME.size // 8), 8)

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b, va, vb, h, vh = x
        u = np.interp(t, TIME, drive)
        pull = PACE**2 * (b - h) + 2 * DAMPING * PACE * (vb - vh)
        forces = u - 9 * a - 0.4 * va + 6 * (b - a), -4 * b - 0.3 * vb + 6 * (a - b) - mass * pull
        return [va, vb, *forces, vh, pull]

    span = TIME[[0, -1]]
    run = solve_ivp(rates, span, np.zeros(6), t_eval=TIME, rtol=1e-9, atol=1e-11, max_step=0.2)
    x = run.y
    y, z = x[:2] + NOISE * rng.normal(size=(2, TIME.size))
    return Recording(name, TIME, {"u": drive, "y": y, "z": z})


def arena_of(seed: int, mass: float, horizon: float) -> tuple[Arena, Entry]:
    rng, model = np.random.default_rng(seed), parse_model(TWO_MASSES)
    prepared = tuple(Prepared.build(model, recording(f"r{k}.csv", rng, mass)) for k in range(2))
    super_model = SuperModel.build(model, [])
    setting = Stepping("rk4", 1), horizon, np.full(2, NOISE), Simulator(model)
    arena = build_arena(super_model, prepared, *setting)
    return arena, enter(arena, (), neutral_values(super_model))


@pytest.mark.parametrize(("pace", "damping"), [(1.0, 0.05), (4.0, 0.05), (4.0, 0.3), (15.0, 0.3)])
def test_the_reaction_is_that_of_the_equation_of_motion(pace: float, damping: float) -> None:
    rng = np.random.default_rng(0)
    tones = rng.uniform(0.5, 5.0, 4), rng.uniform(0.0, 6.0, 4)
    speed = np.sin(np.outer(TIME, tones[0]) + tones[1]).sum(1)
    course = CubicSpline(TIME, speed)
    way = course.antiderivative()

    def rates(t: float, x: np.ndarray) -> list[float]:
        return [x[1], pace**2 * (way(t) - x[0]) + 2 * damping * pace * (course(t) - x[1])]

    x = solve_ivp(rates, TIME[[0, -1]], [0.0, speed[0]], t_eval=TIME, rtol=1e-8, atol=1e-10).y
    force = -(pace**2 * (way(TIME) - x[0]) + 2 * damping * pace * (speed - x[1]))
    found = reaction(speed, 1.0 / 0.025, pace, damping)
    assert np.std(found - force) < 0.05 * np.std(force)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_resonator_is_located_where_it_swings(seed: int) -> None:
    arena, null = arena_of(seed, MASS, 5.0)
    responses = Responses.of(arena, null, sites_of(arena.super_model.given, {}))
    found = {c.site: c for c in resonance_candidates(arena, null, responses)}
    (_, pace, damping) = found["equation:vb"].parameters
    assert pace.neutral == pytest.approx(PACE, rel=0.1)
    assert damping.low < damping.neutral < damping.high
    assert found["equation:vb"].tried > 10


@pytest.mark.long
def test_nothing_is_located_once_time_has_ended() -> None:
    arena, null = arena_of(3, MASS, 5.0)
    wider, entries = with_located(arena, [null], lambda: True)
    assert wider is arena and entries == [null]


@pytest.mark.long
@pytest.mark.parametrize("horizon", [1.0, 5.0, 20.0])
def test_its_constants_are_estimated_over_segments_of_any_length(horizon: float) -> None:
    """A second is half a period: how the starts follow the constants decides."""
    arena, null = arena_of(3, MASS, horizon)
    wider, (again,) = with_located(arena, [null])
    labels = [c.label for c in wider.super_model.candidates]
    number = labels.index("hidden_mode@equation:vb")
    entry = enter(wider, (number,), again.fit.theta, again.fit.path)
    values = wider.super_model.own_values(number, entry.fit.theta)
    assert values["mh"] == pytest.approx(MASS, rel=0.1)
    assert values["wh"] == pytest.approx(PACE, rel=0.02)
    assert values["zh"] == pytest.approx(DAMPING, rel=0.2)
    assert entry.fit.cost < 0.1 * again.fit.cost


@pytest.mark.long
def test_one_linearisation_tells_what_a_memory_gains() -> None:
    arena, null = arena_of(3, MASS, 5.0)
    wider, (again,) = with_located(arena, [null])
    labels = [c.label for c in wider.super_model.candidates]
    number = labels.index("hidden_mode@equation:vb")
    trials = {t.members: t for t in expected(wider, again, {})}
    trial = trials[(number,)]
    assert trial.cost < 0.2 * again.fit.cost
    values = wider.super_model.own_values(number, trial.theta)
    assert values["mh"] == pytest.approx(MASS, rel=0.3)


@pytest.mark.long
def test_entries_keep_their_cost_where_a_memory_joins() -> None:
    arena, null = arena_of(3, MASS, 5.0)
    wider, (again,) = with_located(arena, [null])
    assert wider.super_model.model.driven
    assert again.fit.path is not None
    assert again.fit.path.shape[0] == again.fit.x0.shape[0] == len(wider.super_model.model.states)
    same = enter(wider, (), again.fit.theta, again.fit.path)
    assert same.fit.cost == pytest.approx(again.fit.cost, rel=1e-3)
    np.testing.assert_array_equal(again.fit.residual.shape, same.fit.residual.shape)


@pytest.mark.long
@pytest.mark.parametrize(
    "seeds", [range(3), pytest.param(range(3, 10), marks=pytest.mark.slow)], ids=str
)
def test_noise_alone_shows_no_resonator(seeds: range) -> None:
    """A proposal needs chi-squared 16 + 2 log(resonators): once in 10,000 grids by chance."""
    for seed in seeds:
        arena, null = arena_of(100 + seed, 0.0, 5.0)
        responses = Responses.of(arena, null, sites_of(arena.super_model.given, {}))
        assert resonance_candidates(arena, null, responses) == []
