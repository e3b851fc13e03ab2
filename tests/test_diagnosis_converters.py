"""Converters in the likelihood: false alarms under pure quantisation, and what is a finding."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from jaxsr.diagnosis.explaining.coarse import coarse_sensors, rounded_reading
from jaxsr.diagnosis.judging.detection import detect_in_noise
from jaxsr.diagnosis.shooting.blocks import correlation_length
from jaxsr.diagnosis.shooting.converters import Converters, independent_samples, steps_of
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.expressions import evaluate
from jaxsr.models import Simulator, apply_edit, parse_model
from jaxsr.models.least_squares import Fit
from jaxsr.recordings.converter import effective_samples, uniform_variance

READS = '[model]\nstates = ["q"]\noutputs = ["y"]\n[equations]\nq = "-q"\n[readings]\ny = "2*q"\n{}'
STEP = 2.0


def entry(residual: np.ndarray, constants: int, step: float, held: float) -> Entry:
    """An entry of one segment, whose readings a converter makes."""
    r = residual[None, :, None]
    fit = Fit(
        theta=np.zeros(constants),
        x0=np.zeros((1, 1)),
        cost=float(np.sum(r**2)),
        residual=r,
        active=np.arange(constants),
        jacobian=np.zeros((constants, *r.shape)),
        by_start=np.zeros((1, *r.shape)),
        converged=True,
    )
    known = Converters(np.array([uniform_variance(step)]), np.array([held]))
    return Entry((), fit, np.full(12, fit.cost / residual.size), converters=known)


def quantised(rng: np.random.Generator, levels: float) -> tuple[np.ndarray, np.ndarray, Any]:
    """What a converter leaves of four sines, the given model's columns, and an effect's."""
    time = 0.01 * np.arange(400)
    lines, phases = rng.uniform(1.5, 9.0, 4), rng.uniform(0.0, 2.0 * np.pi, 4)
    motion = np.sin(np.multiply.outer(time, lines) + phases).sum(1)
    motion /= np.ptp(motion)
    step, offset = 1.0 / levels, rng.random()
    read = step * (np.round(motion / step + offset) - offset)
    speed = np.gradient(motion, time)
    base = np.column_stack([np.ones(400), motion, speed, np.gradient(speed, time)])
    # friction, as a damped spring answers it
    effect = lfilter([0.0, 1e-4], [1.0, -1.98, 0.983], np.sign(speed))
    return read - motion, base, (effect, step, 400.0 / effective_samples(read, step))


def left(residual: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]


@pytest.mark.parametrize("levels", [8, 20, 50, 400])
def test_pure_quantisation_seldom_passes_for_friction(levels: int) -> None:
    """The stated rate is 1 in 1000 draws; 3 or more of 250 would come up once in 460 runs."""
    rng, alarms = np.random.default_rng(levels), 0
    for _ in range(250):
        error, base, (effect, step, held) = quantised(rng, levels)
        null = entry(left(error, base), 4, step, held)
        found = entry(left(error, np.column_stack([base, effect])), 5, step, held)
        alarms += detect_in_noise(null, found, 1).detected
    assert alarms < 3


def test_samples_of_one_step_would_pass_for_more_than_they_are() -> None:
    """Counted by their correlation alone, residuals of 8 steps pass for friction once in 100."""
    rng, alarms = np.random.default_rng(8), 0
    for _ in range(1000):
        error, base, (effect, *_) = quantised(rng, 8)
        worse, better = left(error, base), left(error, np.column_stack([base, effect]))
        n = better.size / correlation_length(better[None, :, None])
        alarms += bool(n * np.log(np.sum(worse**2) / np.sum(better**2)) > 10.83)
    assert alarms >= 6


def test_friction_of_a_step_is_found_beside_a_coarse_converter() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        error, base, (effect, step, held) = quantised(rng, 20)
        seen = left(effect, base)
        error = error + seen * step / np.std(seen)
        null = entry(left(error, base), 4, step, held)
        found = entry(left(error, np.column_stack([base, effect])), 5, step, held)
        assert detect_in_noise(null, found, 40).detected


def test_what_steps_repeat_is_counted_once() -> None:
    rng = np.random.default_rng(2)
    white = rng.normal(size=(2, 400, 5))
    steps = Converters(np.array([1.0, 0.0]), np.array([8.0, 1.0]))
    plain = independent_samples(white, None)
    assert plain == pytest.approx(4000 / correlation_length(white))
    # all of the first output's variance is its steps'
    assert independent_samples(white, steps) == pytest.approx(2000 / 8 + plain / 2, rel=0.15)
    half = replace(steps, variance=np.array([0.5, 0.0]))
    assert independent_samples(white, half) == pytest.approx(2000 / 4.5 + plain / 2, rel=0.1)
    assert independent_samples(white, steps.scaled(1e3)) == pytest.approx(plain, rel=1e-4)


@dataclass(frozen=True, eq=False)
class Measured:
    """What a converter is told from."""

    outputs: np.ndarray


def prepared(*readings: np.ndarray) -> Any:
    return tuple(Measured(y[:, None]) for y in readings)


def waves(*sizes: float) -> list[np.ndarray]:
    rng, time = np.random.default_rng(5), np.arange(2500)
    heights = [size * np.sin(0.031 * time + rng.uniform(0, 6)) for size in sizes]
    return [STEP * np.round((h + 0.1 * rng.normal(size=h.size)) / STEP) for h in heights]


@pytest.mark.parametrize(
    ("stated", "found"),
    [
        ("", False),
        ("[resolution]\ny = 2.0", False),
        ("[resolution]\ny = 0.7", False),  # a third of 2 is 0.667
        ("[resolution]\ny = 0.6", True),
        ("[noise]\ny = 0.2", False),  # 2/sqrt(12)/3 = 0.192
        ("[noise]\ny = 0.18", True),
        ("[noise]\ny = 0.01\n[resolution]\ny = 2.0", False),
        ("[noise]\ny = 1.0\n[resolution]\ny = 0.1", True),
    ],
)
def test_steps_are_a_finding_only_where_less_than_a_third_is_stated(
    stated: str, found: bool
) -> None:
    model = parse_model(READS.format(stated))
    sensors = coarse_sensors(model, prepared(*waves(2.2, 30.0)))
    assert bool(sensors) is found
    for sensor in sensors:
        assert sensor.step == pytest.approx(STEP, rel=1e-6)
        assert sensor.half < 1e-6
        assert sensor.variance == pytest.approx(STEP**2 / 12.0)


def test_few_levels_are_steps_of_their_spacing_unless_the_model_knows_better() -> None:
    (low,) = waves(2.2)
    assert len(np.unique(low)) == 3
    assert steps_of(parse_model(READS.format("")), prepared(low)) == (pytest.approx(STEP),)
    told = parse_model(READS.format("[resolution]\ny = 1.0"))
    assert steps_of(told, prepared(low)) == (1.0,)
    # 0.7 is no step of readings that lie on another grid
    other = parse_model(READS.format("[resolution]\ny = 0.7"))
    assert steps_of(other, prepared(low)) == (pytest.approx(STEP),)
    still = prepared(np.full(100, 3.0))
    assert steps_of(parse_model(READS.format("")), still) == (0.0,)


def test_a_differenced_speed_of_three_levels_has_their_spacing() -> None:
    """Most samples are equal: no difference of neighbours tells any noise, and none is left."""
    position = 0.06 * np.round(0.4 * np.sin(0.02 * np.arange(400)) / 0.06)
    speed = np.diff(position) / 0.01
    assert np.median(np.abs(speed)) < 1e-9
    (step,) = steps_of(parse_model(READS.format("")), prepared(speed))
    assert step == pytest.approx(6.0, rel=1e-6)


def test_a_rounded_reading_is_a_model_that_reads_in_steps() -> None:
    model = parse_model(READS.format(""))
    coarse: Any = SimpleNamespace(output="y", step=0.25)
    rounded = Simulator(apply_edit(model, rounded_reading(model, coarse, "step")))
    x = np.linspace(-1.0, 1.0, 101)
    reading = rounded.model.term(rounded.model.readings["y"])
    y = evaluate(reading, {"q": x, "step": 0.25}, "numpy")
    np.testing.assert_allclose(y, 0.25 * np.floor(2.0 * x / 0.25 + 0.5))


def test_the_correlation_of_a_residual_does_not_depend_on_its_size():
    """What escaped is of any size, up to none that is a number."""
    rng = np.random.default_rng(4)
    slow = np.convolve(rng.normal(size=1010), np.ones(10), mode="valid")[None, :, None]
    usual = correlation_length(slow)
    assert 5.0 < usual < 15.0
    assert correlation_length(1e200 * slow) == pytest.approx(usual)
    assert correlation_length(0.0 * slow) == correlation_length(np.full_like(slow, np.inf)) == 1.0
