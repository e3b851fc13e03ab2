"""Pushes located in free run: the gain foreseen, the place and time, silence in noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.locating.located import with_located
from jaxsr.diagnosis.locating.pushes import _scanned, push_candidates
from jaxsr.diagnosis.locating.responses import Responses
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.models.shooting import fit
from jaxsr.recordings import Recording

MODEL = """
[model]
name = "two masses, one of them seen"
states = ["a", "b", "va", "vb"]
inputs = ["u"]
outputs = ["y"]
[equations]
a = "va"
b = "vb"
va = "u - 9*a - 0.4*va + 6*(b - a)"
vb = "-4*b - 0.3*vb + 6*(a - b)"
[readings]
y = "a"
"""
TIME = np.arange(0.0, 10.0, 0.025)
NOISE, CENTRE, WIDTH = 2e-3, 6.0, 0.25


def recording(name: str, rng: np.random.Generator, impulse: float) -> Recording:
    """A run with a sine sweep as input and, if asked, a push on the mass that nobody sees."""
    drive = np.sin(TIME * (1.0 + rng.uniform(0.0, 0.3) * TIME))

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b, va, vb = x
        force = impulse * np.exp(-(((t - CENTRE) / WIDTH) ** 2)) / WIDTH / np.sqrt(np.pi)
        u = np.interp(t, TIME, drive)
        return [
            va,
            vb,
            u - 9 * a - 0.4 * va + 6 * (b - a),
            -4 * b - 0.3 * vb + 6 * (a - b) + force,
        ]

    x = solve_ivp(rates, TIME[[0, -1]], np.zeros(4), t_eval=TIME, rtol=1e-9, atol=1e-11).y
    y = x[0] + NOISE * rng.normal(size=TIME.size)
    return Recording(name, TIME, {"u": drive, "y": y})


def arena_of(seed: int, impulse: float) -> tuple[Arena, Entry]:
    """Three recordings, the second one pushed; nothing is free but the starts."""
    rng, simulator = np.random.default_rng(seed), Simulator(parse_model(MODEL))
    items = [recording(f"r{k}.csv", rng, impulse if k == 1 else 0.0) for k in range(3)]
    prepared = tuple(Prepared.build(simulator.model, item) for item in items)
    super_model = SuperModel.build(simulator.model, [])
    scale = np.array([NOISE])
    arena = build_arena(super_model, prepared, Stepping("rk4", 1), 5.0, scale, simulator)
    return arena, enter(arena, (), neutral_values(super_model))


def responses_of(arena: Arena, entry: Entry) -> Responses:
    return Responses.of(arena, entry, sites_of(arena.super_model.given, {}))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_push_on_an_unseen_mass_is_located_in_its_recording(seed):
    arena, null = arena_of(seed, 0.1)
    found = push_candidates(arena, null, responses_of(arena, null))
    (own,) = [c for c in found if c.site == "external:vb"]
    assert abs(own.parameters[1].neutral - CENTRE) < 0.4
    assert {c.quiet for c in found} == {("r0.csv", "r2.csv")}
    assert own.tried > 100


@pytest.mark.long
def test_the_gain_foreseen_is_the_gain_of_the_estimate():
    """The model is linear: the cost falls with J exactly as the projection says."""
    arena, null = arena_of(4, 0.1)
    best = max((p for p, _ in _scanned(arena, responses_of(arena, null))), key=lambda p: p.gain)
    new, entries = with_located(arena, [null])
    order = list(new.super_model.model.parameters)
    names = new.super_model.names[0]
    theta = entries[0].fit.theta.copy()
    theta[order.index(names["t0"])], theta[order.index(names["dt"])] = best.centre, best.width
    found = fit(
        new.problem, theta, np.array([order.index(names["J"])]), new.bounds, path=null.fit.path
    )
    assert abs((null.fit.cost - found.cost) / best.gain - 1.0) < 0.02


@pytest.mark.long
@pytest.mark.parametrize(
    "seeds", [range(5), pytest.param(range(5, 15), marks=pytest.mark.slow)], ids=str
)
def test_noise_alone_shows_no_push(seeds):
    """A proposal needs chi-squared 16 + 2 log(windows): less than once in 10,000 recordings."""
    for seed in seeds:
        arena, null = arena_of(100 + seed, 0.0)
        assert push_candidates(arena, null, responses_of(arena, null)) == []
