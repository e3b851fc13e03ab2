"""What an estimation minimises, and what it returns: residuals with their derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jaxsr.models.arrow import products, schur
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Segments
from jaxsr.models.simulator import Simulator

LARGEST = 1e60
"""Size from which a derivative counts as overflowed: its square must still add up."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Segments to be reproduced by a simulator.

    Attributes
    ----------
    scale : ndarray, shape (outputs,)
        Residuals are divided by it, so that outputs of different units add up.
    following : ndarray, shape (states, parameters, segments), optional
        Derivatives of starts that are not estimated, such as those of driven states, by the
        parameters.
    carried : ndarray, shape (states, common, segments), optional
        Derivatives of starts by further unknowns that segments have in common, such as where a
        memory stood when the recording began.
    """

    simulator: Simulator
    stepping: Stepping
    segments: Segments
    scale: np.ndarray
    following: np.ndarray | None = None
    carried: np.ndarray | None = None

    def residual(self, y: np.ndarray) -> np.ndarray:
        """Return (measured - y) / scale, zero where nothing was measured."""
        difference = (self.segments.outputs - y) / self.scale[:, None, None]
        return np.where(np.isfinite(self.segments.outputs), difference, 0.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares estimate and its linearisation.

    Attributes
    ----------
    theta : ndarray, shape (parameters,)
        All parameters of the model; those not in `active` as given.
    x0 : ndarray, shape (states, segments)
    cost : float
        Sum of squared scaled residuals.
    residual : ndarray, shape (outputs, samples, segments)
    active : ndarray of int
        Parameters that were estimated.
    jacobian : ndarray, shape (active, outputs, samples, segments)
        Derivative of the simulated outputs, divided by scale.
    by_start : ndarray, shape (states, outputs, samples, segments)
    converged : bool
    path : ndarray, shape (states, samples, segments), optional
        States along the segments, where the estimation knows them.
    """

    theta: np.ndarray
    x0: np.ndarray
    cost: float
    residual: np.ndarray
    active: np.ndarray
    jacobian: np.ndarray
    by_start: np.ndarray
    converged: bool
    path: np.ndarray | None = None

    @property
    def usable(self) -> bool:
        """Whether the derivatives are numbers; at an unstable point they overflow."""
        largest = max(
            np.abs(self.jacobian).max(initial=0.0), np.abs(self.by_start).max(initial=0.0)
        )
        return bool(np.isfinite(largest) and largest < LARGEST and np.isfinite(self.cost))

    @property
    def linearised(self) -> bool:
        """Whether it has its derivatives; a fit that was only expected has none."""
        return len(self.jacobian) == self.active.size

    def extended(self, theta: np.ndarray, segments: Segments | None = None) -> Fit:
        """Return the fit in a model with further parameters, and driven states, that do not act.

        The states are those that `segments` of that model have behind the known ones.
        """
        longer = replace(self, theta=np.concatenate([self.theta, theta]))
        known = len(self.x0)
        if segments is None or len(segments.guess) == known:
            return longer
        x0, path = np.concatenate([self.x0, segments.guess[known:]]), self.path
        still = np.zeros((len(x0) - known, *self.by_start.shape[1:]))
        by_start = np.concatenate([self.by_start, still])
        path = None if path is None else np.concatenate([path, segments.course[known:]])
        return replace(longer, x0=x0, by_start=by_start, path=path)

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Per segment: the starts projected out of J^T J and J^T r.

        Returns
        -------
        hessian : ndarray, shape (segments, active, active)
        gradient : ndarray, shape (segments, active)
        """
        blocks = products(self.residual, self.jacobian, self.by_start)
        return schur(*blocks, damping=0.0)[:2]


def squares(residual: np.ndarray) -> float:
    """Sum of squares, infinite where it is not finite."""
    cost = float(np.sum(residual**2))
    return cost if np.isfinite(cost) else np.inf


def weighed(
    problem: Problem,
    theta: np.ndarray,
    x0: np.ndarray,
    active: np.ndarray,
    outputs: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> Fit:
    """Divide readings and their derivatives by the outputs' scales."""
    y, by_theta, by_start = outputs
    weight = problem.segments.weights / problem.scale[:, None, None]
    residual = problem.residual(y)
    free = problem.segments.free_start[:, None, None, :]
    return Fit(
        theta=theta,
        x0=x0,
        cost=squares(residual),
        residual=residual,
        active=np.asarray(active, dtype=int),
        jacobian=np.where(weight > 0.0, by_theta * weight, 0.0),
        by_start=np.where(free & (weight > 0.0), by_start * weight, 0.0),
        converged=False,
    )
