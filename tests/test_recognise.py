"""Recognition of states that are rates of others."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from jaxsr.discovery.recognise import recognised
from jaxsr.discovery.samples import Samples, roles, samples
from jaxsr.recordings import Recording


@cache
def _glide(seed: int, noise: float, gain: float = 1.0, n: int = 300, bias: float = 0.0) -> Samples:
    """x and its rate, both with noise relative to their spread, in two recordings."""
    rng = np.random.default_rng(seed)
    recordings = []
    for k in range(2):
        t = np.linspace(0.0, 10.0, n)
        a, b = rng.uniform(0.5, 2.0, size=2)
        x = np.sin(a * t) + 0.4 * np.cos(3.0 * b * t) + 0.5 * k
        v = gain * (a * np.cos(a * t) - 1.2 * b * np.sin(3.0 * b * t)) + bias
        w = np.cos(a * t + 0.3)
        x, v, w = (y + noise * np.std(y) * rng.normal(size=n) for y in (x, v, w))
        channels = {"x": x, "v": v, "w": w, "dx": v, "dv": w, "dw": x}
        recordings.append(Recording(f"run{k}", t, channels))
    return samples(recordings, roles(["x", "v", "w"], ["dx", "dv", "dw"], 1, (), None))


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.01, 0.05])
@pytest.mark.parametrize("seed", range(5))
def test_a_rate_is_recognised(seed: int, noise: float) -> None:
    data = _glide(seed, noise)
    assert recognised(data, "x", ("x", "v", "w")) == "v"
    assert recognised(data, "x", ("x", "w", "v")) == "v"
    assert recognised(data, "v", ("x", "v", "w")) is None
    assert recognised(data, "w", ("x", "v", "w")) is None


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 5))]
)
def test_an_impostor_is_not_a_rate(seed: int, noise: float) -> None:
    names = ("x", "v", "w")
    assert recognised(_glide(seed, noise, gain=1.05), "x", names) is None  # in another unit
    assert recognised(_glide(seed, noise, gain=-1.0), "x", names) is None
    assert recognised(_glide(seed, noise, bias=0.3), "x", names) is None  # drifts away
    assert recognised(_glide(seed, noise), "x", ("x", "w")) is None  # the rate is not there


def test_a_state_at_rest_has_no_rate() -> None:
    t = np.linspace(0.0, 1.0, 50)
    zero = np.zeros(50)
    channels = {"x": zero + 1.0, "v": zero, "dx": zero, "dv": zero}
    data = samples([Recording("rest", t, channels)], roles(["x", "v"], ["dx", "dv"], 1, (), None))
    assert recognised(data, "x", ("x", "v")) is None
