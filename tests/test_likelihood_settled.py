"""Estimates that did not come to rest promise more than there is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.kalman import Noise
from jaxsr.diagnosis.likelihood.loop import State

NOISE = Noise(np.ones(1), np.zeros(1), np.zeros(1))


def known(members: tuple[int, ...], log: float, share: float, settled: bool) -> Hypothesis:
    names: dict[int, dict[str, str]] = {i: {} for i in members}
    return Hypothesis(
        members, log, share, {}, names, np.zeros(0), np.zeros((1, 1, 1)), settled, NOISE, 0.0
    )


def leader(*found: Hypothesis) -> tuple[int, ...]:
    candidates = [SimpleNamespace(physical=None, label=str(i), tried=1) for i in range(3)]
    work: Any = SimpleNamespace(super_model=SimpleNamespace(candidates=candidates))
    return State(work, {h.members: h for h in found}).leader.members


@pytest.mark.parametrize("settled", [False, True])
def test_where_a_set_left_nothing_others_as_large_lead_only_at_rest(settled: bool) -> None:
    less = known((), 0.0, 0.2, True), known((0,), 100.0, 0.0, True)
    assert leader(*less, known((0, 1), 150.0, 0.0, settled)) == ((0, 1) if settled else (0,))
    assert leader(*less, known((2,), 150.0, 0.0, settled)) == ((2,) if settled else (0,))


def test_where_a_force_is_left_an_estimate_on_its_way_leads() -> None:
    less = known((), 0.0, 0.2, True), known((0,), 100.0, 0.1, True)
    assert leader(*less, known((0, 1), 150.0, 0.0, False)) == (0, 1)
    less = known((), 0.0, 0.2, True), known((0, 1), 100.0, 0.0, True)
    assert leader(*less, known((2,), 150.0, 0.0, False)) == (2,)
