"""Repeating forces located in free run: the gain foreseen, the frequency, silence in noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.locating.responses import SURE, Responses, surely
from jaxsr.diagnosis.locating.waves import _gains, _kinds, wave_candidates
from jaxsr.diagnosis.mechanisms.periodic import harmonic, ripple, swing
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.models.shooting import fit
from jaxsr.recordings import Recording

MODEL = """
[model]
name = "two masses"
states = ["a", "b", "va", "vb"]
inputs = ["u"]
outputs = ["y", "z"]
[equations]
a = "va"
b = "vb"
va = "u - 9*a - 0.4*va + 6*(b - a)"
vb = "-4*b - 0.3*vb + 6*(a - b)"
[readings]
y = "a"
z = "b"
"""
TIME = np.arange(0.0, 10.0, 0.025)
NOISE, FREQUENCY = 2e-3, 5.37
Force = Callable[[float, np.ndarray], tuple[float, float]]


def recording(name: str, rng: np.random.Generator, force: Force) -> Recording:
    """A run with a random staircase as input and forces on both masses."""
    drive = np.repeat(6.0 * rng.normal(size=TIME.size // 8), 8)

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b, va, vb = x
        u, (fa, fb) = np.interp(t, TIME, drive), force(t, x)
        return [
            va,
            vb,
            u - 9 * a - 0.4 * va + 6 * (b - a) + fa,
            -4 * b - 0.3 * vb + 6 * (a - b) + fb,
        ]

    x = solve_ivp(rates, TIME[[0, -1]], np.zeros(4), t_eval=TIME, rtol=1e-9, atol=1e-11).y
    y, z = x[:2] + NOISE * rng.normal(size=(2, TIME.size))
    return Recording(name, TIME, {"u": drive, "y": y, "z": z})


def arena_of(seed: int, force: Force) -> tuple[Arena, Entry, Responses]:
    """Two recordings; nothing is free but the starts."""
    rng, simulator = np.random.default_rng(seed), Simulator(parse_model(MODEL))
    items = [recording(f"r{k}.csv", rng, force) for k in range(2)]
    prepared = tuple(Prepared.build(simulator.model, item) for item in items)
    super_model = SuperModel.build(simulator.model, [])
    scale = np.full(2, NOISE)
    arena = build_arena(super_model, prepared, Stepping("rk4", 1), 5.0, scale, simulator)
    entry = enter(arena, (), neutral_values(super_model))
    return arena, entry, Responses.of(arena, entry, sites_of(super_model.given, {}))


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "site", "force"),
    [
        ("harmonic_force", "vb", lambda t, x: (0.0, 0.3 * np.sin(FREQUENCY * t + 0.7))),
        ("parametric_excitation", "va", lambda t, x: (-0.5 * x[0] * np.cos(FREQUENCY * t), 0.0)),
        ("position_ripple", "va", lambda t, x: (0.3 * np.sin(FREQUENCY * 2 * x[0] - 1.0), 0.0)),
        # a rail that ripples under a body without a drive
        ("position_ripple", "vb", lambda t, x: (0.0, 0.3 * np.sin(FREQUENCY * 2 * x[1] - 1.0))),
    ],
)
@pytest.mark.parametrize("seed", range(2))
def test_a_repeating_force_is_located_where_it_acts(seed, name, site, force):
    arena, null, responses = arena_of(seed, force)
    make = {"harmonic_force": harmonic, "position_ripple": ripple}.get(name, swing)
    gains = {}
    for kind in _kinds(arena, responses):
        gains[kind.make, responses.sites[kind.site].state] = _gains(responses, kind, kind.grid)[0]
    assert max(gains, key=lambda key: gains[key].max()) == (make, site)
    found = wave_candidates(arena, null, responses)
    (own,) = [c for c in found if c.label == f"{name}@equation:{site}"]
    wanted = 2.0 * FREQUENCY if name == "position_ripple" else FREQUENCY
    assert own.parameters[1].neutral == pytest.approx(wanted, rel=0.03)
    assert own.tried > 10


def test_a_ripple_of_two_periods_on_the_whole_path_is_located():
    """The ends of the path are visited rarely: most of the time is spent within one period."""
    _, _, still = arena_of(0, lambda t, x: (0.0, 0.0))
    n = 4.0 * np.pi / float(np.ptp(still.course("a")))
    arena, null, responses = arena_of(0, lambda t, x: (0.6 * np.sin(n * x[0] - 1.0), 0.0))
    found = {c.label: c for c in wave_candidates(arena, null, responses)}
    own = found["position_ripple@equation:va"].parameters[1]
    assert own.neutral == pytest.approx(n, rel=0.1)


def test_the_gain_foreseen_is_the_gain_of_the_estimate():
    """The model is linear: the cost falls with amplitude and phase as the projection says."""
    arena, null, responses = arena_of(4, lambda t, x: (0.0, 0.3 * np.sin(FREQUENCY * t + 0.7)))
    kind = [k for k in _kinds(arena, responses) if k.make is harmonic][1]
    (gain,), _ = _gains(responses, kind, np.array([FREQUENCY]))
    (own,) = [
        c
        for c in wave_candidates(arena, null, responses)
        if c.label == "harmonic_force@equation:vb"
    ]
    super_model = SuperModel.build(arena.super_model.given, [own])
    new = build_arena(
        super_model,
        arena.prepared,
        arena.problem.stepping,
        5.0,
        arena.problem.scale,
        Simulator(super_model.model),
    )
    theta, active = neutral_values(super_model), super_model.index(0)
    order = super_model.names[0]
    at = dict(zip(order, active, strict=True))
    theta[at["w"]] = FREQUENCY
    found = fit(new.problem, theta, np.array([at["A"], at["phi"]]), new.bounds, path=null.fit.path)
    assert abs((null.fit.cost - found.cost) / gain - 1.0) < 0.01
    assert found.theta[at["A"]] ** 2 == pytest.approx(0.3**2, rel=0.05)


@pytest.mark.slow
def test_noise_alone_shows_no_wave():
    """A proposal needs chi-squared 16 + 2 log(frequencies): once in 2,900 grids by chance."""
    for seed in range(10):
        arena, null, responses = arena_of(100 + seed, lambda t, x: (0.0, 0.0))
        assert wave_candidates(arena, null, responses) == []


def test_a_force_that_holds_nearly_all_stands_out_however_few_residuals_tell_of_it():
    """What one column of many leaves of 20 numbers: noise is never sure, a signal always is."""
    rng, count, choices = np.random.default_rng(6), 20, 60
    false = found = 0
    for _ in range(400):
        columns = rng.normal(size=(choices, count))
        columns /= np.linalg.norm(columns, axis=1, keepdims=True)
        noise = rng.normal(size=count)
        for signal in (0.0, 40.0):
            r = noise + signal * columns[7]
            cost, gains = float(r @ r), (columns @ r) ** 2
            sure = gains.max() > surely(cost, count, choices)
            found, false = found + (sure and signal > 0), false + (sure and signal == 0)
    assert found == 400 and false <= 8  # 3 expected: R2 above 0.55 of 20 numbers, 60 columns
    assert surely(1e4, 1e4, choices) == pytest.approx(SURE + 2.0 * np.log(choices), rel=1e-2)
