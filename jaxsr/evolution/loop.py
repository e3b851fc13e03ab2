"""The search as ``init`` and ``step``: state in, state and info out.

A generation breeds children, weighs them in one batch, thresholds the best set, refines the
constants of the most promising, and updates the Pareto front.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from math import isfinite

import numpy as np

from jaxsr._deadline import OutOfTime, bounded
from jaxsr._progress import Budget, as_budget
from jaxsr._result import StoppedBy
from jaxsr.evolution.breed import breed
from jaxsr.evolution.checkpoint import Keeper
from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.create import random_terms
from jaxsr.evolution.fitness import FitnessState, fitness, next_state
from jaxsr.evolution.front import ROUNDING, Front
from jaxsr.evolution.individual import Individual, Problem, all_usable
from jaxsr.evolution.library import small_terms
from jaxsr.evolution.offers import Offer, with_beam, with_frequencies, with_quotients, with_shapes
from jaxsr.evolution.polish import polish, promising, settled
from jaxsr.evolution.seeds import thinned_bases
from jaxsr.evolution.state import SearchState, Terms
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.term import Term

_SAME = 4.0  # a loss within twice the target's own error, squared, is exact
_SETTLED = 6  # generations that look for a simpler fit once one is exact
_LEAST = 1e-22  # relative losses below this differ by rounding alone


@dataclass(frozen=True, slots=True)
class SearchInfo:
    """What a person or a test asks about one generation, and the population that it leaves."""

    generation: int
    evaluated: int
    unusable: int
    best_loss: float
    best_size: int
    alpha: float
    population: tuple[Individual, ...] = ()


def init(
    rng: np.random.Generator,
    problem: Problem,
    config: SearchConfig,
    guesses: Iterable[Sequence[Term]] = (),
) -> SearchState:
    """Create the first population: small terms, random ones of ramped size, and guesses."""
    config = config.suited(problem.timed)
    sets = [*map(edit, guesses), *thinned_bases(problem, config)]
    return _begun(_drawn(rng, problem, config, sets), problem, config)


def plainest(
    problem: Problem, config: SearchConfig, guesses: Iterable[Sequence[Term]] = ()
) -> SearchState:
    """Return a state of guesses and linear laws, for a search that had no time to begin."""
    config = config.suited(problem.timed)
    linear = [ONE, *map(Term.variable, problem.variables)]
    chain = problem.eliminate(linear, config.sizes.terms)
    sets = [*map(edit, guesses), *(terms for terms, _ in chain)]
    return _begun(weigh(problem, sets, config), problem, config)


def _begun(population: list[Individual], problem: Problem, config: SearchConfig) -> SearchState:
    rule = FitnessState(increment=config.fitness.increment)
    ranked = _ranked(population, rule, config, problem)[: config.population]
    front = Front(floor=max(problem.floor, ROUNDING)).with_(ranked)
    exact, enough = _SAME * problem.floor, _SAME * problem.noise
    described = front.best_description(problem.rows, max(problem.floor, problem.noise, _LEAST))
    return SearchState(
        config, 0, tuple(ranked), front, rule, exact=exact, enough=enough, described=described
    )


def restart(rng: np.random.Generator, state: SearchState, problem: Problem) -> SearchState:
    """Draw a fresh population beside the front, which goes on."""
    described = state.front.best_description(
        problem.rows, max(problem.floor, problem.noise, _LEAST)
    )
    rule = FitnessState(increment=state.config.fitness.increment)
    drawn = _drawn(rng, problem, state.config, [])
    ranked = _ranked([*state.front.members, *drawn], rule, state.config, problem)
    return replace(
        state,
        population=tuple(ranked[: state.config.population]),
        rule=rule,
        idle=0,
        drawn=state.drawn + 1,
        since=state.generation,
        fruitless=0 if described < state.described - 1.0 else state.fruitless + 1,
        described=described,
    )


def _drawn(
    rng: np.random.Generator, problem: Problem, config: SearchConfig, sets: list[Terms]
) -> list[Individual]:
    """Return twice a population: small terms alone and together, and random ones."""
    library = small_terms(list(problem.variables), config.primitives)
    usable = [t for t, k in zip(library, problem.index(library), strict=True) if k >= 0]
    sets = [*sets, *((term,) for term in usable[: config.population // 3])]
    while len(sets) < 2 * config.population:
        count = int(rng.integers(1, min(6, config.sizes.terms) + 1))
        if usable and rng.random() < 0.5:
            picked = rng.integers(len(usable), size=count)
            sets.append(tuple(dict.fromkeys(usable[k] for k in picked)))
        else:
            names, size = list(problem.variables), config.sizes.at_birth
            sets.append(random_terms(rng, names, config.primitives, size, count))
    return weigh(problem, sets, config)


def weigh(problem: Problem, sets: Iterable[Terms], config: SearchConfig) -> list[Individual]:
    """Return usable individuals for the distinct sets among ``sets``, in one batched solve.

    Terms that are not finite on the data, or say on it what simpler ones of their set say, are
    removed from their set, not the set with them.
    """
    sets = [terms for terms in sets if terms]
    flat = [term for terms in sets for term in terms]
    places = problem.index(flat)
    large = config.sizes.later + 4
    usable = iter([k >= 0 and t.size <= large for t, k in zip(flat, places, strict=True)])
    numbers = iter(places)  # of a term's column; they hash faster than terms
    unique: dict[frozenset[int], tuple[Terms, list[int]]] = {}
    for terms in sets:
        marked = [(t, k) for t, k, ok in zip(terms, numbers, usable, strict=False) if ok][
            : config.sizes.terms
        ]
        if marked:
            own = [k for _, k in marked]
            unique.setdefault(frozenset(own), (tuple([t for t, _ in marked]), own))
    if not unique:
        return []
    stays = problem.independent([terms for terms, _ in unique.values()])
    candidates: dict[frozenset[int], Terms] = {}
    for (key, (terms, own)), kept in zip(unique.items(), stays, strict=True):
        if len(kept) < len(terms):
            number = dict(zip(terms, own, strict=True))
            key = frozenset([number[term] for term in kept])
        candidates[key] = kept
    found = list(candidates.values())
    _, losses = problem.solve(found)
    weighed = zip(found, losses.tolist(), strict=True)
    return [Individual.of(terms, loss) for terms, loss in weighed if isfinite(loss)]


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
    thresholded = weigh(problem, problem.prune_many([ind.terms for ind in elite]), config)
    pool = _distinct([*elite, *thresholded, *newborn])
    ranked = _ranked(pool, state.rule, config, problem)
    front = state.front.with_(ranked)
    refined = state.refined
    if config.refined:
        enough = max(state.exact, state.enough)
        offer = Offer(generation, generation - state.since, state.drawn, enough)
        sets = [
            *promising(ranked, front, refined, config.refined, problem.rows),
            *with_frequencies(problem, front, offer, config),
            *with_shapes(problem, front, offer, config),
            *with_quotients(problem, front, offer, config),
            *with_beam(problem, front, offer, config),
        ]
        better, refined = _refine(problem, sets, refined, config.sizes.terms)
        front = front.with_(better)
        _, found, refined = polish(problem, front, config, refined)
        found = list(compress(found, all_usable(problem, [ind.terms for ind in found])))
        front = front.with_(found)
        ranked = _ranked(_distinct([*found, *better, *ranked]), state.rule, config, problem)
    front = front.with_(ranked)
    rule = next_state(state.rule, config.fitness, ranked[: len(elite)], generation, problem)
    floor = max(problem.floor, problem.noise, _LEAST)
    gain = state.front.best_description(problem.rows, floor)
    gain -= front.best_description(problem.rows, floor)
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
    unusable = len(edited) - len(newborn)
    told = best.loss, best.size, rule.alpha, after.population
    return after, SearchInfo(generation, len(edited), unusable, *told)


def stopped(state: SearchState) -> StoppedBy | None:
    """Tell whether the search is over: target reached and settled, patience or generations out."""
    if state.front.best_loss <= max(state.config.target, state.exact) and state.idle >= _SETTLED:
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
    keeper: Keeper | None = None,
) -> tuple[SearchState, StoppedBy]:
    """Run generations until the search is over, the budget (seconds) spent, or interrupted.

    An interrupt returns the best so far, marked as such. A ``keeper`` writes the state every so
    often and when the search ends for any reason; the next search with it goes on from there, and
    ends as if it had never stopped.

    Raises
    ------
    InputError
        The keeper's file is damaged, or of other data or settings.
    """
    limit = as_budget(budget)
    config = config or SearchConfig()
    state = keeper.resume(rng) if keeper is not None else None
    if state is None:
        try:
            with bounded(problem, lambda: limit.exhausted):
                state = init(rng, problem, config, guesses)
        except OutOfTime:
            return plainest(problem, config, guesses), limit.stopped_by

    def kept(state: SearchState) -> SearchState:
        if keeper is not None:
            keeper.keep(state, rng)
        return state

    try:
        kept(state)
        while True:
            reason = stopped(state)
            if reason is not None:
                if not _worth_restarting(state):
                    return state, reason
                with bounded(problem, lambda: limit.exhausted):
                    state = kept(restart(rng, state, problem))
            if limit.exhausted:
                return state, limit.stopped_by
            with bounded(problem, lambda: limit.exhausted):
                state, info = step(rng, state, problem)
            kept(state)
            if progress is not None:
                progress(info)
    except OutOfTime:  # in the middle of a generation, which is left out
        return state, limit.stopped_by
    except KeyboardInterrupt:
        return state, StoppedBy.INTERRUPTED
    finally:
        if keeper is not None:
            keeper.close()


def _worth_restarting(state: SearchState) -> bool:
    """Tell whether something is left to explain and fresh populations may still help."""
    config = state.config
    left = state.front.best_loss > max(config.target, state.exact, state.enough)
    return left and state.generation < config.generations and state.fruitless < config.restarts


def _ranked(
    pool: Sequence[Individual], rule: FitnessState, config: SearchConfig, problem: Problem
) -> list[Individual]:
    order = np.argsort(fitness(pool, rule, config.fitness, problem), kind="stable")
    return [pool[k] for k in order]


def _distinct(individuals: Iterable[Individual]) -> list[Individual]:
    return list({frozenset(ind.terms): ind for ind in individuals}.values())


def _refine(
    problem: Problem, sets: Iterable[Terms], refined: frozenset[Terms], most: int
) -> tuple[list[Individual], frozenset[Terms]]:
    """Refine the sets that are new, of at most so many terms; remember what they became."""
    edited = dict.fromkeys(map(edit, sets))
    fresh = [terms for terms in edited if 0 < len(terms) <= most and terms not in refined]
    moved = settled(problem, problem.refine_many(fresh))
    became = [(edit(terms), loss) for terms, loss in moved]
    whole = [(t, loss) for t, loss in became if 0 < len(t) <= most and np.isfinite(loss)]
    # a constant that came to be 1 can leave a term without a meaning in units
    kept = compress(whole, all_usable(problem, [terms for terms, _ in whole]))
    out = [Individual.of(terms, x) for terms, x in kept]
    return out, refined.union(fresh, (terms for terms, _ in became))
