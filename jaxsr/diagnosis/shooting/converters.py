"""Converters of the sensors: their steps, and how many independent residuals they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from jaxsr.diagnosis.shooting.blocks import correlation_length
from jaxsr.models import Model
from jaxsr.models.segments import Prepared
from jaxsr.recordings import quantisation_step
from jaxsr.recordings.converter import effective_samples, uniform_variance
from jaxsr.recordings.noise import level_spacing, on_grid

LEVELS = 6
"""Levels from which their spacing tells a step (`quantisation_step`)."""
BITS = 16
"""Of a good converter: no sensor is taken for finer than one over all that it reads."""


@dataclass(frozen=True, eq=False)
class Converters:
    """What the steps of the outputs' converters do to residuals.

    Attributes
    ----------
    variance : ndarray, shape (outputs,)
        Of the steps, q^2/12, in the square of the residuals' unit; 0 without steps.
    held : ndarray, shape (outputs,)
        Neighbouring readings that stay on one level, on average; at least 1.
    """

    variance: np.ndarray
    held: np.ndarray

    def scaled(self, factor: float | np.ndarray) -> Converters:
        """Return the converters of residuals that are divided by a factor."""
        return replace(self, variance=self.variance / np.asarray(factor) ** 2)


@lru_cache(maxsize=64)
def steps_of(model: Model, prepared: tuple[Prepared, ...]) -> tuple[float, ...]:
    """Return the step of every output as it is read, in its unit; 0 where none shows.

    Where too few levels are read to tell a grid, [resolution] does, if they lie on it, or else
    their spacing.
    """
    found = []
    for k, output in enumerate(model.outputs):
        readings = np.concatenate([item.outputs[:, k] for item in prepared])
        step, stated = quantisation_step(readings), model.resolution.get(output)
        seen = readings[np.isfinite(readings)]
        if step is None and seen.size:
            step = level_spacing(seen)
            if stated and np.ptp(seen) < LEVELS * stated and on_grid(seen, stated):
                step = stated
        found.append(step or 0.0)
    return tuple(found)


@lru_cache(maxsize=64)
def finest_noise(model: Model, prepared: tuple[Prepared, ...]) -> np.ndarray:
    """Return the variance of every output that no noise is below, in the square of its unit.

    That of its steps, as it is read, or of a good converter's over all that it reads; of a step of
    one unit where that is always the same. Recordings without noise are simulated: what their
    solver and this one leave is no physics, and less than that.
    """
    outputs = np.concatenate([item.outputs for item in prepared])
    reach = np.fmax.reduce(outputs) - np.fmin.reduce(outputs)
    steps = np.fmax(steps_of(model, prepared), reach / 2.0**BITS)
    return np.array([uniform_variance(step if step > 0.0 else 1.0) for step in steps])


@lru_cache(maxsize=64)
def converters_of(model: Model, prepared: tuple[Prepared, ...]) -> Converters:
    """Return the converters of residuals in the outputs' own units."""
    steps = steps_of(model, prepared)
    held = [_held([p.outputs[:, k] for p in prepared], step) for k, step in enumerate(steps)]
    return Converters(np.array([uniform_variance(s) for s in steps]), np.array(held))


def _held(readings: Sequence[np.ndarray], step: float) -> float:
    """Return how many readings carry one piece of information."""
    if not step:
        return 1.0
    count = sum(int(np.isfinite(y).sum()) for y in readings)
    return count / max(sum(effective_samples(y, step) for y in readings), 1)


def independent_samples(residual: np.ndarray, converters: Converters | None) -> float:
    r"""Return how many independent residuals there are.

    .. math:: \sum_k n_k / \max(L, s_k h_k + 1 - s_k)

    over the outputs k, with :math:`n_k` residuals, their correlation length L, of steps that hold
    :math:`h_k` readings and make the share :math:`s_k` of the variance. What steps repeat is no
    more information; the rest of the noise is new in every reading.

    Parameters
    ----------
    residual : ndarray, shape (outputs, samples, segments)
        Zero where nothing is read.
    converters : Converters, optional
    """
    length = correlation_length(residual)
    count = np.count_nonzero(residual, axis=(1, 2)).astype(float)
    if converters is None:
        return float(count.sum() / length)
    power = np.sum(residual**2, axis=(1, 2)) / np.maximum(count, 1.0)
    share = np.minimum(converters.variance / np.maximum(power, 1e-300), 1.0)
    return float(np.sum(count / np.maximum(length, share * converters.held + 1.0 - share)))


def correlated(residual: np.ndarray, converters: Converters) -> float:
    """Return how many residuals, shape (outputs, samples, segments), carry one independent one."""
    return np.count_nonzero(residual) / max(independent_samples(residual, converters), 1.0)
