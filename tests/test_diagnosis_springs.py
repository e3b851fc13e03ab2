"""Springs that engage at a place, located in free run from starts that show nothing of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from diagnosis_systems import TWO_MASSES
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.contest.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.locating.responses import Responses
from jaxsr.diagnosis.locating.springs import spring_candidates
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.site import sites_of
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import state_scale
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

TIME = np.arange(0.0, 20.0, 0.025)
NOISE = 2e-4
LAWS: dict[str, Callable[[float], float]] = {
    "beyond": lambda b: -3.0 * max(b - 0.25, 0.0),
    "below": lambda b: -3.0 * min(b + 0.25, 0.0),
    "play": lambda b: -3.0 * (max(b - 0.25, 0.0) + min(b + 0.25, 0.0)),
    "nothing": lambda b: 0.0,
}


def recording(rng: np.random.Generator, law: Callable[[float], float]) -> Recording:
    """A run with a random staircase as input and a law at the second mass."""
    drive = np.repeat(6.0 * rng.normal(size=TIME.size // 8), 8)

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b, va, vb = x
        u = np.interp(t, TIME, drive)
        forces = u - 9 * a - 0.4 * va + 6 * (b - a), -4 * b - 0.3 * vb + 6 * (a - b) + law(b)
        return [va, vb, *forces]

    run = solve_ivp(
        rates, TIME[[0, -1]], np.zeros(4), t_eval=TIME, rtol=1e-9, atol=1e-11, max_step=0.2
    )
    y, z = run.y[:2] + NOISE * rng.normal(size=(2, TIME.size))
    return Recording(f"{rng.integers(1000)}.csv", TIME, {"u": drive, "y": y, "z": z})


def located(law: str, seed: int) -> tuple[Arena, Entry, list[Candidate]]:
    """Start every law with a place at the end of the path; return what is found beside."""
    rng, model = np.random.default_rng(seed), parse_model(TWO_MASSES)
    prepared = tuple(Prepared.build(model, recording(rng, LAWS[law])) for _ in range(2))
    scale = state_scale(model, prepared)
    offered = [c for c in force_candidates(model, scale) if c.site == "equation:vb"]
    starts = []
    for form in dict.fromkeys(
        c.terms for c in offered if c.mechanism in ("piecewise_stiffness", "backlash")
    ):
        first = next(c for c in offered if c.terms == form)
        if len(first.parameters) == 2:
            end = 0.95 * float(scale["b"][0 if "Min" in form[0][1] else -1])
            end = abs(end) if first.mechanism == "backlash" else end
            own = (p if p.coefficient else replace(p, neutral=end) for p in first.parameters)
            starts.append(replace(first, parameters=tuple(own)))
    super_model = SuperModel.build(model, starts)
    setting = Stepping("rk4", 2), 4.0, np.full(2, NOISE), Simulator(super_model.model)
    arena = build_arena(super_model, prepared, *setting)
    null = enter(arena, (), neutral_values(super_model))
    responses = Responses.of(arena, null, sites_of(model, {}))
    return arena, null, spring_candidates(arena, null, responses)


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "mechanism", "side", "place"),
    [
        ("beyond", "piecewise_stiffness", "Max", 0.25),
        ("below", "piecewise_stiffness", "Min", -0.25),
        ("play", "backlash", "Max", 0.25),
    ],
)
def test_a_spring_is_started_near_the_place_at_which_it_engages(law, mechanism, side, place):
    """From the ends of the path, where the starts lie, it would not have been found."""
    arena, null, found = located(law, 0)
    near = next(c for c in found if c.mechanism == mechanism and side in c.terms[0][1])
    (at,) = (p.neutral for p in near.parameters if not p.coefficient)
    assert abs(at - place) < 0.1
    super_model = SuperModel.build(arena.super_model.given, [near])
    simulator = Simulator(super_model.model)
    problem = arena.problem
    own = build_arena(
        super_model, arena.prepared, problem.stepping, arena.seconds, problem.scale, simulator
    )
    entry = enter(own, (0,), neutral_values(super_model))
    values = super_model.own_values(0, entry.fit.theta)
    assert entry.fit.cost < 0.05 * null.fit.cost
    assert sorted(values.values()) == pytest.approx(sorted((3.0, place)), abs=0.05)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(10))
def test_noise_alone_engages_no_spring(seed: int) -> None:
    """Chance gets beyond the threshold in less than one of a thousand recordings."""
    assert located("nothing", seed)[2] == []
