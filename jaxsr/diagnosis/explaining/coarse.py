"""A coarse converter: readings that stand on a grid wider than the noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.optimize
import scipy.special
import scipy.stats

from jaxsr.diagnosis.contest.arena import Arena
from jaxsr.diagnosis.contest.blocks import correlation_length
from jaxsr.diagnosis.contest.entry import Entry
from jaxsr.models import Edit, Model, Parameter
from jaxsr.recordings import quantisation_step

MATTERS = 0.25
"""Share of the residual's variance from which rounding is worth a finding."""
FINEST, WIDEST = 0.02, 20.0
"""Noise of a gridded reading that is tried, in steps of the grid."""


@dataclass(frozen=True)
class Coarse:
    """A sensor whose grid explains what is left.

    Attributes
    ----------
    output : str
    step : float
    log_likelihood : float
        Gain of the grid's likelihood over a Gaussian's.
    p : float
    variance_share : float
        Share of the residual's variance that rounding alone makes.
    half : float
        Half the interval of the step: how far readings lie off the grid, over their multiples.
    """

    output: str
    step: float
    log_likelihood: float
    p: float
    variance_share: float
    half: float


def coarse_sensors(arena: Arena, entry: Entry) -> list[Coarse]:
    r"""Return the sensors whose residuals a grid explains better than Gaussian noise, best first.

    A reading rounded to multiples of a step d, of a value h with noise of deviation s, has

    .. math:: P(y|h) = \Phi\big((y - h + d/2)/s\big) - \Phi\big((y - h - d/2)/s\big),

    and without a grid the density of a Gaussian times d. The two are the same where d is far
    below s (Sheppard), so that a fine converter is never named. Twice the gain, over the
    residuals' correlation length, is compared with chi-squared of one degree of freedom.
    """
    problem = arena.problem
    found = []
    for k, name in enumerate(problem.simulator.model.outputs):
        readings = np.concatenate([p.outputs[:, k] for p in arena.prepared])
        step = quantisation_step(readings)
        if step is None:
            continue
        own = entry.fit.residual[k : k + 1] * problem.scale[k]
        residual = own[0][problem.segments.weights[k] > 0]
        gain = _gain(residual, step) / correlation_length(own)
        p = float(scipy.stats.chi2.sf(2.0 * max(gain, 0.0), 1))
        share = float(min(step**2 / 12.0 / max(np.mean(residual**2), 1e-300), 1.0))
        found.append(Coarse(name, step, gain, p, share, _half_width(readings, step)))
    return sorted(found, key=lambda c: -c.log_likelihood)


def _half_width(readings: np.ndarray, step: float) -> float:
    """Bound of a step's error: a reading n steps from another is n times as sharp a ruler."""
    levels = np.unique(readings[np.isfinite(readings)])
    count = np.round((levels - levels[0]) / step)
    off = np.abs(levels - levels[0] - count * step)
    return float(np.quantile(off, 0.98) / max(count[-1], 1.0) + 1e-9 * step)


def _gain(residual: np.ndarray, step: float) -> float:
    """Log likelihood of a grid less that of a Gaussian, each at its best noise."""
    gaussian = -0.5 * residual.size * (np.log(2.0 * np.pi * np.mean(residual**2)) + 1.0)
    gaussian += residual.size * np.log(step)

    def wrong(log_noise: float) -> float:
        noise, size = step * np.exp(log_noise), np.abs(residual)
        # By symmetry, both on the side of the tail that keeps its digits.
        near = scipy.special.ndtr((0.5 * step - size) / noise)
        probability = near - scipy.special.ndtr((-0.5 * step - size) / noise)
        return -float(np.sum(np.log(np.maximum(probability, 1e-300))))

    best: Any = scipy.optimize.minimize_scalar(
        wrong, bounds=(np.log(FINEST), np.log(WIDEST)), method="bounded"
    )
    return -float(best.fun) - float(gaussian)


def rounded_reading(model: Model, coarse: Coarse, name: str) -> Edit:
    """Return the edit that rounds a reading to its grid, the step as parameter `name`."""
    old = model.readings[coarse.output]
    return Edit(
        {
            f"readings.{coarse.output}": f"{name}*floor(({old})/{name} + 0.5)",
            f"parameters.{name}": Parameter(coarse.step, model.units.get(coarse.output)),
        }
    )
