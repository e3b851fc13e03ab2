"""The search as ``init`` and ``step``: state in, state and info out.

A generation breeds children, weighs them in one batch, thresholds the best set, refines the
constants of the most promising, and updates the Pareto front.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._progress import Budget, as_budget
from jaxsr._result import StoppedBy
from jaxsr.evolution.breed import breed
from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.create import random_terms, small_terms
from jaxsr.evolution.fitness import FitnessState, fitness, next_state
from jaxsr.evolution.front import Front
from jaxsr.evolution.individual import Individual, Problem
from jaxsr.evolution.polish import polish, promising, with_frequencies
from jaxsr.expressions.editing import edit
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
    """

    config: SearchConfig
    generation: int
    population: tuple[Individual, ...]
    front: Front
    rule: FitnessState
    refined: frozenset[Terms] = frozenset()
    idle: int = 0


@dataclass(frozen=True, slots=True)
class SearchInfo:
    """What a person or a test asks about one generation."""

    generation: int
    evaluated: int
    unusable: int
    best_loss: float
    best_size: int
    alpha: float


def init(
    rng: np.random.Generator,
    problem: Problem,
    config: SearchConfig,
    guesses: Iterable[Sequence[Term]] = (),
) -> SearchState:
    """Create the first population: small terms, random ones of ramped size, and guesses."""
    names = list(problem.variables)
    library = small_terms(names, config.primitives)
    usable = [t for t, k in zip(library, problem.index(library), strict=True) if k >= 0]
    sets: list[Terms] = [edit(guess) for guess in guesses]
    sets += [(term,) for term in usable[: config.population // 3]]
    while len(sets) < 2 * config.population:
        count = int(rng.integers(1, min(6, config.sizes.terms) + 1))
        if usable and rng.random() < 0.5:
            picked = rng.integers(len(usable), size=count)
            sets.append(tuple(dict.fromkeys(usable[k] for k in picked)))
        else:
            size = config.sizes.at_birth
            sets.append(random_terms(rng, names, config.primitives, size, count))
    population = weigh(problem, sets, config)
    rule = FitnessState(increment=config.fitness.increment)
    order = np.argsort(fitness(population, rule, config.fitness.tau), kind="stable")
    ranked = tuple(population[k] for k in order[: config.population])
    return SearchState(config, 0, ranked, Front().with_(ranked), rule)


def weigh(problem: Problem, sets: Iterable[Terms], config: SearchConfig) -> list[Individual]:
    """Return usable individuals for the distinct sets among ``sets``, in one batched solve.

    Terms that are not finite on the data are removed from their set, not the set with them.
    """
    sets = [terms for terms in sets if terms]
    flat = list(dict.fromkeys(term for terms in sets for term in terms))
    usable = {t: k >= 0 for t, k in zip(flat, problem.index(flat), strict=True)}
    unique: dict[frozenset[Term], Terms] = {}
    for terms in sets:
        kept = tuple(t for t in terms if usable[t] and t.size <= config.sizes.later + 4)[
            : config.sizes.terms
        ]
        if kept:
            unique.setdefault(frozenset(kept), kept)
    candidates = list(unique.values())
    if not candidates:
        return []
    _, losses = problem.solve(candidates)
    return [Individual.of(t, x) for t, x in zip(candidates, losses, strict=True) if np.isfinite(x)]


def step(
    rng: np.random.Generator, state: SearchState, problem: Problem
) -> tuple[SearchState, SearchInfo]:
    """Run one generation."""
    config = state.config
    generation = state.generation + 1
    children = breed(rng, state.population, state.front, problem, config, generation, state.rule)
    edited = [edit(terms) for terms in children]
    newborn = weigh(problem, edited, config)
    elite = state.population[: max(2, int(config.elite * config.population))]
    thresholded = weigh(problem, [problem.prune(ind.terms) for ind in elite], config)
    pool = _distinct([*elite, *thresholded, *newborn])
    ranked = _ranked(pool, state.rule, config)
    front = state.front.with_(ranked)
    refined = state.refined
    if config.refined:
        chosen = promising(ranked, front, refined, config.refined, problem.rows)
        better, refined = _refine(problem, chosen, refined)
        waves, refined = _refine(
            problem, with_frequencies(problem, front, generation, config), refined
        )
        front, found, refined = polish(problem, front.with_([*better, *waves]), config, refined)
        ranked = _ranked(_distinct([*found, *better, *waves, *ranked]), state.rule, config)
    front = front.with_(ranked)
    rule = next_state(state.rule, config.fitness, ranked[: len(elite)], generation)
    gain = state.front.best_description(problem.rows) - front.best_description(problem.rows)
    after = replace(
        state,
        generation=generation,
        population=tuple(ranked[: config.population]),
        front=front,
        rule=rule,
        refined=refined,
        idle=0 if gain > 1.0 else state.idle + 1,
    )
    best = front.members[-1] if front.members else Individual.of((), np.inf)
    info = SearchInfo(
        generation, len(edited), len(edited) - len(newborn), best.loss, best.size, rule.alpha
    )
    return after, info


def stopped(state: SearchState) -> StoppedBy | None:
    """Tell whether the search is over: target reached and settled, patience or generations out."""
    if state.front.best_loss <= state.config.target and state.idle >= 2:
        return StoppedBy.TARGET
    if state.idle >= state.config.patience or state.generation >= state.config.generations:
        return StoppedBy.CONVERGED
    return None


def search(
    rng: np.random.Generator,
    problem: Problem,
    config: SearchConfig | None = None,
    *,
    guesses: Iterable[Sequence[Term]] = (),
    budget: float | Budget | None = None,
    progress: Callable[[SearchInfo], None] | None = None,
) -> tuple[SearchState, StoppedBy]:
    """Run generations until the search is over, the budget (seconds) spent, or interrupted.

    An interrupt returns the best so far, marked as such.
    """
    limit = as_budget(budget)
    state = init(rng, problem, config or SearchConfig(), guesses)
    try:
        while True:
            reason = stopped(state)
            if reason is not None:
                return state, reason
            if limit.exhausted:
                return state, limit.stopped_by
            state, info = step(rng, state, problem)
            if progress is not None:
                progress(info)
    except KeyboardInterrupt:
        return state, StoppedBy.INTERRUPTED


def _ranked(
    pool: Sequence[Individual], rule: FitnessState, config: SearchConfig
) -> list[Individual]:
    order = np.argsort(fitness(pool, rule, config.fitness.tau), kind="stable")
    return [pool[k] for k in order]


def _distinct(individuals: Iterable[Individual]) -> list[Individual]:
    return list({frozenset(ind.terms): ind for ind in individuals}.values())


def _refine(
    problem: Problem, sets: Iterable[Terms], refined: frozenset[Terms]
) -> tuple[list[Individual], frozenset[Terms]]:
    out, seen = [], set(refined)
    for terms in sets:
        moved, loss = problem.refine(terms)
        seen |= {terms, moved}
        moved = edit(moved)
        if np.isfinite(loss) and moved:
            out.append(Individual.of(moved, loss))
    return out, frozenset(seen)
