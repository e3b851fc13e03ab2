"""Mechanisms with memory in the weak view."""

from __future__ import annotations

import numpy as np
import pytest
from memory_plants import GIVEN, PLANTS, STEP

from jaxsr.diagnosis.mechanisms.memory import memory_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.screening.memory_columns import with_memory
from jaxsr.diagnosis.screening.weak_grid import WeakGrid
from jaxsr.diagnosis.screening.weak_system import weak_system
from jaxsr.diagnosis.setup import state_scale
from jaxsr.models import Simulator
from jaxsr.models.segments import Prepared


@pytest.mark.parametrize("mechanism", ["actuator_lag", "hysteresis"])
def test_the_planted_memory_explains_most_of_what_the_weak_view_leaves(mechanism):
    item = Prepared.build(GIVEN, PLANTS[mechanism].record(0))
    candidates = memory_candidates(GIVEN, state_scale(GIVEN, [item]), STEP)
    super_model = SuperModel.build(GIVEN, candidates)
    theta = np.array([p.value for p in super_model.model.parameters.values()])
    grid = WeakGrid.build(GIVEN, [item], 0.25)
    given = weak_system(Simulator(GIVEN), grid, theta[: len(GIVEN.parameters)])
    wide = np.zeros((given.residual.size, theta.size))
    wide[:, : given.jacobian.shape[1]] = given.jacobian
    system = with_memory(
        type(given)(**{**vars(given), "jacobian": wide, "theta": theta}), super_model, grid
    )
    base = super_model.base_index()

    def left(columns: list[int]) -> float:
        a = system.jacobian[:, columns]
        a = a / np.sqrt((a**2).sum(0))
        step = np.linalg.lstsq(a, -system.residual, rcond=None)[0]
        return float(np.mean((system.residual + a @ step) ** 2))

    gains = {}
    for i, candidate in enumerate(candidates):
        if candidate.states:
            columns = super_model.index(i, coefficients_only=True)
            ratio = left([*base, *columns]) / left(base)
            gains[candidate.mechanism] = min(ratio, gains.get(candidate.mechanism, 1.0))
    assert min(gains, key=lambda m: gains[m]) == mechanism
    assert gains[mechanism] < 0.3
