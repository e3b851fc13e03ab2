r"""Levenberg-Marquardt over inner constants, all sets of terms at once.

Steps use Kaufman's Jacobian of the projected residual,
:math:`J = -P^\perp_\Theta\, (\partial\Theta/\partial c)\,\xi`.

References
----------
Kaufman (1975), BIT 15, 49-57.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxsr.regression.gram import Array
from jaxsr.regression.projection import Places, Point, Sets, evaluate

if TYPE_CHECKING:
    from jaxsr.regression.constants import Refinement

# Share of a slope's square that is no more than rounding.
_ROUNDING = 1e-20


def _curvature(batch: Sets, point: Point, rows: Places) -> tuple[Array, Array]:
    """Return J^T J (rows, constants, constants) and J^T residual, in Kaufman's form."""
    slope = point.slopes[rows] * np.take_along_axis(point.xi[rows], batch.owner[rows], 1)[..., None]
    slope = batch.seen(slope)
    slope = np.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0)
    before = np.einsum("bkr,bkr->bk", slope, slope)
    for basis in (batch.basis[rows], point.basis[rows]):
        slope = slope - (slope @ basis.transpose(0, 2, 1)) @ basis
    # a constant that a coefficient can stand in for leaves only rounding
    own = np.einsum("bkr,bkr->bk", slope, slope) > _ROUNDING * before
    slope = np.where(own[:, :, None], slope, 0.0)
    moment = -(slope @ point.residual[rows][:, :, None])[:, :, 0]
    return slope @ slope.transpose(0, 2, 1), moment


def _moves(
    matrix: Array, moment: Array, damping: Array, c: Array, limits: Refinement
) -> tuple[Array, Array]:
    """Return damped steps and the fall of the loss that the linear model promises."""
    diagonal = np.sqrt(np.einsum("bkk->bk", matrix))
    scale = np.where(diagonal > 0.0, diagonal, 1.0)
    unit = matrix / (scale[:, :, None] * scale[:, None, :])
    damped = unit + damping[:, None, None] * np.eye(matrix.shape[1])
    delta = -np.linalg.solve(damped, (moment / scale)[:, :, None])[:, :, 0]
    promised = -np.sum(delta * (2.0 * moment / scale + (unit @ delta[:, :, None])[:, :, 0]), axis=1)
    delta = delta / scale
    # bounded one by one: a constant without influence must not hold the others back
    reach = limits.reach * np.maximum(np.abs(c), 1.0)
    return np.clip(delta, -reach, reach), promised


def levenberg_marquardt(batch: Sets, limits: Refinement, total: float) -> tuple[Array, Array]:
    """Return constants (sets, constants) and losses at a local minimum of each set's loss.

    Steps end where the loss is ``limits.floor`` of ``total``, or no longer falls.
    """
    every = np.arange(len(batch.start))
    c, damping = batch.start.copy(), np.full(len(every), 1e-3)
    point = evaluate(batch, c, every)
    live = np.isfinite(point.loss) & np.any(batch.used, axis=1)
    matrix = np.zeros((*c.shape, c.shape[1]))
    moment, stale = np.zeros_like(c), np.ones(len(every), dtype=bool)
    for _ in range(limits.iterations):
        live &= point.loss > limits.floor * total
        fresh = np.flatnonzero(live & stale)
        if len(fresh):
            matrix[fresh], moment[fresh] = _curvature(batch, point, fresh)
            stale[fresh] = False
        at = np.flatnonzero(live)
        delta, promised = _moves(matrix[at], moment[at], damping[at], c[at], limits)
        able = np.all(np.isfinite(delta), axis=1) & (promised > limits.gain * point.loss[at])
        live[at[~able]] = False
        at, delta = at[able], delta[able]
        if not len(at):
            break
        trial = evaluate(batch, c[at] + delta, at)
        better = trial.loss < point.loss[at]
        fall = 1.0 - trial.loss / point.loss[at]
        damping[at] = np.where(better, damping[at] / 6.0, damping[at] * 8.0)
        live[at] = np.where(better, fall >= limits.gain, damping[at] <= 1e6)
        won = at[better]
        c[won] += delta[better]
        point.update(won, trial, np.flatnonzero(better))
        stale[won] = True
    return c, point.loss
