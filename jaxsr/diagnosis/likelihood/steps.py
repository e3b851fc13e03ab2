"""Steps of integration fine enough that their errors leave the likelihood alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.contest.integration import with_steps
from jaxsr.diagnosis.likelihood.kalman import Latent, Noise, System, whitened
from jaxsr.diagnosis.likelihood.local import defects, linearised
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import one_step

TOLERABLE = 0.5
"""Log likelihood that errors of integration may cost."""
FINEST = 16
"""Steps between two samples."""


def resolved(
    problem: Problem, theta: np.ndarray, path: np.ndarray, noise: Noise, start: np.ndarray
) -> Problem:
    """Return the problem with the fewest steps whose errors the sensors would not see.

    The difference to twice as many steps enters the filter as a defect; half the sum of the squared
    innovations that it causes is what it may cost.

    Parameters
    ----------
    noise : Noise
    start : ndarray, shape (states,)
        Variances of the states at the start of a piece.
    """
    count = problem.stepping.substeps
    while count < FINEST:
        fine = with_steps(problem, problem.stepping.method, 2 * count)
        loss = _loss(problem, fine, theta, path, noise, start)
        if not np.isfinite(loss) or loss <= TOLERABLE:
            return problem
        problem, count = fine, 2 * count
    return problem


def _loss(
    coarse: Problem,
    fine: Problem,
    theta: np.ndarray,
    path: np.ndarray,
    noise: Noise,
    start: np.ndarray,
) -> float:
    """Half the squared innovations that the difference of two ways to integrate causes."""
    with np.errstate(all="ignore"):
        local = linearised(coarse.simulator, coarse.stepping, coarse.segments, theta, path, ())
        args = fine.simulator, fine.stepping, fine.segments, theta, path
        defect = defects(one_step(*args, tangents=False)[0], path, fine.segments)
    apart = defect.transpose(1, 2, 0) - local.defect
    if not np.isfinite(apart).all():
        return np.inf
    nothing = np.where(np.isfinite(local.innovation), 0.0, np.nan)
    local = replace(local, defect=apart, innovation=nothing)
    steps, pieces, n = apart.shape
    free = Latent(np.zeros((steps, pieces, n, 0)), np.zeros(0), 0.0)
    rows = whitened(System.of(local, [free], [noise], start)).rows[..., 0]
    return 0.5 * float(np.sum(rows**2))
