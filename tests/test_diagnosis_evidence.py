"""What a report is drawn from: the weak view of both models, and free runs as time allows."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr._progress import Budget
from jaxsr.diagnosis.explaining.document import _in_time
from jaxsr.diagnosis.explaining.evidence import Forces, force_errors
from jaxsr.diagnosis.weak.weak_system import WeakSystem
from jaxsr.models import parse_model

MODEL = parse_model(
    """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - q"
[readings]
y = "q"
"""
)


def system(states: list[int], size: float) -> WeakSystem:
    """Three rows for each of the states, with a residual of this size."""
    rows = np.repeat(np.array(states, dtype=int), 3)
    one = np.ones(rows.size)
    return WeakSystem(
        size * one,
        np.ones((rows.size, 1)),
        2.0 * one,
        rows,
        0 * rows,
        one,
        0 * rows,
        np.zeros(1),
        0.1,
    )


def forces(before: list[int], after: list[int]) -> Forces:
    """Both systems as a diagnosis builds them."""
    given = (system(before, 1.0), system(after, 0.5))
    old, new = (SimpleNamespace(system=lambda prepared, width, s=s: s) for s in given)
    judged: Any = SimpleNamespace(recalibrated=old, explained=new)
    return Forces.of(judged, (), 0.1)


def test_only_equations_that_both_models_show_are_compared() -> None:
    """A mechanism may lead a hidden state into an equation, which then cannot be seen."""
    both = forces([0, 1], [1])
    assert both.recalibrated.residual.shape == both.explained.residual.shape == (3,)
    assert both.recalibrated.jacobian.shape == (3, 1)
    found = force_errors(MODEL, both, None)
    assert found is not None and list(found) == ["equation:v"]
    assert found["equation:v"]["train"] == {"recalibrated": 0.5, "explained": 0.25}
    assert found["equation:v"]["held_out"] is None


def test_an_input_behind_a_memory_is_still_what_forces_are_measured_by() -> None:
    both = forces([1], [1])
    behind = replace(both.explained, input_side=1e-20 * both.explained.input_side)
    found = force_errors(MODEL, replace(both, explained=behind), None)
    assert found is not None
    assert found["equation:v"]["train"] == {"recalibrated": 0.5, "explained": 0.25}


def test_forces_that_no_sensor_shows_are_not_reported() -> None:
    assert force_errors(MODEL, forces([1], []), None) is None
    assert force_errors(MODEL, None, None) is None


@pytest.mark.parametrize(
    ("seconds", "begun", "run"),
    [
        (10.0, 0.0, [2.0, 10.0, 0.5]),  # 0.5 s are left before the last, of 3 s that one takes
        (math.inf, 0.0, [2.0, 10.0, 0.5, 0.1]),
        (10.0, -20.0, [2.0, 10.0]),
    ],
)
def test_short_horizons_are_left_out_where_the_time_is_over(
    monkeypatch: pytest.MonkeyPatch, seconds: float, begun: float, run: list[float]
) -> None:
    clock = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    case = SimpleNamespace(budget=Budget(seconds, begun))
    parts: Any = SimpleNamespace(case=case, headline=2.0)
    met = []
    for horizon in _in_time(parts, [0.1, 0.5, 2.0, 10.0]):
        met.append(horizon)
        clock[0] += 3.0
    assert met == run
