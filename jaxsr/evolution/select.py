"""Tournament selection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.evolution.individual import Individual


def tournament(
    rng: np.random.Generator,
    population: Sequence[Individual],
    fitness: np.ndarray,
    entrants: int = 3,
) -> Individual:
    """Return the fittest (lowest) of a few individuals drawn at random."""
    drawn = rng.integers(len(population), size=entrants)
    return population[drawn[np.argmin(fitness[drawn])]]
