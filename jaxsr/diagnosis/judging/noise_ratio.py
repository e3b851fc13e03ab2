"""What a set leaves, relative to the noise of the sensors."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from jaxsr.diagnosis.shooting.arena import Arena
from jaxsr.diagnosis.shooting.colour import colour
from jaxsr.diagnosis.shooting.converters import finest_noise
from jaxsr.diagnosis.shooting.entry import Entry
from jaxsr.models.least_squares import LARGEST
from jaxsr.models.segments import Prepared
from jaxsr.recordings import noise_level

LIMITED = 10.0
"""Ratio of residual to sensor noise from which the model limits the fit, not coloured noise."""
MODEL_LIMITED = 3.0
"""Ratio of residual to sensor noise above which the model, not the sensor, sets the error."""
ABOVE_NOISE = 2.0
"""The same above which a set leaves something that it does not explain."""
NOISE_ALONE = 2.5
"""Ratio of residual to coloured noise up to which noise alone may be all that is left."""


def model_limited(arena: Arena, entry: Entry) -> bool:
    """Whether the residual stands clearly above the sensors' noise."""
    return residual_to_noise(arena, entry) > MODEL_LIMITED


def residual_to_noise(arena: Arena, entry: Entry) -> float:
    """Largest ratio, over the outputs, of rms residual to sensor noise."""
    return max(ratios_to_noise(arena, entry))


def ratios_to_noise(arena: Arena, entry: Entry) -> list[float]:
    """Ratio of rms residual to sensor noise, of every output.

    The differences that tell the noise see its spectrum at the highest frequencies alone, which
    for noise of lag-one correlation rho is (1 - rho)/(1 + rho) of white noise as strong. A
    simulation that escaped is beyond every noise.
    """
    ratios = []
    for k, scale in enumerate(arena.problem.scale):
        residual = entry.fit.residual[k] * scale
        if not np.abs(residual).max(initial=0.0) < LARGEST:
            ratios.append(np.inf)
            continue
        rho = colour(residual)
        ratio = root_mean_square(residual) / max(sensor_noise(arena, k), 1e-300)
        # More than such noise can leave is a misfit, whatever its correlation.
        coloured = ratio * np.sqrt((1.0 - rho) / (1.0 + rho))
        ratios.append(float(coloured if coloured < NOISE_ALONE else ratio))
    return ratios


def root_mean_square(residual: np.ndarray) -> float:
    """Over the samples that there are: what is missing is 0."""
    return float(np.sqrt(np.sum(residual**2) / max(np.count_nonzero(residual), 1)))


def in_noise(arena: Arena) -> Arena:
    """Return the arena with its outputs weighed by the noise of their sensors."""
    noise = np.array([sensor_noise(arena, k) for k in range(arena.problem.scale.size)])
    scale = np.where(noise > 0.0, noise, arena.problem.scale)
    return replace(arena, problem=replace(arena.problem, scale=scale))


def sensor_noise(arena: Arena, output: int) -> float:
    """Return the noise of a sensor over all recordings, as residuals have it, at least the finest.

    One recording may show too few levels for its steps to be told.
    """
    finest = finest_noise(arena.super_model.given, arena.prepared)[output]
    return max(_pooled_noise(arena.prepared, output), float(np.sqrt(finest)))


@lru_cache(maxsize=64)
def _pooled_noise(prepared: tuple[Prepared, ...], output: int) -> float:
    """Root mean square over all samples: a sensor is noisier in one recording than in another."""
    readings = [p.outputs[:, output] for p in prepared]
    count = np.array([np.count_nonzero(np.isfinite(y)) for y in readings])
    level = [noise_level(p.time, y) for p, y in zip(prepared, readings, strict=True)]
    told = np.where(count > 0, np.square(level), 0.0)
    return float(np.sqrt(np.sum(count * told) / max(count.sum(), 1)))
