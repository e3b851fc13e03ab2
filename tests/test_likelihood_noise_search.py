"""The search for the noise of several sensors ends, whatever the evidence says."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxsr.diagnosis.likelihood import noise as module
from jaxsr.diagnosis.likelihood.sensor_noise import Noise


def searched(
    monkeypatch: pytest.MonkeyPatch, evidence: Any, stop: Any = lambda: False
) -> tuple[Noise, int]:
    """Search the noise of two sensors; return it, and how often evidence was asked about."""
    asked: list[Noise] = []

    def grams(rows: Any, lane: Any, room: Any) -> Any:
        own = evidence(rows[lane.start])
        asked.append(own)
        return SimpleNamespace(log_evidence=own, noise=1.0)

    every = SimpleNamespace(of=lambda part, latent, noises, start: noises)
    monkeypatch.setattr(module, "System", every)
    monkeypatch.setattr(module, "whitened", lambda noises: noises)
    monkeypatch.setattr(module, "Gram", SimpleNamespace(of=grams))
    monkeypatch.setattr(module, "modes", lambda modes, *_: modes)
    monkeypatch.setattr(module, "replace", lambda item, **_: item)
    white = Noise(np.ones(2), np.zeros(2), np.zeros(2))
    scales: Any = SimpleNamespace(
        noise=white, size=1.0, start=None, factors=(0.0, 1.0), allows=lambda _: True, decays=(0.9,)
    )
    part = SimpleNamespace(defect=np.zeros((3, 1)), of=lambda _: part, read=None)
    mode = SimpleNamespace(noise=1.0)
    found: Any = SimpleNamespace(
        local=part, latent=part, mode=mode, theta=np.zeros(1), share=0.5, decay=0.9
    )
    belief: Any = SimpleNamespace(about=lambda _: None, mixing=())
    best, *_ = module.likeliest(found, scales, np.zeros(1, int), belief, stop)
    return best, len(asked)


def test_it_ends_where_no_evidence_is_a_number(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = iter(range(10_000))

    def nowhere(noise: Noise) -> float:
        return 0.0 if next(asked) == 0 else np.nan

    best, _ = searched(monkeypatch, nowhere)
    np.testing.assert_array_equal(best.correlation, 0.0)


@pytest.mark.parametrize("wanted", [(0.0, 0.8), (0.95, 0.0), (0.25, 0.998), (0.65, 0.99)])
def test_each_sensor_comes_to_its_own_correlation(
    monkeypatch: pytest.MonkeyPatch, wanted: tuple[float, float]
) -> None:
    """The evidence falls with the steps of the list between a correlation and the right one."""
    steps = list(module.WHITE)

    def near(noise: Noise) -> float:
        pairs = zip(noise.correlation, wanted, strict=True)
        return -5.0 * sum(abs(steps.index(float(a)) - steps.index(b)) for a, b in pairs)

    best, asked = searched(monkeypatch, near)
    np.testing.assert_allclose(best.correlation, wanted)
    assert asked < 200


def test_nothing_is_asked_once_time_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    best, asked = searched(monkeypatch, lambda _: 0.0, lambda: True)
    assert asked == 1
    np.testing.assert_array_equal(best.correlation, 0.0)
