r"""Levenberg-Marquardt over inner constants, all sets of terms at once.

Steps use Kaufman's Jacobian of the projected residual,
:math:`J = -P^\perp_\Theta\, (\partial\Theta/\partial c)\,\xi`.

References
----------
Kaufman (1975), BIT 15, 49-57.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from jaxsr.regression.gram import Array
from jaxsr.regression.projection import Mask, Places, Point, Sets, evaluate
from jaxsr.regression.refinement import Refinement

ROUNDING = 1e-13
"""Share of a slope's square beside the columns below which its constant is held: products of
columns do not tell it from rounding, and a step along it is as long as a step may be."""


class Fits(Protocol):
    """Sets of terms whose loss is a function of their constants.

    Points are whatever the fits make: they have ``loss`` and ``unsure`` (sets,), and an ``update``
    from another point.
    """

    moves: Mask
    """Sets that hold constants."""

    def evaluate(self, constants: Array, rows: Places) -> Any:
        """Return the point of the sets ``rows`` at ``constants`` (rows, constants)."""
        ...

    def curvature(self, point: Any, rows: Places) -> tuple[Array, Array]:
        """Return J^T J (rows, constants, constants) and J^T residual at a point of all sets."""
        ...


class ExactFits:
    """Fits by orthogonalisation of the columns themselves."""

    def __init__(self, batch: Sets) -> None:
        self._batch = batch
        self.moves = np.any(batch.used, axis=1)

    def evaluate(self, constants: Array, rows: Places) -> Point:
        """Return the point of the sets ``rows`` at ``constants`` (rows, constants)."""
        return evaluate(self._batch, constants, rows)

    def curvature(self, point: Point, rows: Places) -> tuple[Array, Array]:
        """Return J^T J (rows, constants, constants) and J^T residual at a point of all sets."""
        return _curvature(self._batch, point, rows)


def _curvature(batch: Sets, point: Point, rows: Places) -> tuple[Array, Array]:
    """Return J^T J (rows, constants, constants) and J^T residual, in Kaufman's form."""
    slope = point.slopes[rows] * np.take_along_axis(point.xi[rows], batch.owner[rows], 1)[..., None]
    slope = batch.seen(slope)
    slope = np.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0)
    before = np.einsum("bkr,bkr->bk", slope, slope)
    for basis in (batch.basis[rows], point.basis[rows]):
        slope = slope - (slope @ basis.transpose(0, 2, 1)) @ basis
    # a constant that a coefficient can stand in for leaves only rounding
    own = np.einsum("bkr,bkr->bk", slope, slope) > ROUNDING * before
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


@dataclass(slots=True)
class Course:
    """Where the search of each set stands.

    Attributes
    ----------
    constants : ndarray, (sets, constants)
    damping : ndarray, (sets,)
    left : ndarray of int, (sets,)
        Steps that may still be tried.
    loss : ndarray, (sets,)
    unsure : ndarray of bool, (sets,)
        Where the search was left since the fits cannot tell how it goes on.
    """

    constants: Array
    damping: Array
    left: Places
    loss: Array
    unsure: Mask

    @classmethod
    def of(cls, start: Array, limits: Refinement) -> Course:
        """Return the course before the first step."""
        count = len(start)
        return cls(
            start.copy(),
            np.full(count, 1e-3),
            np.full(count, limits.iterations, dtype=np.intp),
            np.full(count, np.inf),
            np.zeros(count, dtype=bool),
        )

    def row(self, row: int) -> Course:
        """Return the course of one set."""
        parts = (getattr(self, name)[row : row + 1] for name in Course.__slots__)
        return Course(*(part.copy() for part in parts))

    def follow(self, row: int, other: Course) -> None:
        """Go on with the course of one set."""
        count = min(self.constants.shape[1], other.constants.shape[1])
        self.constants[row, :count] = other.constants[0, :count]
        self.damping[row], self.left[row] = other.damping[0], other.left[0]


def levenberg_marquardt(fits: Fits, course: Course, limits: Refinement, total: float) -> None:
    """Take ``course`` to a local minimum of each set's loss.

    Steps end where the loss is ``limits.floor`` of ``total``, or no longer falls.
    """
    c, damping = course.constants, course.damping
    every = np.arange(len(c))
    point = fits.evaluate(c, every)
    course.unsure[:] = point.unsure
    live = np.isfinite(point.loss) & fits.moves & ~point.unsure
    matrix = np.zeros((*c.shape, c.shape[1]))
    moment, stale = np.zeros_like(c), np.ones(len(every), dtype=bool)
    while True:
        live &= (point.loss > limits.floor * total) & (course.left > 0)
        fresh = np.flatnonzero(live & stale)
        if len(fresh):
            matrix[fresh], moment[fresh] = fits.curvature(point, fresh)
            stale[fresh] = False
        at = np.flatnonzero(live)
        delta, promised = _moves(matrix[at], moment[at], damping[at], c[at], limits)
        able = np.all(np.isfinite(delta), axis=1) & (promised > limits.gain * point.loss[at])
        live[at[~able]] = False
        at, delta = at[able], delta[able]
        if not len(at):
            break
        trial = fits.evaluate(c[at] + delta, at)
        course.unsure[at[trial.unsure]] = True
        live[at[trial.unsure]] = False
        told = np.flatnonzero(~trial.unsure)
        at, delta, loss = at[told], delta[told], trial.loss[told]
        course.left[at] -= 1
        better = loss < point.loss[at]
        fall = 1.0 - loss / point.loss[at]
        damping[at] = np.where(better, damping[at] / 6.0, damping[at] * 8.0)
        live[at] = np.where(better, fall >= limits.gain, damping[at] <= 1e6)
        won = at[better]
        c[won] += delta[better]
        point.update(won, trial, told[better])
        stale[won] = True
    course.loss[:] = point.loss
