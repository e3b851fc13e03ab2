"""Play in the springs that a model has."""

from __future__ import annotations

import jax
import numpy as np
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.mechanisms import sites_of
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.play import play
from jaxsr.diagnosis.mechanisms.springs import springs_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.integration import choose_stepping
from jaxsr.diagnosis.shooting.uncertainty import half_widths
from jaxsr.expressions import to_text
from jaxsr.models import Model, Simulator, apply_edit, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

CHAIN = parse_model(
    """
[model]
states = ["q1", "q2", "v1", "v2"]
inputs = ["u"]
outputs = ["y1"]
[equations]
q1 = "v1"
q2 = "v2"
v1 = "u - k*q1 - F*v1 + kc*(q2 - q1) - k3*q1**3"
v2 = "-(kc*(q2 - q1))/n - F*v2 - sin(q2)"
[inertia]
v1 = { v1 = "m" }
v2 = { v2 = "m" }
[readings]
y1 = "q1"
[parameters]
m = { value = 1.0, bounds = [0.3, 3.0] }
k = { value = 40.0, bounds = [20.0, 90.0] }
kc = { value = 30.0, bounds = [15.0, 90.0] }
k3 = { value = 2.0 }
n = { value = 2.0 }
F = { value = 0.4, bounds = [0.0, 3.0] }
"""
)
GEAR = parse_model(
    """
[model]
states = ["q1", "q2", "v1", "v2"]
inputs = ["u"]
outputs = ["y1"]
[equations]
q1 = "v1"
q2 = "v2"
v1 = "5*u - F*v1 - (k*(q1/n - r*q2) + d*(v1/n - v2))/n"
v2 = "k*(q1/n - r*q2) + d*(v1/n - v2) - F*v2"
[inertia]
v1 = { v1 = "m" }
v2 = { v2 = "m" }
[readings]
y1 = "q1"
[parameters]
m = { value = 1.0, bounds = [0.3, 3.0] }
k = { value = 40.0, bounds = [20.0, 90.0] }
d = { value = 0.5, bounds = [0.1, 3.0] }
n = { value = 8.0 }
r = { value = 1.5 }
F = { value = 0.4, bounds = [0.0, 3.0] }
"""
)
"""A motor that turns a load by a gear and a soft shaft."""
SCALE = {s: np.linspace(-2.0, 2.0, 21) for s in CHAIN.states}
RNG = np.random.default_rng(8)
POINTS = RNG.uniform(-2.0, 2.0, (4, 300))


def offered(model: Model = CHAIN) -> list[Candidate]:
    return [c for site in sites_of(model, SCALE) for c in play(site)]


def forces(model: Model) -> np.ndarray:
    simulator = Simulator(model)
    with jax.enable_x64(True):
        out = simulator.forces(0.7, tuple(POINTS), (POINTS[0],), simulator.values())[2:]
    return np.stack([np.broadcast_to(np.asarray(f), POINTS.shape[1:]) for f in out])


def test_the_linear_springs_of_a_model_are_found() -> None:
    found = [(s.state, to_text(s.deflection), to_text(s.stiffness)) for s in springs_of(CHAIN)]
    assert found == [
        ("v1", "q1", "k"),
        ("v1", "q1 - q2", "kc"),
        ("v2", "q1 - q2", "-kc/n"),
    ]


def test_a_spring_with_play_pulls_by_what_is_beyond_the_play() -> None:
    base, (q1, q2) = forces(CHAIN), POINTS[:2]
    for deflection, site, stiffness in (
        (q1, "equation:v1", (40.0, 0.0)),
        (q1 - q2, "equation:v2", (30.0, -15.0)),
    ):
        candidate = next(c for c in offered() if c.site == site)
        for b in (0.0, 0.3, 1.1, 9.0):
            edited = forces(apply_edit(CHAIN, candidate.edit(CHAIN, {"b": "b"}, {"b": b})))
            beyond = np.maximum(deflection - b, 0.0) + np.minimum(deflection + b, 0.0)
            pulls = -np.outer(stiffness, beyond - deflection)
            np.testing.assert_allclose(edited - base, pulls, atol=1e-10)


def test_a_shaft_behind_a_gear_may_have_play() -> None:
    """Deflection of the load's side, 1/n of it at the motor's; the damper has none."""
    found = [(s.state, to_text(s.deflection), to_text(s.stiffness)) for s in springs_of(GEAR)]
    assert found == [("v1", "q1/n - r*q2", "k/n"), ("v2", "q1/n - r*q2", "-k")]
    base, deflection = forces(GEAR), POINTS[0] / 8.0 - 1.5 * POINTS[1]
    candidate = offered(GEAR)[0]
    # half the ranges are 2/8 and 2*1.5: the spring is deflected by the smaller one at least
    assert candidate.parameters[0].high == 2.0 * 0.25
    for b in (0.0, 0.1, 0.7):
        edited = forces(apply_edit(GEAR, candidate.edit(GEAR, {"b": "b"}, {"b": b})))
        beyond = np.maximum(deflection - b, 0.0) + np.minimum(deflection + b, 0.0)
        pulls = -np.outer((40.0 / 8.0, -40.0), beyond - deflection)
        np.testing.assert_allclose(edited - base, pulls, atol=1e-10)


def test_the_stiffness_of_a_spring_with_play_is_a_parameter_of_the_model() -> None:
    assert {c.borrowed for c in offered()} == {(("kb", "k"),), (("kb", "kc"),)}


def test_a_spring_that_is_always_stretched_shows_no_play() -> None:
    away = SCALE | {"q1": np.linspace(1.0, 2.0, 21)}
    assert all(c.site != "equation:v1" for s in sites_of(CHAIN, away) for c in play(s))


def test_play_is_found_where_the_stiffness_cannot_go_to_zero() -> None:
    """Two masses, the first one measured alone; the spring to the wall has a play of 0.15 m.

    Half-widths of 95 %, so the estimate within 2 of them: missed in 1 of 10,000 draws.
    """
    t = np.arange(1200) * 0.02
    tones = np.array([1.1, 3.7, 6.3])

    def push(s: float | np.ndarray) -> np.ndarray:
        return 10.0 * np.sin(np.multiply.outer(s, tones)).sum(-1)

    def rate(s: float, x: np.ndarray) -> list[float]:
        q1, q2, v1, v2 = x
        wall = 40.0 * (max(q1 - 0.15, 0.0) + min(q1 + 0.15, 0.0))
        pull = 30.0 * (q2 - q1)
        first = push(s) - wall - 0.4 * v1 + pull - 2.0 * q1**3
        return [v1, v2, first, -pull / 2.0 - 0.4 * v2 - np.sin(q2)]

    q1 = solve_ivp(rate, (0.0, t[-1]), np.zeros(4), "LSODA", t, rtol=1e-9, atol=1e-10).y[0]
    noise = 1e-3 * np.random.default_rng(0).standard_normal(t.size)
    prepared = [Prepared.build(CHAIN, Recording("a.csv", t, {"u": push(t), "y1": q1 + noise}))]
    chosen = [c for c in offered() if c.site == "equation:v1"][:1]
    super_model = SuperModel.build(CHAIN, chosen)
    simulator, theta = Simulator(super_model.model), neutral_values(super_model)
    stepping = choose_stepping(simulator, prepared, theta)
    arena = build_arena(super_model, prepared, stepping, 4.0, np.array([1e-3]), simulator)
    null = enter(arena, (), theta)
    found = enter(arena, (0,), super_model.seeded((0,), null.fit.theta), None)
    place = super_model.index(0)[0]
    half = dict(zip(found.fit.active, half_widths(arena, found.fit), strict=True))[place]
    assert found.fit.cost < 0.2 * null.fit.cost
    assert half < 0.01
    assert abs(found.fit.theta[place] - 0.15) < 2.0 * half
