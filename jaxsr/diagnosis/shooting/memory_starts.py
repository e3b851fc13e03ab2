"""Starts of driven states: where a memory stood when a recording began."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from jaxsr.models.driven import known_states
from jaxsr.models.least_squares import Fit, Problem
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Prepared, build_segments
from jaxsr.models.shooting import fit
from jaxsr.models.simulator import Simulator

START = 4.0
"""Variance of a start about the path, in that of the state over the recordings."""


def start_of(course: np.ndarray) -> np.ndarray:
    """Return variances of the states at a start, of their course (states, samples, pieces)."""
    moved = course.var(axis=(1, 2))
    # a state that nothing moved yet may be of any size that it has
    size = np.where(moved > 0.0, moved, np.mean(course**2, axis=(1, 2)))
    return START * size + 1e-24


def memory_starts(
    simulator: Simulator,
    stepping: Stepping,
    prepared: Sequence[Prepared],
    theta: np.ndarray,
    counts: Sequence[int],
    scale: np.ndarray,
    stop: Callable[[], bool] = lambda: False,
) -> list[np.ndarray]:
    r"""Return the driven states at the first sample of every recording, shape (driven,) each.

    They are believed to be at rest, within a variance :math:`\Lambda^{-1}` of `START` times that
    of their course. With the other states' starts projected out of the products H of derivatives
    of the first readings, and the variance s of what these leave, the most probable ones are

    .. math:: z = (H/s + \Lambda)^{-1} (H \hat z/s + \Lambda z_\text{rest}).

    Parameters
    ----------
    counts : sequence of int
        How many samples of every recording tell it.
    scale : ndarray, shape (outputs,)
    stop : callable
        Asked between iterations.
    """
    model = simulator.model
    count, none = len(model.driven), np.zeros(0, dtype=int)
    found = []
    for item, n in zip(prepared, counts, strict=True):
        course = known_states(model, item, theta)[:, -count:]
        segments = build_segments(model, [item], [(0, 0, n)], stepping.substeps, theta=theta)
        segments.free_start[-count:] = True
        problem = Problem(simulator, stepping, segments, scale)
        begun = fit(problem, theta, none, (theta, theta), stop=stop)
        precision = 1.0 / start_of(course.T[..., None])
        found.append(_shrunk(begun, course[0], precision))
    return found


def _shrunk(begun: Fit, rest: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """Return the most probable start between rest and what the readings tell."""
    count = len(rest)
    columns = begun.by_start[..., 0].reshape(len(begun.by_start), -1)
    if not (begun.usable and np.isfinite(begun.x0).all()):
        return rest
    others, own = columns[:-count], columns[-count:]
    # Scaled by what is believed: the identity, and what the readings add to it.
    size = np.sqrt(precision)[:, None]
    left = (own - own @ np.linalg.pinv(others) @ others) / size
    used = int(np.count_nonzero(np.abs(columns).any(axis=0)))
    variance = begun.cost / max(used - len(columns), 1) + 1e-300
    told = left @ left.T / variance
    away = size[:, 0] * (begun.x0[-count:, 0] - rest)
    return rest + np.linalg.solve(told + np.eye(count), told @ away) / size[:, 0]
