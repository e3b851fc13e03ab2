"""Noise that keeps its sign and a force that does: evidence does not hang on where it begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter
from test_likelihood_search import MODEL, TIME

from jaxsr.diagnosis.likelihood.course import followed
from jaxsr.diagnosis.likelihood.hypotheses import hypothesis
from jaxsr.diagnosis.likelihood.loop import begun
from jaxsr.diagnosis.likelihood.offered import offered
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models import parse_model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import Recording

PLANTS = 24


def correlated(
    rng: np.random.Generator, size: float, correlation: float, smoothing: float = 0.0
) -> np.ndarray:
    """Draw an autoregression of two poles, of the deviation `size`."""
    a, b = correlation, smoothing
    gain = (1.0 + a * b) / ((1.0 - a * b) * (1.0 - a * a) * (1.0 - b * b))
    innovations = size / np.sqrt(gain) * rng.normal(size=TIME.size)
    return np.asarray(lfilter([1.0], np.convolve([1.0, -a], [1.0, -b]), innovations))


def recorded(rng: np.random.Generator, force: float, decay: float, noise: Noise) -> Recording:
    """A run of the cart pushed by a force that nobody knows, its position read with the noise."""
    waves = np.sin(np.outer(TIME, [1.1, 2.3, 4.7]) + rng.uniform(0.0, 6.0, 3))
    drive = (rng.uniform(0.5, 2.0, 3) * waves).sum(axis=1)
    push = correlated(rng, force, decay)

    def rate(t: float, x: np.ndarray) -> list[float]:
        given = np.interp(t, TIME, drive) + np.interp(t, TIME, push)
        return [x[1], (given - 6.0 * x[0] - 0.4 * x[1]) / 1.3]

    run = solve_ivp(rate, (0.0, TIME[-1]), [0.2, 0.0], t_eval=TIME, rtol=1e-7, max_step=0.03)
    poles = (float(pole[0]) for pole in noise.poles)
    error = correlated(rng, float(np.sqrt(noise.coloured[0])), *poles)
    return Recording("run", TIME, {"u": drive, "y": run.y[0] + error})


@pytest.mark.long
@pytest.mark.parametrize("smoothing", [0.0, 0.5])
def test_re_calibration_has_the_evidence_that_it_has_from_the_true_noise_on(
    smoothing: float,
) -> None:
    """Sought one after the other, they had up to 9 less."""
    model, short = parse_model(MODEL), []
    for seed in range(PLANTS):
        rng = np.random.default_rng(seed)
        correlation, decay = rng.choice([0.5, 0.8]), rng.uniform(0.6, 0.95)
        sigma, force = 10.0 ** rng.uniform(-4.5, -3.5), 10.0 ** rng.uniform(-2.0, -1.0)
        truth = Noise(np.zeros(1), np.array([sigma**2]), np.array([correlation]))
        truth = replace(truth, smoothing=np.array([smoothing]))
        runs = [recorded(rng, force, decay, truth) for _ in range(2)]
        course = followed(model, [Prepared.build(model, run) for run in runs])
        assert course is not None
        every = SuperModel.build(model, offered(model, course, ()))
        work = Workspace.build(every, course.prepared, course.seconds, course.null.noise)
        state = begun(work, course.null)
        null = state.known[()]
        assert null is not None
        near = replace(null, noise=truth, decay=decay)
        best = hypothesis(work, state.table, (), near)
        short.append(0.0 if best is None else best.log_evidence - null.log_evidence)
    assert max(short) < 3.0
