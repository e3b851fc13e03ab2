"""Laws along what stretches the springs of a model, and relative to what its speeds are."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis import diagnose
from jaxsr.diagnosis.mechanisms import sites_of
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.dissipative import dissipative, moved_past
from jaxsr.diagnosis.mechanisms.hardening import hardening
from jaxsr.diagnosis.mechanisms.play import play
from jaxsr.expressions import evaluate, to_text
from jaxsr.models import Model, Simulator, apply_edit, parse_model
from jaxsr.recordings import Recording
from tests.test_diagnosis_play import CHAIN, GEAR, POINTS, SCALE, forces

LONG = parse_model(
    """
[model]
states = ["q1", "q2", "v1", "v2"]
inputs = ["u"]
outputs = ["y1", "y2"]
[equations]
q1 = "v1"
q2 = "v2"
v1 = "(u - k*(q1 - q2 - L) - c*v1)/m"
v2 = "(k*(q1 - q2 - L) + g*(3.0 - q2) - c*v2)/m"
[readings]
y1 = "q1"
y2 = "q2"
[units]
q1 = "m"
q2 = "m"
v1 = "m/s"
v2 = "m/s"
u = "N"
[parameters]
m = { value = 2.0, unit = "kg" }
k = { value = 50.0, bounds = [20.0, 90.0] }
g = { value = 30.0, bounds = [10.0, 90.0] }
c = { value = 1.5, bounds = [0.0, 9.0] }
L = 0.5
"""
)
"""A spring of length L between two bodies, and one from the second to a wall, at rest at 3 m."""


def offered(model: Model) -> dict[str, list[Candidate]]:
    found: dict[str, list[Candidate]] = {}
    for site in sites_of(model, SCALE | {"q2": np.linspace(1.0, 5.0, 21)}):
        for candidate in hardening(site):
            found.setdefault(candidate.label, []).append(candidate)
    return found


def pulls(model: Model, candidate: Candidate, value: float) -> np.ndarray:
    (spec,) = candidate.parameters
    edit = candidate.edit(model, {spec.name: "added"}, {spec.name: value})
    return forces(apply_edit(model, edit)) - forces(model)


@pytest.mark.parametrize(("order", "name"), [(2, "quadratic_stiffness"), (3, "cubic_stiffness")])
def test_it_pulls_where_the_spring_does_and_by_its_levers(order: int, name: str) -> None:
    q1, q2 = POINTS[:2]
    for model, deflection, levers in (
        (CHAIN, q1 - q2, (-2.0, 1.0)),  # the second equation is divided by n = 2
        (GEAR, q1 / 8.0 - 1.5 * q2, (-1.0 / 8.0, 1.0)),
        (LONG, q1 - q2 - 0.5, (-0.5, 0.5)),  # of rates: forces over m = 2
    ):
        candidate = offered(model)[f"{name}@equation:v2"][0]
        wanted = 0.7 * np.outer(levers, deflection**order)
        np.testing.assert_allclose(pulls(model, candidate, 0.7), wanted, atol=1e-9)


def test_it_is_one_about_the_place_where_the_spring_is_at_rest() -> None:
    _, wall = offered(LONG)["cubic_stiffness@equation:v2"]
    wanted = -0.7 * (POINTS[1] - 3.0) ** 3 / 2.0
    np.testing.assert_allclose(pulls(LONG, wall, 0.7)[1], wanted, atol=1e-9)
    assert wall.parameters[0].unit == "N/m^3"


def test_a_spring_on_a_position_alone_is_not_offered_twice() -> None:
    assert "cubic_stiffness@equation:v1" not in offered(CHAIN)


def test_a_spring_that_never_passes_its_rest_has_no_cube() -> None:
    away = SCALE | {"q2": np.linspace(3.5, 5.0, 21)}
    wall = [c for s in sites_of(LONG, away) for c in hardening(s) if "3.0" in c.sentence]
    assert [c.mechanism for c in wall] == ["quadratic_stiffness"]


def test_play_is_about_the_rest_of_a_spring() -> None:
    scale = SCALE | {"q2": np.linspace(1.0, 5.0, 21)}
    sites = sites_of(LONG, scale)
    found = {c.borrowed[0][1]: c for site in sites for c in play(site)}
    edit = found["g"].edit(LONG, {"b": "b"}, {"b": 0.4})
    at_rest = np.clip(POINTS[1] - 3.0, -0.4, 0.4)
    moved = forces(apply_edit(LONG, edit)) - forces(LONG)
    np.testing.assert_allclose(moved[1], 30.0 * at_rest / 2.0, atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(("between", "wall"), [(400.0, 0.0), (0.0, 60.0), (0.0, 0.0)])
def test_a_spring_that_hardens_is_named_with_its_constant(between: float, wall: float) -> None:
    rng = np.random.default_rng(4)
    time = np.linspace(0.0, 10.0, 1001)
    items = []
    for run in range(2):
        rates, phases = rng.uniform(0.5, 8.0, 4), rng.uniform(0.0, 6.0, 4)
        u = 12.0 * np.sin(np.outer(time, rates) + phases).sum(axis=1)

        def rate(t: float, x: np.ndarray, u: np.ndarray = u) -> list[float]:
            stretch, off = x[0] - x[1] - 0.5, x[1] - 3.0
            inner = 50.0 * stretch + between * stretch**3
            outer = 30.0 * off + wall * off**3
            push = np.interp(t, time, u)
            return [
                x[2],
                x[3],
                (push - inner - 1.5 * x[2]) / 2.0,
                (inner - outer - 1.5 * x[3]) / 2.0,
            ]

        start = [3.4, 3.1, 0.0, 0.0]
        x = solve_ivp(rate, (0.0, 10.0), start, t_eval=time, rtol=1e-9, atol=1e-10, max_step=0.01).y
        noise = 1e-3 * rng.normal(size=(2, time.size))
        columns = {"u": u, "y1": x[0] + noise[0], "y2": x[1] + noise[1]}
        items.append(Recording(f"run{run}", time, columns))
    found = diagnose(Simulator(LONG), items, budget=90.0)
    if not between and not wall:
        assert found.verdict == "nothing"
        return
    (finding,) = found.findings
    assert (finding.mechanism, finding.site) == ("cubic_stiffness", "equation:v2")
    interval = finding.parameters["k3"].interval
    assert interval is not None and interval[0] <= (between or wall) <= interval[1]
    assert ("L" if between else "3.0") in str(finding.edit)


BELT = parse_model(
    """
[model]
states = ["q", "v"]
inputs = ["belt"]
outputs = ["y"]
[equations]
q = "v"
v = "(-k*q - c*(v - belt) - d*(0 - v) - e*(2.0 - v))/m"
[readings]
y = "q"
[parameters]
m = { value = 2.0, unit = "kg" }
k = { value = 50.0, bounds = [20.0, 90.0] }
c = { value = 1.5, bounds = [0.0, 9.0] }
d = { value = 0.0 }
e = { value = -0.1 }
"""
)
"""A mass on a belt, in a wind of 2 m/s."""


def test_what_a_speed_is_relative_to_is_a_belt_or_a_wind() -> None:
    (site,) = sites_of(BELT, {s: np.linspace(-1.0, 1.0, 21) for s in ("q", "v", "belt")})
    assert [to_text(other) for other in moved_past(site)] == ["belt", "2.0"]
    found = {c.sentence: c for c in dissipative(site) if c.mechanism == "coulomb_friction"}
    assert [s.partition("past ")[2] for s in found] == ["", "belt.", "2.0."]
    v, belt = np.linspace(-3.0, 3.0, 7), 0.5
    for other, name in ((0.0, "{site}."), (belt, "belt."), (2.0, "2.0.")):
        candidate = next(c for s, c in found.items() if s.endswith(name))
        edit = candidate.edit(BELT, {"Fc": "Fc"}, {"Fc": 0.8})
        values = {"q": 0.0, "v": v, "belt": belt, "Fc": 0.8}
        values |= {n: p.value for n, p in BELT.parameters.items()}
        moved = evaluate(apply_edit(BELT, edit).equation_terms["v"], values)
        pulled = moved - evaluate(BELT.equation_terms["v"], values)
        np.testing.assert_allclose(pulled, -0.4 * np.sign(v - other), atol=1e-12)
