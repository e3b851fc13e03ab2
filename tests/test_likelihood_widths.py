"""The width of a corner by Newton's steps: one more constant of the same normal equations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.evidence_plants import cart, drive
from jaxsr.diagnosis.likelihood import hypotheses, rounding
from jaxsr.diagnosis.likelihood.loop import begun
from jaxsr.diagnosis.likelihood.widths import WidthStep, width_step
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms import force_candidates
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.setup import state_scale
from jaxsr.models.segments import Prepared

INTERVAL, SAMPLES, FRICTION, WIDTH, NOISE = 0.03, 200, 1.5, 0.08, 1e-4


@pytest.fixture(scope="module")
def followed() -> Iterator[dict[str, Any]]:
    """A cart whose Coulomb friction turns over within `WIDTH`, followed to its mode."""
    rng = np.random.default_rng(5)
    plant = cart(lambda q, v: -FRICTION * np.tanh(v[0] / WIDTH))
    model = plant.simulator.model
    force = drive(rng, SAMPLES, INTERVAL, 3.0, (1.1, 2.3, 4.7))
    prepared = [Prepared.build(model, plant.recorded(rng, force, INTERVAL, NOISE))]
    every = force_candidates(model, state_scale(model, prepared))
    offered = {"constant_force", "coulomb_friction"}
    among = SuperModel.build(model, [c for c in every if c.mechanism in offered])
    work = Workspace.build(among, prepared, 10.0 * INTERVAL)
    names = [c.mechanism for c in work.super_model.candidates]
    coulomb = names.index("coulomb_friction")
    kept: dict[str, Any] = {}
    original = hypotheses.at_its_mode

    def watched(problem, sharp, values, path, follow, scales):
        found = original(problem, sharp, values, path, follow, scales)
        kept.update(follow=follow, scales=scales, found=found, sharpest=problem)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(hypotheses, "at_its_mode", watched)
        assert hypotheses.hypothesis(work, begun(work).table, (coulomb,)) is not None
    yield kept | {"work": work, "constant": names.index("constant_force"), "coulomb": coulomb}


@pytest.mark.parametrize("overshoot", [1.2, 2.5, 6.0])
def test_part_of_a_step_that_overshoots_ends_at_the_top(overshoot: float) -> None:
    """Log evidence is a parabola over the logarithm of the width, as the step believes, but for a
    bend that is `overshoot` times as large: the step is as many times too long."""
    start, top, high = 2.0, 2.0 * np.exp(0.2), 40.0
    bend = high / 0.2**2
    tried: dict[float, Any] = {}

    def log_evidence(width: float) -> float:
        return high - bend * float(np.log(width / top)) ** 2

    class Known(rounding._Widths):
        def __init__(self) -> None:
            self.tried, self.steps = tried, {}

        def log_evidence(self, width: float) -> float:
            return log_evidence(width)

        def better(self, width: float, than: float | None) -> bool:
            tried[width] = None
            assert than == start
            return log_evidence(width) > log_evidence(start) + rounding.SHARPENED

    slope = 2.0 * bend * 0.2  # by the logarithm of the width, where it starts
    step = WidthStep(0.2 * overshoot, 0.5 * slope * 0.2 * overshoot)
    found = Known()._along(start, step)
    assert found is not None
    if overshoot < 2.0:  # the whole step is better as it is
        assert found == pytest.approx(start * np.exp(0.2 * overshoot))
    else:
        assert found == pytest.approx(top)
    assert len(tried) == (1 if overshoot < 2.0 else 2)


def test_a_gain_that_no_width_is_needed_for_is_no_step() -> None:
    """Another size of the force is likelier, and where nothing jumps no width says anything."""

    class Known(rounding._Widths):
        def __init__(self) -> None:
            self.tried: dict[float, Any] = {2.0: None}

        def better(self, width: float, than: float | None) -> bool:
            return width != than

    assert Known()._along(2.0, WidthStep(0.0, 5.0)) is None


@pytest.mark.long
def test_a_constant_force_may_be_a_member_beside_a_jump(followed: dict[str, Any]) -> None:
    """It is then estimated, and stands for the latent force all the same."""
    work = followed["work"]
    both = (followed["constant"], followed["coulomb"])
    found = hypotheses.hypothesis(work, begun(work).table, both)
    assert found is not None and found.width is not None
    (name,) = found.names[both[0]].values()
    value, deviation = found.constants[name]
    assert abs(value) < 4.0 * deviation


def beside(followed: dict[str, Any], factor: float) -> tuple[float, WidthStep]:
    """Log evidence at the mode with jumps of `factor` times the best width, and Newton's step."""
    problem, found, _ = followed["found"]
    follow, scales = followed["follow"], followed["scales"]
    widths = tuple(factor * w for w in problem.stepping.widths)
    other = replace(problem, stepping=replace(problem.stepping, widths=widths))
    there = follow(other, found.theta, found.path, scales)
    step = width_step(other, there, follow.chosen, follow.helpers, follow.belief, scales)
    assert step is not None
    return there.log_evidence, step


def test_the_width_of_the_plant_is_found(followed: dict[str, Any]) -> None:
    """Newton's steps end where none promises to gain, at the width that the motion had."""
    problem, found, _ = followed["found"]
    (width,) = problem.stepping.widths
    assert width == pytest.approx(WIDTH, rel=0.05)
    assert found.settled
    assert beside(followed, 1.0)[1].gain < rounding.SHARPENED


@pytest.mark.parametrize("factor", [0.9, 0.95, 0.98, 1.02, 1.05, 1.1])
def test_a_step_leads_back_and_gains_what_it_promises(
    followed: dict[str, Any], factor: float
) -> None:
    """Of a parabola: half the slope over the bend lies ahead, all constants moving along."""
    best, _ = beside(followed, 1.0)
    behind, step = beside(followed, factor)
    assert step.change == pytest.approx(-np.log(factor), rel=0.3)
    assert step.gain == pytest.approx(best - behind, rel=0.4)
    assert step.gain > 3.0 * rounding.SHARPENED
