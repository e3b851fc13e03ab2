"""The Pareto front of loss against complexity."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from jaxsr.evolution.individual import Individual

ROUNDING = 1e-24  # relative losses below this differ by rounding alone


@dataclass(frozen=True, slots=True)
class Front:
    """Individuals none of which is beaten in both size and loss, smallest first.

    Attributes
    ----------
    members : tuple of Individual
    floor : float
        Losses below it differ by errors of the target alone.
    """

    members: tuple[Individual, ...] = ()
    floor: float = ROUNDING

    def with_(self, individuals: Iterable[Individual]) -> Front:
        """Return the front after more individuals have been seen; the first of equals stays."""
        pool = [*self.members, *(i for i in individuals if np.isfinite(i.loss) and i.terms)]
        pool.sort(key=lambda ind: (ind.size, ind.loss))
        kept: list[Individual] = []
        for individual in pool:
            if not kept or max(individual.loss, self.floor) < kept[-1].loss:
                kept.append(individual)
        return Front(tuple(kept), self.floor)

    @property
    def best_loss(self) -> float:
        """Return the lowest loss seen."""
        return self.members[-1].loss if self.members else np.inf

    def best_description(self, rows: int, floor: float = 1e-16) -> float:
        r"""Return the lowest :math:`N\log(loss + floor) + size \log N` on the front."""
        lengths = [
            rows * np.log(ind.loss + floor) + ind.size * np.log(rows) for ind in self.members
        ]
        return float(min(lengths, default=np.inf))
