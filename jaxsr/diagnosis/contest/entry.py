"""Entries: sets of candidates after estimation in free run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.contest.converters import Converters
from jaxsr.models.least_squares import Fit
from jaxsr.models.rollout import Stepping


@dataclass(frozen=True, eq=False)
class Entry:
    """One set of candidates after estimation in free run.

    Attributes
    ----------
    members : tuple of int
    fit : Fit
    errors : ndarray, shape (blocks,)
        Mean squared scaled residual of each block, estimated without it.
    stepping : Stepping, optional
        How it was integrated, where it asked for other steps or widths than the arena's.
    rounded : float
        Share of its cost that is the doing of how its jumps are rounded.
    seconds : float
        Time that its estimation took.
    converters : Converters, optional
        Of the sensors, in the unit of the residuals.
    """

    members: tuple[int, ...]
    fit: Fit
    errors: np.ndarray
    stepping: Stepping | None = None
    rounded: float = 0.0
    seconds: float = 0.0
    converters: Converters | None = None

    @property
    def error(self) -> float:
        """Geometric mean over the blocks."""
        return float(np.exp(np.mean(np.log(self.errors + 1e-300))))

    def lost(self) -> Entry:
        """Return the entry as one that could not be simulated."""
        return replace(
            self, fit=replace(self.fit, cost=np.inf), errors=np.full_like(self.errors, np.inf)
        )

    def scaled(self, factor: float) -> Entry:
        """Return the entry with residuals divided by a factor."""
        fitted = self.fit
        fitted = replace(
            fitted,
            cost=fitted.cost / factor**2,
            residual=fitted.residual / factor,
            jacobian=fitted.jacobian / factor,
            by_start=fitted.by_start / factor,
        )
        steps = None if self.converters is None else self.converters.scaled(factor)
        return replace(self, fit=fitted, errors=self.errors / factor**2, converters=steps)
