"""The law does not depend on where a recording's clock began."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxsr
from jaxsr._progress import Budget
from jaxsr.discovery.clock import on_clock, origin_of, since
from jaxsr.discovery.experiments import read_experiments
from jaxsr.discovery.find import Task, find_equation
from jaxsr.discovery.hybrid import Hybrid, Mode
from jaxsr.discovery.hybrid.guards import Guard
from jaxsr.discovery.samples import roles, samples
from jaxsr.evolution import PrimitiveSet, SearchConfig
from jaxsr.expressions import parse, to_numpy
from jaxsr.expressions.term import Term
from jaxsr.recordings import Recording

SMALL = SearchConfig(
    population=40,
    refined=3,
    generations=4,
    restarts=0,
    patience=2,
    primitives=PrimitiveSet(functions=("add", "mul")),
)


def _recording(noise: float = 0.01, drive: float = 0.0) -> Recording:
    """x' = v, v' = -4 x - 0.3 v, and a drive of 1.3 radians a second."""
    rng = np.random.default_rng(0)
    t = np.linspace(0.0, 20.0, 500)
    way = solve_ivp(
        lambda s, z: [z[1], -4.0 * z[0] - 0.3 * z[1] + drive * np.sin(1.3 * s)],
        (0.0, 20.0), [1.5, 0.0], t_eval=t, rtol=1e-9, atol=1e-11,
    ).y  # fmt: skip
    x, v = way + noise * np.std(way, axis=1, keepdims=True) * rng.normal(size=way.shape)
    return Recording("run", t, {"x": x, "v": v})


def _moved(recording: Recording, origin: float) -> Recording:
    return replace(recording, time=recording.time + origin)


def test_only_an_origin_that_is_far_from_the_recordings_moves() -> None:
    near = _recording()
    assert origin_of([near]) == 0.0
    assert origin_of([_moved(near, 15.0)]) == 0.0
    assert origin_of([_moved(near, -30.0)]) == 0.0
    assert origin_of([_moved(near, 1e6)]) == 1e6
    assert origin_of([_moved(near, -1e6)]) == -1e6
    # two recordings of one clock keep what lies between them
    both = [_moved(near, 1e6), _moved(near, 1e6 + 100.0)]
    first, second = since(both, origin_of(both))
    assert first.time[0] == 0.0 and second.time[0] == pytest.approx(100.0)


def test_what_is_found_is_stated_on_the_recordings_own_clock() -> None:
    term, quiet = parse("sin(1.3*t)*x"), parse("x**2")
    moved = on_clock((term, quiet), "t", 50.0)
    point = {"t": np.array([51.0, 52.5]), "x": np.array([2.0, 3.0])}
    assert to_numpy(moved[0])(point) == pytest.approx(
        np.sin(1.3 * (point["t"] - 50.0)) * point["x"]
    )
    assert moved[1] is quiet
    rows = samples(since([_moved(_recording(), 50.0)], 50.0), roles(["x", "v"], None, 1, [], None))
    assert on_clock(rows, "t", 50.0).variables["t"][0] == pytest.approx(50.0)


def test_modes_and_their_visits_are_stated_on_that_clock_too() -> None:
    guard = Guard(Term.variable("t"), 5.0)
    modes = (Mode(guard.term, ()), Mode(guard.other.term, ()))
    regions = (((guard,),), ((guard.other,),))
    table: Any = None
    visits = {"run": [(0.0, 5.0, 1), (5.0, 9.0, 0)]}
    moved = on_clock(Hybrid(modes, regions, (), visits, (), table), "t", 50.0)
    assert moved.switching == {"run": [(50.0, 55.0, 1), (55.0, 59.0, 0)]}
    instants = {"t": np.array([54.0, 56.0])}
    assert moved.labels(instants).tolist() == [1, 0]
    assert to_numpy(moved.modes[0].guard)(instants).tolist() == [False, True]


@pytest.mark.slow
def test_a_million_seconds_later_the_law_is_the_same() -> None:
    laws = []
    for origin in (0.0, 1e6):
        found = jaxsr.discover(
            [_moved(_recording(), origin)], states=["x", "v"], config=SMALL, modes=1
        )
        laws.append({t.expression: t.coefficient for t in found["v"].terms})
        assert found.verdict == "law" and found["x"].expression == "v"
    assert laws[0].keys() == laws[1].keys() == {"x", "v"}
    assert [laws[1][k] for k in laws[0]] == pytest.approx(list(laws[0].values()), rel=1e-6)


def test_every_set_of_terms_with_time_has_a_rival_without() -> None:
    read = read_experiments([_recording(0.05)], [], roles(["x", "v"], None, 1, [], None))
    found = find_equation(
        np.random.default_rng(0), Task("v", "t", config=SMALL), read.train, read.judge, read.rows,
        budget=Budget(),
    )  # fmt: skip
    sets = {frozenset(c.fit.terms) for c in found.front}
    timed = [terms for terms in sets if any("t" in term.variables for term in terms)]
    assert timed
    for terms in timed:
        assert frozenset(term for term in terms if "t" not in term.variables) in sets


@pytest.mark.slow
def test_a_drive_that_nobody_recorded_is_found_on_a_clock_far_away() -> None:
    found = jaxsr.discover([_moved(_recording(0.002, 1.5), 1e6)], states=["x", "v"], modes=1)
    rate = to_numpy(found["v"].term)
    t = np.linspace(0.0, 20.0, 50)
    x, v = np.sin(3.0 * t), np.cos(2.0 * t)
    truth = -4.0 * x - 0.3 * v + 1.5 * np.sin(1.3 * t)
    assert rate({"t": 1e6 + t, "x": x, "v": v}) == pytest.approx(truth, abs=0.05)
    assert len(found["v"].terms) <= 4 and found.verdict == "law"
