"""Free-run scores against closed forms (docs/method.md)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from diagnosis_systems import simulator_of

from jaxsr.diagnosis.shooting.scoring import FreeRun, free_run, horizons
from jaxsr.models import Model, parse_model
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

SINE = parse_model(
    """
[model]
states = ["q"]
outputs = ["y"]
[equations]
q = "cos(t)"
[readings]
y = "q"
"""
)
TWO = parse_model(
    """
[model]
states = ["q", "r"]
outputs = ["y", "z"]
[equations]
q = "cos(t)"
r = "r**2"
[readings]
y = "q"
z = "r"
"""
)
TIME = np.arange(2000) * 0.01
FIRST = 100  # samples of the first 5 %


def run(model: Model, channels: Sequence[dict[str, np.ndarray]], horizon: float | None) -> FreeRun:
    prepared = [
        Prepared.build(model, Recording(f"{k}.csv", TIME[: next(iter(c.values())).size], c))
        for k, c in enumerate(channels)
    ]
    simulator = simulator_of(model)
    return free_run(simulator, Stepping("rk4", 1), prepared, np.array(simulator.values()), horizon)


def shifted(offset: float, start: int = FIRST) -> np.ndarray:
    """What the model says, with an offset from sample `start` on."""
    return np.sin(TIME) + offset * (np.arange(TIME.size) >= start)


def test_perfect_model_has_no_error():
    assert run(SINE, [{"y": np.sin(TIME)}], None).nrmse < 1e-6


def test_offset_after_the_start_counts_by_its_size():
    y = shifted(0.3)
    expected = 0.3 * np.sqrt(0.95) / np.std(y)
    found = run(SINE, [{"y": y}], None)
    assert found.nrmse == pytest.approx(expected, rel=1e-5)
    assert found.rmse[0, 0] == pytest.approx(0.3 * np.sqrt(0.95), rel=1e-5)


def test_missing_samples_are_skipped():
    y = shifted(0.3)
    y[500:900:2] = np.nan
    wrong = np.count_nonzero(np.isfinite(y[FIRST:]))
    expected = 0.3 * np.sqrt(wrong / np.count_nonzero(np.isfinite(y))) / np.nanstd(y)
    assert run(SINE, [{"y": y}], None).nrmse == pytest.approx(expected, rel=1e-5)


def test_recordings_are_averaged():
    a, b = shifted(0.3), shifted(-0.8)
    alone = [run(SINE, [{"y": y}], None).nrmse for y in (a, b)]
    both = run(SINE, [{"y": a}, {"y": b}], None).nrmse
    assert both == pytest.approx(np.mean(alone), rel=1e-6)


def test_diverging_output_counts_as_ten():
    """r' = r^2 from 0.25 is infinite after 4 s; y is right."""
    z = 0.25 / (1 - 0.25 * np.minimum(TIME, 3.0))
    found = run(TWO, [{"y": np.sin(TIME), "z": z}], None)
    assert found.nrmse == pytest.approx(np.sqrt(10.0**2 / 2), rel=1e-6)


def test_start_is_estimated_on_the_first_samples_alone():
    rng = np.random.default_rng(0)
    y = np.sin(TIME) + 0.05 * rng.standard_normal(TIME.size)
    changed = y.copy()
    changed[FIRST:] += 2.0 + np.cos(3 * TIME[FIRST:])
    starts = [run(SINE, [{"y": v}], None).simulated[0][0, 0] for v in (y, changed)]
    # Later samples may move where the iteration begins, so equal to its tolerance.
    assert starts[0] == pytest.approx(starts[1], abs=1e-6)
    # The least-squares start of q(0) + sin(t) is the mean of y - sin(t).
    assert starts[0] == pytest.approx(np.mean((y - np.sin(TIME))[:FIRST]), abs=1e-6)


def test_whole_recordings_use_at_least_fifty_samples_and_segments_three():
    y = np.sin(TIME[:200])
    y[50:] += 1.0
    assert run(SINE, [{"y": y}], None).simulated[0][0, 0] == pytest.approx(0.0, abs=1e-6)
    # Segments of 20 samples: 5 % is one sample, three serve; the fourth changes nothing.
    y = np.sin(TIME)
    y[3::20] += 5.0
    found = run(SINE, [{"y": y}], 0.2)
    np.testing.assert_allclose(found.simulated[0][:, 0], np.sin(TIME), atol=1e-6)


def test_every_segment_has_a_start_of_its_own():
    """A staircase of one step per segment: no error, however high the stairs."""
    stairs = np.floor(TIME / 1.0 + 1e-9)
    found = run(SINE, [{"y": np.sin(TIME) + stairs}], 1.0)
    assert np.isfinite(found.simulated[0]).all()
    assert found.nrmse < 1e-6


def test_long_segments_are_scored_like_short_ones():
    """Beyond 3000 samples only the beginning serves for the start: same closed form."""
    time = np.arange(8000) * 0.0025
    y = np.sin(time) + 0.3 * (np.arange(8000) >= 400)
    simulator = simulator_of(SINE)
    prepared = [Prepared.build(SINE, Recording("long.csv", time, {"y": y}))]
    found = free_run(simulator, Stepping("rk4", 1), prepared, np.zeros(0), None)
    assert found.nrmse == pytest.approx(0.3 * np.sqrt(0.95) / np.std(y), rel=1e-5)


@pytest.mark.parametrize("samples", [60, 150, 400, 1000, 2000])
def test_three_horizons_or_more_and_the_last_is_the_whole_recording(samples):
    recording = Recording("r.csv", TIME[:samples], {"y": np.sin(TIME[:samples])})
    found = horizons([Prepared.build(SINE, recording)])
    assert len(found) >= 3
    assert found == sorted(set(found))
    assert found[-1] == pytest.approx(TIME[samples - 1])
