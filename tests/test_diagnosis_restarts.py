"""Re-calibration from several starts, and parameters that end on a bound."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr.diagnosis.calibrating.restarts import Restarts, design, touched
from jaxsr.diagnosis.explaining.bounds import bound_rows
from jaxsr.diagnosis.explaining.recalibrating import not_worse
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import prepare
from jaxsr.diagnosis.shooting.arena import Arena, build_arena, neutral_values
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.models import Simulator, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.recordings import Recording

# Over a long run the cost has a valley for every turn that a wrong frequency loses.
TURNING = """
[model]
states = ["q"]
outputs = ["y"]
[equations]
q = "a*cos(w*t)"
[readings]
y = "q"
[parameters]
a = { value = 1.0, bounds = [0.5, 2.0] }
w = { value = 2.0, bounds = [1.0, 8.0] }
"""
TIME = np.arange(300) * 0.04
MODEL = parse_model(TURNING)


def arena(seconds: float | None, w: float = 5.0) -> Arena:
    y = 1.2 / w * np.sin(w * TIME) + 1e-3 * np.random.default_rng(0).normal(size=TIME.size)
    prepared = prepare(MODEL, [Recording("a.csv", TIME, {"y": y})])
    super_model = SuperModel.build(MODEL, [])
    setting = Stepping("rk4", 2, ()), seconds, np.array([1e-3]), Simulator(super_model.model)
    return build_arena(super_model, prepared, *setting)


def test_a_design_fills_the_bounds_over_orders_of_magnitude() -> None:
    low, high = np.array([1e-4, -2.0, 0.0, -8.0]), np.array([1e-1, 2.0, 10.0, -2.0])
    starts = design(low, high)
    assert np.all((starts >= low) & (starts <= high))
    assert starts[0] == pytest.approx([10**-2.5, 0.0, 10.0**-0.5, -4.0])
    # one draw in every eighth of the decades, as in a Latin hypercube
    place = np.floor(8.0 * np.log10(starts[1:, 0] / 1e-4) / 3.0).astype(int)
    assert sorted(place) == list(range(8))
    assert np.array_equal(starts, design(low, high))


@pytest.mark.long
def test_a_wrong_valley_is_left() -> None:
    whole, given = arena(None), neutral_values(SuperModel.build(MODEL, []))
    first = enter(whole, (), given)
    assert abs(first.fit.theta[1] - 5.0) > 0.5  # where a single start ends
    best = Restarts(whole, lambda: arena(0.4), lambda: False, 40).best(first)
    assert best.fit.theta == pytest.approx([1.2, 5.0], rel=1e-2)


def test_two_starts_that_agree_are_enough() -> None:
    whole = arena(None)
    first = enter(whole, (), np.array([1.1, 5.02]))
    near = replace(
        MODEL, parameters={**MODEL.parameters, "w": replace(MODEL.parameters["w"], value=5.05)}
    )
    known = replace(whole, super_model=SuperModel.build(near, []))

    def never() -> Arena:
        raise AssertionError("no more starts are needed")

    best = Restarts(known, never, lambda: False, 40).best(first)
    assert best.fit.cost == pytest.approx(first.fit.cost, rel=1e-3)


def test_an_estimate_on_a_bound_is_found_and_said() -> None:
    whole = arena(None, w=0.9)
    entry = enter(whole, (), np.array([1.0, 1.05]))
    assert list(touched(whole, entry)) == [1]
    told = {"a": (1.2, 0.1), "w": (1.0, 0.0)}
    estimate: Any = SimpleNamespace(interval=told.__getitem__)
    (row,) = bound_rows(MODEL, estimate, estimate)
    assert row["check"] == "bound" and row["channel"] == "w"
    assert "w ends on its bound 1" in row["message"] and "widen it" in row["message"]


@pytest.mark.parametrize(("best", "kept"), [(1.0, 1.0), (0.3, 0.5), (0.0, 0.0)])
def test_what_follows_worse_than_the_given_values_is_drawn_back(best: float, kept: float) -> None:
    """The report's error is least at a share `best` of the way; the estimate is at all of it."""
    super_model = SuperModel.build(MODEL, [])
    given = neutral_values(super_model)
    step = np.array([0.0, 1.0])

    def free_run(prepared: object, theta: np.ndarray, horizon: object, like: object) -> object:
        share = float((theta - given)[1])
        return SimpleNamespace(nrmse=1.0 + abs(share - best))

    estimate = SimpleNamespace(lean=SimpleNamespace(free_run=free_run), theta=given + step)
    parts: Any = SimpleNamespace(
        arena=SimpleNamespace(super_model=super_model),
        case=SimpleNamespace(prepared=()),
        headline=1.0,
        horizons=[1.0],
    )

    def replaced(found: SimpleNamespace, **change: object) -> SimpleNamespace:
        return SimpleNamespace(**{**vars(found), **change})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("jaxsr.diagnosis.explaining.recalibrating.replace", replaced)
        found = not_worse(parts, estimate)
    assert found.theta == pytest.approx(given + kept * step)
