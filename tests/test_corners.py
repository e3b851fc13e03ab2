"""Rounded jumps that are taken in short parts where they turn over, and nowhere else."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

from jaxsr.models import parse_model
from jaxsr.models.corners import EVEN, graded
from jaxsr.models.lifting import one_step
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.models.simulator import Simulator
from tests.test_switching import RUBBED_CART, SAMPLES, stuck_cart

WIDTH = 0.005
"""Of the rounded friction; a sample changes the speed by some 0.05."""


def stepped(
    substeps: int,
    parts: int,
    width: float = WIDTH,
    speed: np.ndarray | None = None,
    staying: Literal["rk4", "rodas3"] = "rk4",
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends and derivatives of steps along a motion that slips, crosses and sticks; its speeds."""
    _, record, path = stuck_cart()
    if speed is not None:
        path = np.stack([path[0], speed[:, None]])
    simulator = Simulator(parse_model(RUBBED_CART))
    prepared = [Prepared.build(simulator.model, record)]
    segments = build_segments(simulator.model, prepared, [(0, 0, SAMPLES)], substeps)
    stepping = Stepping("rk4", substeps, (width,), parts=parts, staying=staying)
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


def test_graded_parts_change_the_argument_equally() -> None:
    """Through a corner at a third of the step: no part takes more than its share of the level."""
    width, count, pieces = 1e-4, 41, 16
    at = (np.linspace(0.0, 1.0, pieces + 1) - 1.0 / 3.0)[:, None]
    shares = graded(at, np.diff(at, axis=0), width, count)[:, 0]
    assert shares[0] == 0.0 and shares[-1] == 1.0
    assert (np.diff(shares) > 0.0).all()
    argument = shares - 1.0 / 3.0
    level = np.sign(argument) * np.log1p(np.abs(argument) / width)
    assert np.abs(np.diff(level)).max() < 1.2 * (level[-1] - level[0]) / ((1 - EVEN) * (count - 1))
    assert np.diff(shares).max() < 1.2 / (EVEN * (count - 1))


def test_samples_are_graded_as_if_alone_beside_one_that_ran_away() -> None:
    rng, width, count = np.random.default_rng(1), 1e-3, 33
    at = rng.normal(size=(17, 60)).cumsum(axis=0)
    at[:, [0, 7, 31, 59]] = np.nan, np.inf, np.nan, np.nan
    with np.errstate(invalid="ignore"):
        ahead = np.diff(at, axis=0)
    with np.errstate(all="ignore"):  # as all steps of the likelihood
        shares = graded(at, ahead, width, count)
    for k in range(at.shape[1]):
        own = slice(k, k + 1)
        with np.errstate(all="ignore"):
            alone = graded(at[:, own], ahead[:, own], width, count)
        np.testing.assert_allclose(shares[:, own], alone, rtol=0.0, atol=1e-12)
    assert (np.diff(shares, axis=0) >= 0.0).all()
    assert (shares[0] == 0.0).all() and (shares[-1] == 1.0).all()


@pytest.mark.parametrize("width", [3e-3, 3e-4, 1e-4])
def test_few_parts_do_for_a_corner_of_any_width(width: float) -> None:
    """Against as many steps everywhere: states that turn over, or stop, within a sample.

    Equal parts lose as the corner sharpens, and explicit ones where a state stays in it.
    """
    speed = np.random.default_rng(0).uniform(-0.08, 0.08, SAMPLES)
    fine = stepped(1024, 1, width, speed)[0]
    before, after = speed[:-1], fine[1, :, 0]
    stopped = (np.abs(after) < width) & (np.abs(before) > 8 * width)
    turned = (before * after < 0.0) & ~stopped
    assert min(stopped.sum(), turned.sum()) > 10
    wrong = np.abs(stepped(1, 64, width, speed, staying="rodas3")[0] - fine)[1, :, 0]
    assert wrong[turned].max() < 1e-4
    assert wrong[stopped].max() < 1e-5
