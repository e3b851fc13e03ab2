r"""Paths that follow readings and equations as well as both allow: where a state hides.

Minimises, over the states at all samples,

    sum_k |y_k - h(x_k)|^2 / scale^2 + stiffness * sum_k |F_k(x_k) - x_{k+1}|^2 / size^2,

by Gauss-Newton; the normal equations are block tridiagonal. With the stiffness raised step by
step the path becomes a simulation (weak-constraint smoothing; Tremolet, Q. J. R. Meteorol. Soc.
132 (2006)).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxsr.models.lifting import one_step, readings_along
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Segments
from jaxsr.models.simulator import Simulator

Array = Any
STIFFNESS = (1.0, 1e2, 1e4, 1e6)
ITERATIONS = 4
TRUST = 1.0
"""Longest step of a state, in its typical sizes."""


def relaxed(
    simulator: Simulator, stepping: Stepping, segments: Segments, theta: Array, scale: Array
) -> Array:
    """Return states along the segments, shape (states, samples, segments).

    Parameters
    ----------
    scale : ndarray, shape (outputs,)
        Size of a misfit that matters.
    """
    path = segments.course.copy()
    hidden = np.ptp(path, axis=(1, 2)) == 0.0
    weights = segments.weights / scale[:, None, None] ** 2
    measured = np.where(np.isfinite(segments.outputs), segments.outputs, 0.0)
    for stiffness in STIFFNESS:
        for _ in range(ITERATIONS):
            size = _sizes(path, hidden)
            ends, slopes = one_step(simulator, stepping, segments, theta, path)
            y, by = readings_along(simulator, stepping, segments, theta, path)
            price = stiffness / size**2
            step = _tridiagonal(
                slopes, ends - path[:, 1:], by, (measured - y) * weights, weights, price
            )
            limit = TRUST * size[:, None, None]
            step = np.clip(np.nan_to_num(step), -limit, limit)
            path = path + step
            if np.abs(step / size[:, None, None]).max() < 1e-3:
                break
    return path


def _sizes(path: Array, hidden: Array) -> Array:
    """Typical size of every state; a hidden one is given that of the others to begin with."""
    size = np.std(path, axis=(1, 2))
    known = size[~hidden & (size > 0)]
    return np.maximum(size, 0.1 * np.median(known) if known.size else 1.0)


def _tridiagonal(
    slopes: Array, defects: Array, by: Array, pull: Array, weights: Array, price: Array
) -> Array:
    """Solve the normal equations for a step of the path, sample by sample and back.

    slopes (states, states, steps, segments), defects (states, steps, segments),
    by (outputs, states, samples, segments), pull and weights (outputs, samples, segments).
    """
    phi = slopes.transpose(2, 3, 0, 1)
    left = defects.transpose(1, 2, 0)
    right = np.einsum("oits,ots->tsi", by, pull)
    diagonal = np.einsum("oits,ots,ojts->tsij", by, weights, by)
    weighted = phi * price[:, None]
    diagonal[:-1] += np.einsum("tski,tskj->tsij", phi, weighted)
    diagonal[1:] += np.diag(price)
    right[:-1] -= np.einsum("tski,tsk->tsi", weighted, left)
    right[1:] += price * left
    upper = -weighted.transpose(0, 1, 3, 2)  # between sample k and k + 1
    n = diagonal.shape[-1]
    ridge = 1e-12 * np.einsum("tsii->ts", diagonal)[..., None, None] * np.eye(n)
    diagonal = diagonal + ridge
    steps = len(upper)
    back = np.empty_like(upper)
    for k in range(steps):
        both = np.concatenate([upper[k], right[k, :, :, None]], axis=2)
        solved = np.linalg.solve(diagonal[k], both)
        back[k] = solved[..., :n]
        lower = upper[k].transpose(0, 2, 1)
        diagonal[k + 1] -= lower @ solved[..., :n]
        right[k + 1] -= (lower @ solved[..., n:])[..., 0]
        right[k] = solved[..., n]
    x = np.empty_like(right)
    x[-1] = np.linalg.solve(diagonal[-1], right[-1][..., None])[..., 0]
    for k in reversed(range(steps)):
        x[k] = right[k] - (back[k] @ x[k + 1][..., None])[..., 0]
    return x.transpose(2, 0, 1)
