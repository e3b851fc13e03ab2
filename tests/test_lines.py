"""Spectral lines of what re-calibration leaves, and along which coordinates they are offered."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.diagnosis.mechanisms.motion import Motion

TIME = np.linspace(0.0, 20.0, 2001)
FREQUENCY, PHASE = 7.3, 0.6


def motion() -> Motion:
    """Two equations; a push along the second is all that either leaves, the first sees a part."""
    rng = np.random.default_rng(1)
    push = np.sin(FREQUENCY * TIME + PHASE)
    residual = {
        "v": 0.01 * push + 0.02 * rng.normal(size=TIME.size),
        "w": push + 0.02 * rng.normal(size=TIME.size),
    }
    none = {state: np.zeros((TIME.size, 0)) for state in residual}
    return Motion(
        {"t": TIME}, ("run",), np.array([0, TIME.size]), lambda x: x, TIME, 0.01, residual, none
    )


@pytest.mark.parametrize("state", ["v", "w"])
def test_a_line_is_offered_along_every_coordinate_in_its_phase_there(state: str) -> None:
    line = motion().frequencies(state)[0]
    assert line.value == pytest.approx(FREQUENCY, abs=0.02)
    assert line.phase == pytest.approx(PHASE, abs=0.3)


def test_a_push_of_three_periods_is_offered() -> None:
    """Its peak is as wide as its neighbourhood: it stands out of nothing, and is all there is."""
    time, rng = np.linspace(0.0, 2.7, 180), np.random.default_rng(2)
    push = np.sin(FREQUENCY * time + PHASE) + 0.02 * rng.normal(size=time.size)
    none = {"v": np.zeros((time.size, 0))}
    short = Motion(
        {"t": time}, ("run",), np.array([0, 180]), lambda x: x, time, 0.015, {"v": push}, none
    )
    line = short.frequencies("v")[0]
    assert line.value == pytest.approx(FREQUENCY, rel=0.05)
    # from two periods in the record to a half at the spacing, in ranges from w/1.5 to 1.5 w
    low, top = 4.0 * np.pi / 2.7, np.pi / 0.03
    assert line.among == np.ceil(np.log(top / low) / np.log(2.25))
