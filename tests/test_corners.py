"""Rounded jumps that are taken in short parts where they turn over, and nowhere else."""

from __future__ import annotations

import numpy as np

from jaxsr.models import parse_model
from jaxsr.models.lifting import one_step
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.models.simulator import Simulator
from tests.test_switching import RUBBED_CART, SAMPLES, stuck_cart

WIDTH = 0.005
"""Of the rounded friction; a sample changes the speed by some 0.05."""


def stepped(substeps: int, parts: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends and derivatives of steps along a motion that slips, crosses and sticks; its speeds."""
    _, record, path = stuck_cart()
    simulator = Simulator(parse_model(RUBBED_CART))
    prepared = [Prepared.build(simulator.model, record)]
    segments = build_segments(simulator.model, prepared, [(0, 0, SAMPLES)], substeps)
    stepping = Stepping("rk4", substeps, (WIDTH,), parts=parts)
    theta = simulator.values()
    active = list(range(len(theta)))
    ends, slopes = one_step(simulator, stepping, segments, np.array(theta), path, active)
    return ends, slopes, path[1, :, 0]


def test_parts_where_a_jump_turns_over_are_worth_as_many_steps_everywhere() -> None:
    fine, coarse = stepped(64, 1), stepped(2, 1)
    for part, whole, rough in zip(stepped(2, 32)[:2], fine[:2], coarse[:2], strict=True):
        assert np.abs(part - whole).max() < 0.005 * np.abs(rough - whole).max()


def test_steps_away_from_a_jump_are_not_cut() -> None:
    (ends, slopes, speed), (coarse, by, _) = stepped(2, 32), stepped(2, 1)
    far = (np.abs(speed[:-1]) > 0.5) & (np.abs(speed[1:]) > 0.5)
    assert 10 < far.sum() < far.size - 10
    assert np.array_equal(ends[:, far], coarse[:, far])
    assert np.array_equal(slopes[:, :, far], by[:, :, far])
    assert not np.array_equal(ends[:, ~far], coarse[:, ~far])
