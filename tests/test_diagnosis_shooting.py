"""Sets of mechanisms estimated in free run: starts, gaps, and intervals."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from diagnosis_systems import simulator_of

from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.shooting.arena import Arena, build_arena
from jaxsr.diagnosis.shooting.enter import enter
from jaxsr.diagnosis.shooting.uncertainty import half_widths
from jaxsr.models import Model, parse_model
from jaxsr.models.least_squares import Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared
from jaxsr.models.shooting import fit
from jaxsr.recordings import Recording

OSCILLATOR = parse_model(
    """
[model]
states = ["q", "v"]
inputs = ["u"]
outputs = ["y"]
[equations]
q = "v"
v = "u - k*q - c*v"
[readings]
y = "q"
[parameters]
k = { value = 20.0, bounds = [1, 100] }
c = { value = 0.8, bounds = [0, 10] }
"""
)


def arena_of(model: Model, recording: Recording, horizon: float | None, scale: float) -> Arena:
    prepared = [Prepared.build(model, recording)]
    super_model = SuperModel.build(model, [])
    stepping, scales = Stepping("rk4", 2), np.array([scale])
    return build_arena(super_model, prepared, stepping, horizon, scales, simulator_of(model))


def swing_recording(seed: int, noise: float, count: int = 1000) -> Recording:
    """A linear oscillator under a multisine, integrated with many small steps."""
    rng = np.random.default_rng(seed)
    time, fine = np.arange(count) * 0.02, 10
    u = 5.0 * np.sin(3.1 * time) + 4.0 * np.sin(5.3 * time + 1.0) + 2.0 * np.sin(1.3 * time)
    h, q, v, path = 0.02 / fine, 0.1, 0.0, []
    for k in range(count):
        path.append(q)
        end = u[min(k + 1, count - 1)]
        for j in range(fine):
            a, m, b = (u[k] + (end - u[k]) * (j + s) / fine for s in (0.0, 0.5, 1.0))
            q, v = _step(q, v, h, (a, m, b))
    return Recording(
        "swing.csv", time, {"u": u, "y": np.array(path) + noise * rng.standard_normal(count)}
    )


def _step(q: float, v: float, h: float, u: tuple[float, float, float]) -> tuple[float, float]:
    """The classical fourth-order step of q'' = u - 20 q - 0.8 q'."""

    def rate(q: float, v: float, u: float) -> tuple[float, float]:
        return v, u - 20.0 * q - 0.8 * v

    k1 = rate(q, v, u[0])
    k2 = rate(q + h / 2 * k1[0], v + h / 2 * k1[1], u[1])
    k3 = rate(q + h / 2 * k2[0], v + h / 2 * k2[1], u[1])
    k4 = rate(q + h * k3[0], v + h * k3[1], u[2])
    return tuple(s + h / 6 * (k1[i] + 2 * k2[i] + 2 * k3[i] + k4[i]) for i, s in enumerate((q, v)))


def only(problem: Problem, keep: np.ndarray) -> Problem:
    """The problem of some segments alone."""
    segments = problem.segments
    kept = {f.name: getattr(segments, f.name)[..., keep] for f in fields(segments)}
    return replace(problem, segments=replace(segments, **kept))


def test_starts_that_the_model_gives_are_kept():
    """[initial] numbers hold at the first sample of a recording and are not estimated."""
    model = replace(OSCILLATOR, initial={"q": 0.1, "v": 0.0})
    arena = arena_of(model, swing_recording(12, 0.01), 1.0, 0.01)
    result = enter(arena, (), np.array([22.0, 1.0])).fit
    assert result.usable
    np.testing.assert_allclose(result.theta, [20.0, 0.8], rtol=0.02)
    np.testing.assert_array_equal(result.x0[:, 0], [0.1, 0.0])


def test_segments_without_a_sample_change_nothing():
    """A gap longer than a segment: the others are estimated as if it were not there."""
    recording = swing_recording(13, 0.01)
    gone = (recording.time >= 5.0 - 1e-9) & (recording.time < 7.0 - 1e-9)
    y = np.where(gone, np.nan, recording.channels["y"])
    gap = Recording("gap.csv", recording.time, {**recording.channels, "y": y})
    arena = arena_of(OSCILLATOR, gap, 1.0, 0.01)
    seen = np.isfinite(arena.problem.segments.outputs).any((0, 1))
    assert (~seen).sum() == 2
    start = np.array([22.0, 1.0])
    expected = fit(only(arena.problem, seen), start, np.arange(2), arena.bounds)
    found = enter(arena, (), start)
    np.testing.assert_allclose(found.fit.theta, expected.theta, rtol=1e-3)
    assert found.fit.usable


@pytest.mark.long
def test_intervals_cover_the_truth():
    """40 noisy recordings of one oscillator: 95 % intervals hold 88 to 100 % of the truths."""
    truth, held = np.array([20.0, 0.8]), []
    clean = swing_recording(0, 0.0)
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        noisy = clean.channels["y"] + 0.02 * rng.standard_normal(len(clean))
        recording = Recording("noisy.csv", clean.time, {**clean.channels, "y": noisy})
        arena = arena_of(OSCILLATOR, recording, 1.0, 0.02)
        result = enter(arena, (), np.array([22.0, 1.0])).fit
        half = half_widths(arena, result)
        assert (half > 0).all() and (half < 0.5 * truth).all()
        held.append(np.abs(result.theta - truth) <= half)
    assert 0.88 <= np.mean(held) <= 1.0
    # Not by being wide: the spread of the estimates is half an interval's half-width or so.
    assert 0.5 <= np.mean(held, axis=0).min()


def test_intervals_shrink_with_the_noise():
    arena, wide = {}, {}
    for noise in (0.01, 0.04):
        arena = arena_of(OSCILLATOR, swing_recording(4, noise), 1.0, 0.02)
        wide[noise] = half_widths(arena, enter(arena, (), np.array([20.0, 0.8])).fit)
    np.testing.assert_allclose(wide[0.04] / wide[0.01], 4.0, rtol=0.05)
