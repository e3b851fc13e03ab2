"""Sizes and correlations of the sensors' noise, by the likelihood itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.likelihood.estimate import Estimate, Scales
from jaxsr.diagnosis.likelihood.kalman import Noise, System, whitened
from jaxsr.diagnosis.likelihood.local import linearised
from jaxsr.models.least_squares import Problem

CORRELATIONS = (0.0, 0.3, 0.6, 0.8, 0.9, 0.97)
SIZES = (0.25, 0.5, 1.0, 2.0, 4.0)
WHITE = 0.02
"""White part of a coloured noise: no sensor knows its next value."""
ROUNDS = 2


def likeliest(problem: Problem, found: Estimate, helpers: np.ndarray, scales: Scales) -> Noise:
    """Return the noise that makes the innovations of an estimate most likely, sensor by sensor.

    Variances and correlations of one sensor are tried side by side, those of the others held, in
    `ROUNDS` rounds.

    Parameters
    ----------
    helpers : ndarray of int
        Parameters of the problem that stand for a force along an equation.
    """
    scales = replace(scales, forces=tuple(range(len(helpers))))
    args = problem.simulator, problem.stepping, problem.segments, found.theta, found.path
    local = linearised(*args, list(helpers))
    nothing = np.zeros(len(helpers))
    latent = scales.latent(local, found.share)
    local = local.moved(nothing)
    pieces = local.defect.shape[1]
    noise = scales.noise.scaled(found.mode.noise)
    for _ in range(ROUNDS):
        for k in range(len(noise.white)):
            every = [_with(noise, k, size, rho) for size in SIZES for rho in CORRELATIONS]
            systems = [System.of(local, latent, _coloured(n), scales.start) for n in every]
            rows = whitened(System.joined(systems))
            score = rows.log_determinant + np.sum(rows.rows[..., 0] ** 2, axis=1)
            score = score.reshape(len(every), pieces).sum(axis=1)
            noise = every[int(np.nanargmin(score))]
    return noise


def _with(noise: Noise, sensor: int, size: float, correlation: float) -> Noise:
    """Return the noise with that of one sensor of another size and correlation."""
    white, coloured, rho = noise.white.copy(), noise.coloured.copy(), noise.correlation.copy()
    whole = size * (white[sensor] + coloured[sensor])
    share = WHITE if correlation else 1.0
    white[sensor], coloured[sensor] = share * whole, (1.0 - share) * whole
    rho[sensor] = correlation
    return Noise(white, coloured, rho)


def _coloured(noise: Noise) -> Noise:
    """Return the noise with a state for every sensor, so that systems have one shape."""
    return replace(noise, coloured=np.maximum(noise.coloured, 1e-12 * noise.white))
