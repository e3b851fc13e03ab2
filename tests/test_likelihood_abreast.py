"""Models of many equations: laws at several of them are asked about at once."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxsr.diagnosis.likelihood.abreast import abreast, laws, many, rivals_of_many, room
from jaxsr.diagnosis.likelihood.additions import PROMISING
from jaxsr.diagnosis.likelihood.course import Course, followed
from jaxsr.diagnosis.likelihood.loop import begun, search
from jaxsr.diagnosis.likelihood.rounding import EXACT, _Widths
from jaxsr.diagnosis.likelihood.scales import reaching
from jaxsr.diagnosis.likelihood.table import tabled
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import state_scale
from jaxsr.models import Model, parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

COUNT = 6
TIME = np.arange(250) * 0.02
OFFERED = "viscous_damping", "quadratic_drag", "linear_stiffness", "cubic_stiffness"


def chain() -> Model:
    """Six masses between springs, the second one pushed."""
    numbers = range(1, COUNT + 1)
    places, speeds = (", ".join(f'"{s}{k}"' for k in numbers) for s in "xv")
    outputs = ", ".join(f'"y{k}"' for k in numbers)
    lines = ["[model]", f"states = [{places}, {speeds}]", 'inputs = ["F"]']
    lines += [f"outputs = [{outputs}]", "[equations]", *(f'x{k} = "v{k}"' for k in numbers)]
    for k in numbers:
        left = f"(x{k} - x{k - 1})" if k > 1 else "x1"
        right = f"(x{k} - x{k + 1})" if k < COUNT else f"x{COUNT}"
        lines.append(f'v{k} = "{"F " if k == 2 else ""}- k*{left} - k*{right} - 0.3*v{k}"')
    lines += ["[readings]", *(f'y{k} = "x{k}"' for k in numbers)]
    lines += ["[parameters]", "k = { value = 250.0, bounds = [100.0, 500.0] }"]
    return parse_model("\n".join(lines))


def recorded(rng: np.random.Generator, drag: dict[int, float]) -> Recording:
    """The chain with quadratic drag at some masses."""
    waves = np.sin(np.outer(TIME, rng.uniform(2.0, 25.0, 5)) + rng.uniform(0.0, 6.0, 5))
    push = 25.0 * waves.sum(axis=1)
    stiffness = 250.0 * (2.0 * np.eye(COUNT) - np.eye(COUNT, k=1) - np.eye(COUNT, k=-1))
    own = np.array([drag.get(k, 0.0) for k in range(1, COUNT + 1)])

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        q, v = x[:COUNT], x[COUNT:]
        force = -stiffness @ q - 0.3 * v - own * v * np.abs(v)
        force[1] += np.interp(t, TIME, push)
        return np.concatenate([v, force])

    run = solve_ivp(rate, TIME[[0, -1]], np.zeros(2 * COUNT), t_eval=TIME, rtol=1e-8, atol=1e-10)
    y = run.y[:COUNT] + 2e-4 * rng.normal(size=(COUNT, TIME.size))
    return Recording("run", TIME, {"F": push, **{f"y{k + 1}": y[k] for k in range(COUNT)}})


def workspace(seed: int) -> tuple[Workspace, Course, set[str]]:
    """Return what a search works on, where it begins, and the laws that act."""
    rng = np.random.default_rng([seed, 71])
    masses = rng.choice(np.arange(1, COUNT + 1), 4, replace=False)
    model = chain()
    prepared = [Prepared.build(model, recorded(rng, {int(k): 1.5 for k in masses}))]
    course = followed(model, prepared)
    assert course is not None
    every = force_candidates(model, state_scale(model, course.prepared))
    some = [c for c in every if c.mechanism in (*OFFERED, "constant_force") and not c.states]
    every = SuperModel.build(model, some)
    null = course.null
    work = Workspace.build(every, course.prepared, course.seconds, null.noise, share=null.share)
    return work, course, {f"quadratic_drag@equation:v{k}" for k in masses}


def labels(work: Workspace, members: tuple[int, ...]) -> set[str]:
    return {work.super_model.candidates[i].label for i in members}


@pytest.mark.parametrize("seed", range(3))
def test_laws_at_four_of_six_masses_are_one_proposal(seed: int) -> None:
    """The search comes to them by it: three members were as many as a pair leads to."""
    work, course, wanted = workspace(seed)
    state = begun(work, course.null)
    least = PROMISING + float(np.log(state.offered))
    (found,) = abreast(work.super_model, state.table, (), least)
    sites = [work.super_model.candidates[i].site for i in found]
    assert len(set(sites)) == len(sites)
    assert {f"quadratic_drag@{site}" for site in sites} >= wanted
    assert labels(work, search(work, course.null).leader.members) == wanted


def test_what_is_too_much_is_left_out_at_once() -> None:
    """Of six drags the two that do nothing go together, and are the first of the rivals."""
    work, course, wanted = workspace(3)
    every = work.super_model.candidates
    drags = tuple(i for i, c in enumerate(every) if c.mechanism == "quadratic_drag")
    theta = work.theta.copy()
    for i in drags:
        theta[work.super_model.index(i)] = 1.5 if every[i].label in wanted else 0.0
    null = course.null
    table = tabled(work, theta, null.path, null.noise, null.decay)
    first, *others = rivals_of_many(work.super_model, table, drags, np.log(len(every)), 12.0)
    assert labels(work, first) == wanted
    assert all(len(m) >= len(wanted) for m in others)  # none without a law that acts


def test_laws_with_states_of_their_own_are_not_among_them() -> None:
    sites = ("equation:v1", ()), ("equation:v1", ("z",)), ("output:y", ()), ("equation:v2", ())
    every: Any = SimpleNamespace(
        candidates=[SimpleNamespace(site=site, states=states) for site, states in sites]
    )
    assert laws(every) == [0, 3]


def test_a_set_may_have_more_members_where_there_are_more_equations() -> None:
    def of(equations: int) -> Any:
        return SimpleNamespace(force_states=tuple(range(equations)))

    assert [room(of(n), 4) for n in (1, 2, 3, 4, 6, 20)] == [4, 4, 4, 8, 12, 40]
    assert [many(n, (0, 1, 2, 3)) for n in (1, 3, 4)] == [False, False, True]
    assert not many(4, (0, 1, 2))


def test_sizes_of_a_force_go_on_as_far_as_one() -> None:
    shares = np.array([0.0, *np.geomspace(1e-3, 1.0, 7)])
    assert reaching(shares, 1.0) is shares
    further = reaching(shares, 10.7)
    np.testing.assert_allclose(further[-2:], [10.0, 10.0**1.5])
    np.testing.assert_array_equal(further[: len(shares)], shares)


@pytest.mark.parametrize(
    ("slope", "bend", "gain"),
    [(3.0, -2.0, 1.125), (-3.0, -2.0, 0.0), (-60.0, 2.0, 0.0), (0.2, -1.0, 0.01)],
)
def test_the_parabola_through_three_widths_tells_what_a_narrow_one_gains(
    slope: float, bend: float, gain: float
) -> None:
    def told(width: float) -> tuple[Any, Any]:
        return None, SimpleNamespace(log_evidence=7.0 + slope * width + bend * width**2)

    widths: Any = object.__new__(_Widths)
    widths.tried = {w: told(w) for w in (EXACT, 1.0, 4.0)}
    assert widths.between(4.0, 1.0) == pytest.approx(gain)
    widths.tried.pop(1.0)
    assert widths.between(4.0, 1.0) == np.inf


def test_brief_pieces_are_the_first_samples_of_the_whole() -> None:
    local = workspace(0)[1].response().local
    brief = local.first(20)
    assert brief.innovation.shape[0] == 20
    assert brief.defect.shape[0] == brief.by_state.shape[0] == 19
    np.testing.assert_array_equal(brief.reading, local.reading[:20])
