"""What is left is measured by the noise of the sensors, which recordings may differ in."""

from __future__ import annotations

import numpy as np
import pytest

from jaxsr.diagnosis.judging.noise_ratio import _pooled_noise
from jaxsr.models import parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

MODEL = parse_model("""
[model]
states = ["x", "v"]
outputs = ["y", "z"]
[equations]
x = "v"
v = "-9.0*x - c*v"
[readings]
y = "x"
z = "v"
[parameters]
c = { value = 0.2, bounds = [0.0, 1.0] }
""")
TIME = np.arange(600) * 0.02
LEVELS = (0.002, 0.02)


def recorded(rng: np.random.Generator, level: float, number: int) -> Recording:
    """A decay from rest, both of its sensors as noisy as that."""
    w = np.sqrt(9.0 - 0.01)
    x = np.exp(-0.1 * TIME) * (np.cos(w * TIME) + 0.1 / w * np.sin(w * TIME))
    v = -9.0 / w * np.exp(-0.1 * TIME) * np.sin(w * TIME)
    noise = level * rng.standard_normal((2, TIME.size))
    return Recording(f"run{number}", TIME, {"y": x + noise[0], "z": v + noise[1]})


def test_noise_is_pooled_as_residuals_are() -> None:
    """The root mean square over samples, within 15 %: four deviations of it on 600 samples."""
    rng = np.random.default_rng(0)
    records = [recorded(rng, level, k) for k, level in enumerate(LEVELS)]
    prepared = tuple(Prepared.build(MODEL, r) for r in records)
    pooled = float(np.sqrt(np.mean(np.square(LEVELS))))
    assert _pooled_noise(prepared, 0) == pytest.approx(pooled, rel=0.15)


def test_a_sensor_that_a_recording_lacks_has_no_noise_there() -> None:
    rng = np.random.default_rng(1)
    whole, half = (recorded(rng, LEVELS[1], k) for k in range(2))
    lacking = Recording("half", TIME, {"y": half.channels["y"], "z": np.full(TIME.size, np.nan)})
    alone = _pooled_noise((Prepared.build(MODEL, whole),), 1)
    both = _pooled_noise((Prepared.build(MODEL, whole), Prepared.build(MODEL, lacking)), 1)
    assert both == pytest.approx(alone, rel=1e-12)
