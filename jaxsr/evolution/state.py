"""The state of a search between two generations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.fitness import FitnessState
from jaxsr.evolution.front import Front
from jaxsr.evolution.individual import Individual
from jaxsr.expressions.term import Term

Terms = tuple[Term, ...]


@dataclass(frozen=True, slots=True)
class SearchState:
    """What the next generation needs.

    Attributes
    ----------
    generation : int
    population : tuple of Individual
        Fittest first.
    front : Front
    rule : FitnessState
    refined : frozenset
        Sets of terms whose constants have been refined, and what came of it.
    idle : int
        Generations since the front last described the data better.
    exact : float
        Relative loss that errors of the target itself leave.
    enough : float
        Relative loss that is near enough to measurement noise not to start anew.
    fruitless : int
        Fresh populations in a row that did not lead to a better description.
    drawn, since : int
        Fresh populations so far, and the generation of the last one.
    described : float
        Shortest description of the data when the population was last drawn.
    """

    config: SearchConfig
    generation: int
    population: tuple[Individual, ...]
    front: Front
    rule: FitnessState
    refined: frozenset[Terms] = frozenset()
    idle: int = 0
    exact: float = 0.0
    enough: float = 0.0
    fruitless: int = 0
    drawn: int = 0
    since: int = 0
    described: float = np.inf
