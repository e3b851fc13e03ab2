"""A member of a set that may as well do nothing, by its interval, is no finding beside others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr.diagnosis.explaining.judge import _without_idle

GIVEN = {"J": 0.02, "Fc": 0.0, "kt": 0.0}
FRICTION, VALUE, DRIFT = 0, 1, 2


def parts(members: tuple[int, ...], known: tuple[tuple[int, ...], ...], weights: Any = None) -> Any:
    """Return what is judged: friction Fc, a wrong value of J and a drift kt, or some of them."""
    names = list(GIVEN)
    candidates = [SimpleNamespace(fixed_parameter=n) for n in (None, "J", None)]
    parameters = {n: SimpleNamespace(value=v) for n, v in GIVEN.items()}
    order = {FRICTION: "Fc", VALUE: "J", DRIFT: "kt"}
    super_model = SimpleNamespace(
        candidates=candidates,
        model=SimpleNamespace(parameters=parameters),
        index=lambda number, coefficients_only: [names.index(order[number])],
    )
    entries = [SimpleNamespace(members=m) for m in known]
    chosen = SimpleNamespace(members=members)
    arena = SimpleNamespace(super_model=super_model)
    return SimpleNamespace(arena=arena, chosen=chosen, entries=entries, weights=weights)


def estimate(value: float, drift: float = 0.0) -> Any:
    """Return estimates of J and kt beside 0.15 +- 0.01 for Fc."""
    return SimpleNamespace(theta=np.array([value, 0.15, drift]), told=np.array([5e-4, 1e-2, 0.026]))


@pytest.mark.parametrize(("value", "left"), [(0.0199, True), (0.0206, False)])
def test_a_value_that_may_be_the_given_one_is_left_out(value: float, left: bool) -> None:
    known = (), (FRICTION,), (FRICTION, VALUE)
    smaller = _without_idle(parts((FRICTION, VALUE), known), estimate(value))
    assert (smaller is not None) == left
    if smaller is not None:
        assert smaller.members == (FRICTION,)


@pytest.mark.parametrize(("drift", "left"), [(0.021, True), (-0.021, True), (0.03, False)])
def test_an_effect_that_may_be_none_is_left_out(drift: float, left: bool) -> None:
    known = (), (FRICTION,), (FRICTION, DRIFT)
    smaller = _without_idle(parts((FRICTION, DRIFT), known), estimate(0.02, drift))
    assert (smaller is not None) == left


def test_one_at_a_time_the_least_first() -> None:
    every = FRICTION, VALUE, DRIFT
    known = (FRICTION, VALUE), (FRICTION, DRIFT), every
    smaller = _without_idle(parts(every, known), estimate(0.0204, 0.001))
    assert smaller is not None and smaller.members == (FRICTION, VALUE)


def test_what_the_evidence_says_of_an_effect_stands() -> None:
    known, weights = ((FRICTION,), (FRICTION, DRIFT)), object()
    assert _without_idle(parts((FRICTION, DRIFT), known, weights), estimate(0.02)) is None


def test_what_was_not_estimated_or_would_leave_nothing_is_not_taken() -> None:
    assert _without_idle(parts((0, 1), ((), (0, 1))), estimate(0.02)) is None
    assert _without_idle(parts((1,), ((), (1,))), estimate(0.02)) is None
