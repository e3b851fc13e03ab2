"""Decisions where noise limits the fit: false alarms, the price of choosing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from jaxsr.diagnosis.judging.detection import detect_in_noise
from jaxsr.diagnosis.judging.noise_ratio import NOISE_ALONE, residual_to_noise
from jaxsr.diagnosis.shooting.colour import colour, independent
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.models import parse_model
from jaxsr.models.least_squares import Fit

ROWS, SEGMENTS = 40, 25
SMOOTH = np.sin(np.multiply.outer(np.arange(ROWS * SEGMENTS), 1e-3 * np.arange(1, 9)))


@dataclass(frozen=True, eq=False)
class Measured:
    """What the noise of a recording is told from."""

    time: np.ndarray
    outputs: np.ndarray


def arena_of(*items: Measured) -> Any:
    """An arena of recordings of one sensor, of a model that states nothing of it."""
    text = '[model]\nstates = ["q"]\noutputs = ["y"]\n[equations]\nq = "-q"\n[readings]\ny = "q"\n'
    known = SimpleNamespace(given=parse_model(text))
    problem = SimpleNamespace(scale=np.ones(1))
    return SimpleNamespace(problem=problem, prepared=items, super_model=known)


def entry(residual: np.ndarray, constants: int, members: tuple[int, ...]) -> Entry:
    """An entry whose residual, (samples,), is cut into segments."""
    r = residual.reshape(SEGMENTS, ROWS).T[None]
    cost = float(np.sum(residual**2))
    none = np.zeros((constants, *r.shape))
    fit = Fit(
        theta=np.zeros(constants),
        x0=np.zeros((1, SEGMENTS)),
        cost=cost,
        residual=r,
        active=np.arange(constants),
        jacobian=none,
        by_start=np.zeros((1, *r.shape)),
        converged=True,
    )
    return Entry(members, fit, np.full(12, cost / residual.size))


def fitted(noise: np.ndarray, columns: np.ndarray) -> tuple[Entry, Entry]:
    """Re-calibration alone, and with columns fitted to pure noise."""
    left = noise - columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]
    return entry(noise, 2, ()), entry(left, 2 + columns.shape[1], (0,))


@pytest.mark.long
@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_pure_noise_seldom_passes_for_an_effect(correlation):
    """The stated rate is 1 in 1000; 9 or more of 2000 would come up once in 4000 runs of this."""
    rng, alarms = np.random.default_rng(1), 0
    for _ in range(2000):
        white = rng.normal(size=ROWS * SEGMENTS + 100)
        noise = np.asarray(lfilter([1.0], [1.0, -correlation], white))[100:]
        pick = SMOOTH[:, rng.choice(8, size=1)]
        alarms += detect_in_noise(*fitted(noise, pick), 1).detected
    assert alarms < 9


def test_an_effect_above_the_threshold_is_detected():
    rng = np.random.default_rng(2)
    for _ in range(50):
        noise = rng.normal(size=ROWS * SEGMENTS)
        column = SMOOTH[:, 3:4]
        worse = entry(noise + 0.4 * column[:, 0], 2, ())
        left = noise - column @ np.linalg.lstsq(column, noise, rcond=None)[0]
        assert detect_in_noise(worse, entry(left, 3, (0,)), 30).detected


@pytest.mark.parametrize("escaped", [np.inf, np.nan])
def test_what_escapes_is_no_detection_and_no_warning(escaped: float) -> None:
    calm = entry(np.random.default_rng(3).normal(size=ROWS * SEGMENTS), 2, ())
    gone = replace(calm, fit=replace(calm.fit, cost=escaped), members=(0,))
    assert not detect_in_noise(calm, gone, 30).detected
    assert not detect_in_noise(gone, gone, 30).detected


@pytest.mark.parametrize("rho", [0.5, 0.7, 0.85])
def test_the_colour_of_noise_is_its_lag_one_correlation(rho):
    rng = np.random.default_rng(6)
    white = rng.normal(size=(4000 + 200, 20))
    noise = np.asarray(lfilter([1.0], [1.0, -rho], white, axis=0))[200:]
    assert abs(colour(noise) - rho) < 0.05


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.8])
def test_coloured_noise_is_worth_fewer_samples(rho):
    """The mean of first-order noise varies as that of so many independent samples."""
    rng, count = np.random.default_rng(0), 40000
    white = rng.standard_normal(count)
    noise = np.asarray(lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], white))
    means = noise.reshape(400, 100).mean(axis=1)
    worth = independent(noise.reshape(1, count, 1)) / 400
    # a variance of 400 means is told to 7 %, of which 3.5 deviations are allowed
    assert worth == pytest.approx(1.0 / np.var(means), rel=0.25)


def test_white_noise_and_what_is_left_of_a_motion_have_no_colour():
    rng, t = np.random.default_rng(7), np.arange(4000.0)
    white = rng.normal(size=(4000, 5))
    motion = np.sin(np.multiply.outer(t, [0.02, 0.05, 0.08, 0.1, 0.03]))
    for residual in (white, motion, motion + 0.3 * white, 0.5 * motion + white):
        assert colour(residual) == 0.0


@pytest.mark.parametrize(("size", "seen"), [(1.0, 1.0), (8.0, 8.0)])
def test_coloured_noise_explains_a_residual_of_its_own_size_alone(size, seen):
    """A residual of the noise's colour but eight times as large is a misfit, uncorrected."""
    rng, rho = np.random.default_rng(8), 0.8
    t = np.arange(8000.0)
    white = rng.normal(size=t.size + 200)
    noise = np.asarray(lfilter([1.0], [1.0, -rho], white))[200:]
    item = Measured(t, (50.0 * np.sin(0.01 * t) + noise)[:, None])
    arena = arena_of(item)
    fit = SimpleNamespace(residual=size * noise.reshape(20, 400).T[None])
    outcome: Any = SimpleNamespace(fit=fit)
    ratio = residual_to_noise(arena, outcome)
    if size == 1.0:
        assert ratio == pytest.approx(seen, abs=0.2)
    else:
        # High differences see a third of this noise.
        assert ratio > NOISE_ALONE and ratio == pytest.approx(3.0 * seen, rel=0.2)


@pytest.mark.parametrize("beyond", [1e200, np.inf, np.nan])
def test_a_simulation_that_escaped_is_beyond_every_noise(beyond: float) -> None:
    t = np.arange(300.0)
    residual = np.random.default_rng(0).normal(size=(1, 300, 1))
    residual[0, 7] = beyond
    outcome: Any = SimpleNamespace(fit=SimpleNamespace(residual=residual))
    assert residual_to_noise(arena_of(Measured(t, np.sin(0.1 * t)[:, None])), outcome) == np.inf


def test_noise_is_no_less_than_a_converter_makes_over_all_recordings() -> None:
    """Three levels in each recording tell no steps; nine over all of them do."""
    t, step = np.arange(300.0), 0.5
    items = []
    for k in range(4):
        y = step * np.round((k * 1.0 + 0.45 * np.sin(0.02 * t)) / step)
        items.append(Measured(t, y[:, None]))
    arena = arena_of(*items)
    residual = np.random.default_rng(0).uniform(-step / 2, step / 2, (1, 300, 4))
    outcome: Any = SimpleNamespace(fit=SimpleNamespace(residual=residual))
    assert residual_to_noise(arena, outcome) == pytest.approx(1.0, abs=0.1)
