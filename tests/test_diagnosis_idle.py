"""A wrong value whose interval holds the given one is no finding beside what was found."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr.diagnosis.explaining.judge import _without_idle

GIVEN = {"J": 0.02, "Fc": 0.0}


def parts(members: tuple[int, ...], known: tuple[tuple[int, ...], ...]) -> Any:
    candidates = [SimpleNamespace(fixed_parameter=None), SimpleNamespace(fixed_parameter="J")]
    parameters = {n: SimpleNamespace(value=v) for n, v in GIVEN.items()}
    super_model = SimpleNamespace(
        candidates=candidates, model=SimpleNamespace(parameters=parameters)
    )
    entries = [SimpleNamespace(members=m) for m in known]
    chosen = SimpleNamespace(members=members)
    arena = SimpleNamespace(super_model=super_model)
    return SimpleNamespace(arena=arena, chosen=chosen, entries=entries)


def estimate(value: float) -> Any:
    return SimpleNamespace(
        positions={"J": 0, "Fc": 1},
        theta=np.array([value, 0.15]),
        told=np.array([5e-4, 1e-2]),
    )


@pytest.mark.parametrize(("value", "left"), [(0.0199, True), (0.0206, False)])
def test_a_value_that_may_be_the_given_one_is_left_out(value: float, left: bool) -> None:
    smaller = _without_idle(parts((0, 1), ((), (0,), (0, 1))), estimate(value))
    assert (smaller is not None) == left
    if smaller is not None:
        assert smaller.members == (0,)


def test_what_was_not_estimated_or_would_leave_nothing_is_not_taken() -> None:
    assert _without_idle(parts((0, 1), ((), (0, 1))), estimate(0.02)) is None
    assert _without_idle(parts((1,), ((), (1,))), estimate(0.02)) is None
