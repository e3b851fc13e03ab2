"""How far ahead a verdict looks: as far as errors stay small, or the system forgets its start."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.calibrating.horizon import Outlook
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import neutral_values
from jaxsr.diagnosis.shooting.scoring import horizons
from jaxsr.models import Model, Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

TIME = np.arange(0.0, 20.0, 0.02)
PARTS = """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "{force}"
[readings]
y = "q"
[parameters]
c = {{ value = 1.0, bounds = [0.01, 20] }}
"""


def driven(seed: int, force: Callable[[float, float, float], float], noise: float) -> Recording:
    """Record q'' = force(q, v, u) under eight sines."""
    rng = np.random.default_rng(seed)
    waves, phases = np.linspace(0.4, 9.0, 8), rng.uniform(0.0, 6.0, 8)
    u = np.sin(waves * TIME[:, None] + phases).sum(1)

    def rates(t: float, x: np.ndarray) -> list[float]:
        return [x[1], force(x[0], x[1], float(np.interp(t, TIME, u)))]

    path = solve_ivp(rates, (0.0, TIME[-1]), [0.1, 0.0], t_eval=TIME, rtol=1e-8, max_step=0.02)
    y = path.y[0] + noise * rng.normal(size=TIME.size)
    return Recording(f"r{seed}", TIME, {"u": u, "y": y})


def headline(model: Model, force: Callable[[float, float, float], float]) -> list[float]:
    """The horizon chosen for a recording of q'' = force(q, v, u), and those to choose from."""
    recording = driven(0, force, 1e-4)
    prepared = (Prepared.build(model, recording),)
    super_model = SuperModel.build(model, [])
    scale = 0.01 * np.array([np.std(recording.channels["y"])])
    outlook = Outlook(super_model, prepared, Stepping("rk4", 2), scale, Simulator(model))
    chosen = outlook.headline([((), neutral_values(super_model))])
    assert max(chosen.lengths) <= chosen.seconds
    return [chosen.seconds, *horizons(prepared)]


def test_a_system_that_forgets_its_start_is_judged_by_whole_recordings():
    """A damped oscillator lacks a strong cubic spring: its error grows, and then no more."""
    model = parse_model(PARTS.format(force="u - 10*q - c*v"))
    chosen, *options = headline(model, lambda q, v, u: u - 10.0 * q - 3.0 * v - 100.0 * q**3)
    assert chosen == options[-1]


def test_errors_beyond_those_of_unrelated_motions_end_the_look_ahead(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A load that is not there drives it off: whole recordings would only cost time."""
    model = parse_model(PARTS.format(force="u - c*v - 40"))
    looked: list[float] = []
    arena = Outlook.arena
    monkeypatch.setattr(Outlook, "arena", lambda o, s: looked.append(s) or arena(o, s))
    chosen, *options = headline(model, lambda q, v, u: u - 10.0 * q - 0.05 * v)
    assert chosen < options[-1]
    assert max(looked) < options[-1]


def test_a_mass_without_a_spring_is_judged_by_short_runs():
    """A constant force is missing: errors add up for as long as the run lasts."""
    model = parse_model(PARTS.format(force="u - c*v"))
    chosen, *options = headline(model, lambda q, v, u: u - 0.05 * v - 0.6)
    assert chosen < options[-1]


def test_friction_shortens_segments() -> None:
    """Caught among the many orders in which it can stick and slide an estimate ends nowhere."""
    model = parse_model(PARTS.format(force="u - 10*q - c*v"))
    friction = next(
        c for c in force_candidates(model, {}) if c.label == "coulomb_friction@equation:v"
    )
    prepared = (Prepared.build(model, driven(0, lambda q, v, u: u - 10.0 * q - 3.0 * v, 1e-4)),)
    super_model = SuperModel.build(model, [friction])
    simulator, scale = Simulator(super_model.model), np.array([1e-3])
    outlook = Outlook(super_model, prepared, Stepping("rk4", 2), scale, simulator)
    null, sharp = ((m, neutral_values(super_model)) for m in ((), (0,)))
    short, long = (max(outlook.headline([null, second]).lengths) for second in (sharp, null))
    assert short < 0.5 * long
