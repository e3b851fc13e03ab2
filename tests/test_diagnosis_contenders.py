"""Which starts of the mechanisms enter the contest."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from diagnosis_systems import SPRUNG, TWO_MASSES
from scipy.integrate import solve_ivp

from jaxsr._progress import Budget
from jaxsr.diagnosis.case import Case
from jaxsr.diagnosis.search.contenders import contenders, leading_sets
from jaxsr.diagnosis.setup import prepare, screen_all
from jaxsr.models import Simulator, parse_model
from jaxsr.recordings import Recording

TANKS = """
[model]
states = ["h", "g"]
inputs = ["u"]
outputs = ["y"]
[equations]
h = "b*u - a*sqrt(Max(h, 0))"
g = "a*sqrt(Max(h, 0)) - c*sqrt(Max(g, 0))"
[readings]
y = "g"
[parameters]
a = { value = 1.0, bounds = [0.2, 5.0] }
b = { value = 2e-3, bounds = [1e-4, 1e-1] }
c = { value = 0.8, bounds = [0.2, 5.0] }
"""


def test_thresholds_of_an_input_lie_within_it_where_a_state_hides() -> None:
    """The upper tank has no sensor; commands go from 300 to 900."""
    t = np.arange(400) * 0.1
    u = 600.0 + 300.0 * np.sin(0.4 * t)
    recording = Recording("a.csv", t, {"u": u, "y": 2.0 + 0.5 * np.sin(0.4 * t - 1.0)})
    simulator = Simulator(parse_model(TANKS))
    prepared = prepare(simulator.model, [recording])
    case = Case(simulator, prepared, screen_all(simulator, prepared), Budget(), Budget())
    assert case.screened is None
    super_model, _ = contenders(case, [])
    limits = [c for c in super_model.candidates if c.mechanism == "input_saturation"]
    assert limits and all(u.min() < c.parameters[0].seed < u.max() for c in limits)


def test_forces_on_an_equation_that_hides_enter_beside_the_screened_ones() -> None:
    """The second mass, which the first one drags along, has a sensor in one model alone."""
    dragged = TWO_MASSES.replace(" + 6*(b - a)", "")
    t = np.arange(400) * 0.05
    table = {"u": np.sin(t), "y": 0.1 * np.sin(t - 0.2), "z": 0.05 * np.sin(t - 0.5)}
    blind = dragged.replace('["y", "z"]', '["y"]').replace('z = "b"\n', "")
    entered = []
    for text in (dragged, blind):
        simulator = Simulator(parse_model(text))
        prepared = prepare(simulator.model, [Recording("a.csv", t, table)])
        case = Case(simulator, prepared, screen_all(simulator, prepared), Budget(), Budget())
        assert case.screened is not None
        super_model, starts = contenders(case, [])
        entered.append({c.mechanism for c in super_model.candidates if c.site == "equation:vb"})
        assert len(starts) == 1 and len(starts[0][1]) == len(super_model.model.parameters)
    wanted = {"constant_force", "cubic_stiffness", "coulomb_friction", "hysteresis"}
    assert wanted <= entered[0] & entered[1]


def test_walls_on_both_sides_enter_wherever_the_weak_view_sees_one() -> None:
    """A mass between a spring and a damper meets a second spring below -0.5 m, rarely."""
    rng = np.random.default_rng(0)
    t = np.arange(1200) * 0.02
    tones, phases = rng.uniform(0.5, 6.0, 6), rng.uniform(0.0, 6.28, 6)

    def push(s: float | np.ndarray) -> np.ndarray:
        return 6.0 * np.sin(np.multiply.outer(s, tones) + phases).sum(-1)

    def rate(s: float, x: np.ndarray) -> list[float]:
        wall = -40.0 * min(x[0] + 0.5, 0.0)
        return [x[1], (push(s) - 30.0 * x[0] - 3.0 * x[1] + wall) / 2.0]

    q = solve_ivp(rate, (0.0, t[-1]), [0.0, 0.0], "RK45", t, rtol=1e-8, atol=1e-10).y[0]
    assert 0.01 < np.mean(q < -0.5) < 0.2
    y = q + 1e-4 * rng.standard_normal(t.size)
    simulator = Simulator(parse_model(SPRUNG))
    prepared = prepare(simulator.model, [Recording("a.csv", t, {"u": push(t), "y": y})])
    case = Case(simulator, prepared, screen_all(simulator, prepared), Budget(), Budget())
    leading = leading_sets(case)
    sizes = [len(item.members) for item in leading[1:]]  # behind the leader the quick ones first
    assert sizes == sorted(sizes)
    assert leading[0].error == min(item.error for item in leading)
    super_model, starts = contenders(case, leading)
    assert starts[0][0] == ()
    screened = case.screened
    assert screened is not None
    entered, offered = defaultdict(set), defaultdict(set)
    for candidate in super_model.candidates:
        entered[candidate.label].add(candidate.terms)
    for number, candidate in enumerate(screened.super_model.candidates):
        if number not in screened.screening.blind:
            offered[candidate.label].add(candidate.terms)
    assert sum(len(forms) > 1 for forms in offered.values()) > 1
    assert {label: entered[label] for label in offered} == offered
