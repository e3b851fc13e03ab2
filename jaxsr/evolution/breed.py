"""Make the children of a generation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.create import random_terms
from jaxsr.evolution.crossover import crossover
from jaxsr.evolution.fitness import FitnessState, fitness
from jaxsr.evolution.front import Front
from jaxsr.evolution.individual import Individual, Problem
from jaxsr.evolution.mutate import mutate_constant, mutate_subtree
from jaxsr.evolution.offers import small_offers
from jaxsr.evolution.select import tournament
from jaxsr.expressions.term import Term

Terms = tuple[Term, ...]
_SCREENED = 8  # small terms offered to a greedy child


def breed(
    rng: np.random.Generator,
    population: Sequence[Individual],
    front: Front,
    problem: Problem,
    config: SearchConfig,
    generation: int,
    rule: FitnessState,
) -> list[Terms]:
    """Return sets of terms: survivors by tournament, then children of the population.

    Crossover draws its parents by tournament from everyone; mutation takes its parent from the
    best set and the front, as the paper has it.
    """
    names = list(problem.variables)
    score = fitness(population, rule, config.fitness, problem)
    count = max(2, int(config.elite * config.population))
    best = [*population[:count], *front.members]
    survivors = int(config.reproduction * config.population)
    out: list[Terms] = [tournament(rng, population, score).terms for _ in range(survivors)]
    weights = np.array(config.weights.as_tuple())
    kinds = rng.choice(len(weights), size=config.population, p=weights / weights.sum())
    offers: dict[Terms, list[Term]] = {}
    for kind in kinds:
        parent = best[rng.integers(len(best))]
        match kind:
            case 0:
                first, second = (tournament(rng, population, score) for _ in range(2))
                out += crossover(rng, first, second, config.sizes.later)
            case 1:
                out.append(
                    mutate_subtree(rng, parent.terms, names, config.primitives, config.sizes)
                )
            case 2:
                out.append(mutate_constant(rng, parent.terms, generation, config.vartheta, best))
            case 3:
                size = int(rng.integers(1, config.sizes.at_birth + 3))
                new = random_terms(rng, names, config.primitives, size, 1)
                out.append((*parent.terms, *new))
            case 4:
                out.append(_without(parent.terms, int(rng.integers(len(parent.terms)))))
            case _:
                out.append(_greedy(rng, parent.terms, problem, config, offers))
        if len(out) >= config.population:
            break
    return out


def _without(terms: Terms, place: int) -> Terms:
    return terms[:place] + terms[place + 1 :]


def _greedy(
    rng: np.random.Generator,
    terms: Terms,
    problem: Problem,
    config: SearchConfig,
    offers: dict[Terms, list[Term]],
) -> Terms:
    """Add, or put in place of a random term, a small term that explains most of the residual."""
    if len(terms) > 1 and rng.random() < 0.5:
        terms = _without(terms, int(rng.integers(len(terms))))
    if terms not in offers:
        offers[terms] = small_offers(problem, config, terms, _SCREENED)
    if not offers[terms]:
        return terms
    # the best offers first: a geometric draw
    place = min(int(rng.geometric(0.4)) - 1, len(offers[terms]) - 1)
    return (*terms, offers[terms][place])
