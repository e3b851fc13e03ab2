"""Steps of integration fine enough that their errors leave the likelihood alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.likelihood.kalman import Latent, System, whitened
from jaxsr.diagnosis.likelihood.local import LocalModel, defects, linearised
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.diagnosis.shooting.integration import stable_substeps, with_steps
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import one_step
from jaxsr.models.rollout import Stepping

TOLERABLE = 0.5
"""Log likelihood that errors of integration may cost."""
FINEST = 16
"""Steps between two samples."""
FEWEST, MOST_PARTS, SHORTEST = 32, 64, 512
"""Parts that a step is taken in where a rounded jump turns over: to begin with, and those that
explicit steps may ask for; steps between two samples there at most."""
FLAT = 1e6
"""Factor on the width of a jump with which it asks for no short steps."""


def resolved(
    problem: Problem,
    theta: np.ndarray,
    path: np.ndarray,
    noise: Noise,
    start: np.ndarray,
    active: Sequence[int] = (),
) -> Problem:
    """Return the problem with the fewest steps whose errors the sensors would not see.

    The difference to twice as many steps enters the filter as a defect; half the sum of the squared
    innovations that it causes is what it may cost. Looked at first are the parts that steps are
    taken in where rounded jumps turn over.

    Parameters
    ----------
    noise : Noise
    start : ndarray, shape (states,)
        Variances of the states at the start of a piece.
    active : sequence of int
        Constants that what comes next differentiates by, so that it is done once (`linearised`).
    """
    problem = _cornered(problem, theta)
    known: dict[Stepping, np.ndarray] = {}

    def leading(there: Problem) -> np.ndarray:
        """Where the steps of a problem lead, less the path; shape (steps, pieces, states)."""
        if there.stepping not in known:
            with np.errstate(all="ignore"):
                args = there.simulator, there.stepping, there.segments, theta, path
                ends = one_step(*args, tangents=False)[0]
            known[there.stepping] = defects(ends, path, there.segments).transpose(1, 2, 0)
        return known[there.stepping]

    while True:
        with np.errstate(all="ignore"):
            args = problem.simulator, problem.stepping, problem.segments, theta, path
            local = linearised(*args, active)
        known[problem.stepping] = local.defect
        begun = problem.stepping
        while True:  # derivatives are dear, and hardly others with finer steps
            for finer in _finer(problem):
                loss = _loss(local, leading(finer) - leading(problem), noise, start)
                if np.isfinite(loss) and loss > TOLERABLE:
                    problem = finer
                    break
            else:
                break
        if problem.stepping == begun:
            return problem


def as_fine(problem: Problem, theta: np.ndarray, known: Stepping) -> Problem:
    """Return the problem with steps as fine as those found for a set like it.

    Steps that would not be stable are not taken, however few were enough there.
    """
    problem = _cornered(problem, theta)
    own = problem.stepping
    if known.method != own.method or known.substeps < own.substeps:
        return problem
    if known.substeps * known.parts <= own.substeps * own.parts:
        return problem
    problem = with_steps(problem, own.method, known.substeps)
    return replace(problem, stepping=replace(problem.stepping, parts=known.parts))


def _cornered(problem: Problem, theta: np.ndarray) -> Problem:
    """Return the problem with explicit steps, short where its rounded jumps turn over alone.

    As it is where nothing is rounded, and where the rest is stiff.
    """
    stepping = problem.stepping
    if not any(stepping.widths):
        return problem
    flat = replace(stepping, widths=tuple(FLAT * w for w in stepping.widths))
    needed = stable_substeps(problem, theta)
    steps = stable_substeps(replace(problem, stepping=flat), theta)
    steps = max(steps, stepping.substeps if stepping.method == "rk4" else 1)
    stiff = stepping.staying != "rk4" or needed > MOST_PARTS * steps
    parts = max(min(needed // steps, FEWEST) if stiff else needed // steps, stepping.parts)
    if steps > FINEST or parts <= 1:
        return problem
    if stepping.method != "rk4" or stepping.substeps != steps:
        problem = with_steps(problem, "rk4", steps)
    staying = "rodas3" if stiff else "rk4"
    return replace(problem, stepping=replace(problem.stepping, parts=parts, staying=staying))


def _finer(problem: Problem) -> Iterator[Problem]:
    """Return the problem with corners taken in more parts, and in shorter steps elsewhere."""
    stepping = problem.stepping
    steps, parts = stepping.substeps, stepping.parts
    if any(stepping.widths) and stepping.method == "rk4" and steps * parts < SHORTEST:
        yield replace(problem, stepping=replace(stepping, parts=2 * parts))
    if steps < FINEST:
        finer = with_steps(problem, stepping.method, 2 * steps)
        fewer = max(parts // 2, min(parts, FEWEST))  # corners ask for some however long a step
        yield replace(finer, stepping=replace(finer.stepping, parts=fewer))


def _loss(local: LocalModel, apart: np.ndarray, noise: Noise, start: np.ndarray) -> float:
    """Half the squared innovations that a difference of two ways to integrate causes.

    Its shape is (steps, pieces, states).
    """
    if not np.isfinite(apart).all():
        return np.inf
    nothing = np.where(np.isfinite(local.innovation), 0.0, np.nan)
    steps, pieces, n = apart.shape
    local = replace(local.moved(np.zeros(local.by_constant.shape[3])), defect=apart)
    local = replace(local, innovation=nothing)
    free = Latent(np.zeros((steps, pieces, n, 0)), np.zeros(0), 0.0)
    with np.errstate(all="ignore"):
        rows = whitened(System.of(local, [free], [noise], start)).rows[..., 0]
        return 0.5 * float(np.sum(rows**2))
