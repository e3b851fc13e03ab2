"""Entries: sets of candidates after estimation in free run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.shooting.colour import independent
from jaxsr.diagnosis.shooting.converters import Converters
from jaxsr.models.least_squares import Fit
from jaxsr.models.rollout import Stepping

TRACE = 1e-12
"""Effect of a start, relative to the largest, that is more than rounding."""


@dataclass(frozen=True, eq=False)
class Entry:
    """One set of candidates after estimation in free run.

    Attributes
    ----------
    members : tuple of int
    fit : Fit
    stepping : Stepping, optional
        How it was integrated, where it asked for other steps or widths than the arena's.
    seconds : float
        Time that its estimation took.
    converters : Converters, optional
        Of the sensors, in the unit of the residuals.
    starts : int
        How many starts of states the residuals tell (`told_starts`).
    """

    members: tuple[int, ...]
    fit: Fit
    stepping: Stepping | None = None
    seconds: float = 0.0
    converters: Converters | None = None
    starts: int = 0

    @property
    def constants(self) -> int:
        """How many numbers were estimated: parameters, and the starts of states that show.

        A law of a position that no sensor tells, and nothing else needs, has one for every segment.
        """
        return self.fit.active.size + self.starts

    def follows_as_well_as(self, other: Entry) -> bool:
        """Whether it follows the recordings no worse, within one unit of log likelihood.

        What noise of a colour leaves is worth fewer samples.
        """
        count = max(independent(other.fit.residual), 1.0)
        return bool(self.fit.cost <= other.fit.cost * np.exp(2.0 / count))

    def lost(self) -> Entry:
        """Return the entry as one that could not be simulated."""
        return replace(self, fit=replace(self.fit, cost=np.inf))

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
        return replace(self, fit=fitted, converters=steps)


def told_starts(fit: Fit) -> int:
    """Return how many starts, of states and segments, move any residual of a fit."""
    size = np.abs(fit.by_start).max(axis=(1, 2), initial=0.0)
    return int(np.count_nonzero(size > TRACE * size.max(initial=0.0)))
