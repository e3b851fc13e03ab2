"""The contest: errors on held-back blocks, comparing sets, and intervals."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from diagnosis_systems import simulator_of

from jaxsr.diagnosis.contest.arena import Arena, build_arena
from jaxsr.diagnosis.contest.blocks import gain, held_back
from jaxsr.diagnosis.contest.enter import enter
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.diagnosis.contest.uncertainty import half_widths
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import Model, parse_model
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.rollout import Stepping, outputs
from jaxsr.models.segments import Prepared
from jaxsr.models.shooting import fit
from jaxsr.recordings import Recording

LINEAR = parse_model(
    """
[model]
states = ["q"]
outputs = ["y"]
[equations]
q = "a*cos(3*t) + b*sin(5*t)"
[readings]
y = "q"
[parameters]
a = { value = 0.0, bounds = [-100, 100] }
b = { value = 0.0, bounds = [-100, 100] }
"""
)
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


def linear_recording(seed: int) -> Recording:
    rng = np.random.default_rng(seed)
    time = np.arange(600) * 0.02
    y = 0.7 * np.sin(3 * time) / 3 + 0.2 * np.cos(5 * time) + 0.05 * time  # 0.05 t: not modelled
    return Recording("linear.csv", time, {"y": y + 0.02 * rng.standard_normal(600)})


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


def columns(arena: Arena) -> np.ndarray:
    """Effect of a, b and the start on the output of LINEAR, shape (3, samples, segments)."""
    problem = arena.problem

    def run(theta: list[float], start: float) -> np.ndarray:
        x0 = np.full_like(problem.segments.guess, start)
        return outputs(problem.simulator, problem.stepping, problem.segments, np.array(theta), x0)[
            0
        ]

    zero = run([0.0, 0.0], 0.0)
    return np.stack([run([1.0, 0.0], 0.0), run([0.0, 1.0], 0.0), run([0.0, 0.0], 1.0)]) - zero


def blocks_of(arena: Arena) -> dict[int, list[tuple[int, slice]]]:
    found: dict[int, list[tuple[int, slice]]] = {}
    for block, s, a, b in arena.pieces:
        found.setdefault(block, []).append((s, slice(a, b)))
    return found


def refitted(arena: Arena, scale: float) -> np.ndarray:
    """Errors by plain linear least squares without each block, one start per segment."""
    c, segments = columns(arena), arena.problem.segments
    y, used = segments.outputs[0], np.isfinite(segments.outputs[0])
    number = segments.count.size
    design = np.zeros((*y.shape, 2 + number))
    design[..., :2] = np.moveaxis(c[:2], 0, -1)
    for s in range(number):
        design[:, s, 2 + s] = c[2, :, s]
    errors = []
    for pieces in blocks_of(arena).values():
        out = np.zeros_like(used)
        for s, rows in pieces:
            out[rows, s] = True
        rest = used & ~out
        theta = np.linalg.lstsq(design[rest], y[rest], rcond=None)[0]
        for s in {s for s, _ in pieces if not rest[:, s].any()}:
            mine = used[:, s]
            left = y[mine, s] - design[mine, s, :2] @ theta[:2]
            theta[2 + s] = np.linalg.lstsq(c[2, mine, s][:, None], left, rcond=None)[0][0]
        out &= used
        errors.append(np.mean((y[out] - design[out] @ theta) ** 2) / scale**2)
    return np.array(errors)


@pytest.mark.parametrize("horizon", [0.5, 4.0, None], ids=["24 segments", "3 segments", "whole"])
def test_held_back_errors_equal_refitting_for_a_linear_model(horizon):
    scale = 0.1
    arena = arena_of(LINEAR, linear_recording(1), horizon, scale)
    errors = held_back(arena.pieces, arena.problem.segments, enter(arena, (), np.zeros(2)).fit)
    expected = refitted(arena, scale)
    assert errors.size == expected.size >= 10
    np.testing.assert_allclose(errors, expected, rtol=1e-6)


def only(problem: Problem, keep: np.ndarray) -> Problem:
    """The problem of some segments alone."""
    segments = problem.segments
    kept = {f.name: getattr(segments, f.name)[..., keep] for f in fields(segments)}
    return replace(problem, segments=replace(segments, **kept))


def test_held_back_errors_are_near_refitting_for_a_nonlinear_model():
    arena = arena_of(OSCILLATOR, swing_recording(2, 0.01), 1.0, 0.01)
    start, none = np.array([20.0, 0.8]), np.zeros(0, dtype=int)
    entry = enter(arena, (), start)
    problem = arena.problem
    for block, pieces in list(blocks_of(arena).items())[::3]:
        out = np.isin(np.arange(problem.segments.number), [s for s, _ in pieces])
        rest = fit(only(problem, ~out), entry.fit.theta, entry.fit.active, arena.bounds)
        own = fit(only(problem, out), rest.theta, none, arena.bounds)
        expected = own.cost / np.count_nonzero(own.residual)
        assert entry.errors[block] == pytest.approx(expected, rel=0.02)


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
    assert np.isfinite(found.errors).all()


def test_leaving_out_costs_more_than_fitting():
    arena = arena_of(LINEAR, linear_recording(3), 4.0, 0.1)
    result = enter(arena, (), np.zeros(2)).fit
    inside = result.cost / np.count_nonzero(result.residual)
    assert np.mean(held_back(arena.pieces, arena.problem.segments, result)) > inside


@dataclass(frozen=True)
class Equal:
    """Errors of twelve blocks for models that are equally good, with common ups and downs."""

    common: float = 0.8
    own: float = 0.1

    def draw(self, rng: np.random.Generator, models: int) -> np.ndarray:
        shared = self.common * rng.standard_normal(12)
        return np.exp(shared + self.own * rng.standard_normal((models, 12)))


@pytest.mark.parametrize("level", [0.05, 0.01])
def test_rate_of_false_alarms_is_the_stated_one(level):
    """Equal models: p < level in level of the draws; measured here 0.05 and 0.01."""
    rng = np.random.default_rng(5)
    draws = 4000
    alarms = sum(gain(*Equal().draw(rng, 2))[2] < level for _ in range(draws))
    error = np.sqrt(level * (1 - level) / draws)
    assert abs(alarms / draws - level) < 4 * error


def test_gain_is_the_mean_log_ratio():
    worse, better = np.exp([0.3, 0.5, 0.7]), np.ones(3)
    mean, error, p = gain(worse, better)
    assert mean == pytest.approx(0.5)
    assert error == pytest.approx(0.2 / np.sqrt(3))
    # Student's t with 2 degrees of freedom: sf(t) = 1/2 - t / (2 sqrt(2 + t^2)).
    t = mean / error
    assert p == pytest.approx(0.5 - t / (2 * np.sqrt(2 + t**2)))
    assert gain(better, worse)[0] == pytest.approx(-0.5)
    assert gain(better, better) == (0.0, 0.0, 0.5)


def entry(errors: np.ndarray, active: int, members: tuple[int, ...] = ()) -> Entry:
    """An entry with given errors and so many estimated constants."""
    none, residual = np.zeros(0), np.random.default_rng(0).standard_normal((1, 600, 2))
    fitted = Fit(none, none, 1.0, residual, np.arange(active), none, none, True)
    return Entry(members, fitted, np.asarray(errors))


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
