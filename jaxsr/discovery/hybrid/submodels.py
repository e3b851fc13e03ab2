"""Submodels: one law for the samples of a mode, known terms first, then a new search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._progress import Budget
from jaxsr.discovery.equation import Equation
from jaxsr.discovery.find import EXACT, Task, chosen_of, find_equation
from jaxsr.discovery.hybrid.memory import FunctionMemory, independent_columns
from jaxsr.discovery.rounding import rounded
from jaxsr.discovery.samples import Samples
from jaxsr.evolution import SearchConfig
from jaxsr.expressions.editing import ONE, edit
from jaxsr.expressions.term import Term
from jaxsr.regression import RegressionProblem

_MOST = 40  # terms of the memory that one fit begins with
_LARGEST = 8  # terms of a submodel out of the memory
_FEW = 6  # terms of a submodel out of the memory that makes a search needless
_NEGLIGIBLE = 1e-5  # rms of a term relative to the target's
_NEAR_ROOT = 0.01
_NOISY = 1.5  # mean square over the noise's up to which noise is all that is left


@dataclass(frozen=True)
class Limits:
    """How long a submodel is searched.

    Attributes
    ----------
    generations, restarts : int
        Of one search.
    clusters : int
        Pure clusters searched before all rows are.
    """

    generations: int = 12
    restarts: int = 0
    clusters: int = 3

    def of(self, config: SearchConfig) -> SearchConfig:
        """Return the settings of a short search."""
        return replace(
            config,
            generations=min(config.generations, self.generations),
            restarts=min(config.restarts, self.restarts),
        )


def is_explained(problem: RegressionProblem, loss: float) -> bool:
    """Tell whether a relative loss leaves nothing but noise and the errors of the target."""
    return loss <= max(4.0 * problem.floor, EXACT, _NOISY * problem.noise)


def from_memory(
    task: Task, memory: FunctionMemory, train: Samples, judge: Samples
) -> tuple[Equation, bool]:
    """Return the best submodel out of remembered terms, and whether it explains its samples.

    All remembered terms are fitted together and dropped one by one, the least useful first; the
    sets met on the way have their inner constants refined and are judged on other samples.
    """
    problem = task.problem(train)
    most = max(2, min(_MOST, len(train) // 3))
    terms, _ = independent_columns([ONE, *memory], train.variables, most)
    usable = [t for t, k in zip(terms, problem.index(terms), strict=True) if k >= 0]
    path = [tuple(s) for s, _ in problem.eliminate(usable, _LARGEST)]
    path = [s for s in path if s]
    refined = [s for s, _ in problem.refine_many(path)] if path else []
    equation = best_of(task, [*path, *refined, *_plainer(problem, refined)], train, judge)
    explained = is_explained(problem, relative_loss(problem, equation))
    return equation, explained and len(equation.terms) <= _FEW


def _rank(found: tuple[Equation, bool]) -> tuple[bool, float]:
    """Order submodels: those that explain their samples by terms, others by their error."""
    equation, explained = found
    error = np.inf if equation.validation_mse is None else equation.validation_mse
    return not explained, float(equation.complexity if explained else error)


def _plainer(problem: RegressionProblem, sets: Sequence[Sequence[Term]]) -> list[Sequence[Term]]:
    """Return the sets without their negligible terms, constants refined and rounded again."""
    out: dict[frozenset[Term], Sequence[Term]] = {}
    least = _NEGLIGIBLE * float(np.linalg.norm(problem.y))
    for terms in sets:
        fit = problem.fit(terms)
        if not fit.terms:
            continue
        parts = np.linalg.norm(problem.columns(fit.terms) * fit.coefficients, axis=0)
        kept = [t for t, size in zip(fit.terms, parts, strict=True) if size > least]
        if kept and (len(kept) < len(terms) or fit.loss <= EXACT):
            kept, _ = problem.refine(kept)
            kept = edit(_rooted(t) for t in rounded(problem, kept))
            out.setdefault(frozenset(kept), kept)
    return list(out.values())


def relative_loss(problem: RegressionProblem, equation: Equation) -> float:
    """Return the sum of squares that an equation's terms leave, relative to the target's."""
    if not equation.terms:
        return 1.0
    total = problem.total or 1.0
    return problem.fit([t.term for t in equation.terms]).loss * problem.rows / total


def best_of(task: Task, sets: Sequence[Sequence[Term]], train: Samples, judge: Samples) -> Equation:
    """Return the set of terms that a discovery would choose, estimated on the training rows."""
    problem = task.problem(train)
    distinct = list({frozenset(s): tuple(s) for s in reversed([(), *sets])}.values())
    usable = [s for s in distinct if not s or -1 not in problem.index(s)]
    return chosen_of(task, usable, problem, judge if len(judge) else train, train)


def find_submodel(
    rng: np.random.Generator,
    task: Task,
    memory: FunctionMemory,
    train: Samples,
    judge: Samples,
    pure: Sequence[np.ndarray],
    limits: Limits,
    budget: Budget,
) -> tuple[Equation, bool]:
    """Return the submodel of a region, and whether it explains it (section 5, steps a and b).

    Parameters
    ----------
    rng : Generator
    task : Task
    memory : FunctionMemory
        Offered first; learns from every search.
    train, judge : Samples
        Of the region.
    pure : sequence of ndarray of int
        Clusters inside the region, as rows of ``train``; the most promising first.
    limits : Limits
    budget : Budget
    """
    equation, explained = from_memory(task, memory, train, judge)
    short = replace(task, config=limits.of(task.config), checkpoint=None)
    for rows in pure[: limits.clusters]:
        if explained or budget.exhausted:
            return equation, explained
        part = train.take(rows)
        known = tuple(t.term for t in equation.terms)
        guided = replace(short, guesses=(*task.guesses, known) if known else task.guesses)
        local = find_equation(rng, guided, part, part, part, budget=budget)
        # alone first: beside clutter from other clusters its terms may not be picked out
        own = FunctionMemory()
        states = {n: v for n, v in part.variables.items() if n != task.time}
        own.learn((t.term for t in local.terms), states)
        memory.add(own)
        tried = [from_memory(task, offered, train, judge) for offered in (own, memory)]
        equation, explained = min([(equation, explained), *tried], key=_rank)
    if explained or budget.exhausted:
        return equation, explained
    known = tuple(t.term for t in equation.terms)
    guided = replace(short, guesses=(*task.guesses, known) if known else task.guesses)
    whole = find_equation(rng, guided, train, judge if len(judge) else train, train, budget=budget)
    memory.add(t.term for t in whole.terms)
    sets = [[t.term for t in equation.terms], [t.term for t in whole.terms]]
    sets += [c.fit.terms for e in (equation, whole) for c in e.front]
    problem = task.problem(train)
    equation = best_of(task, [*sets, *_plainer(problem, sets[:2])], train, judge)
    return equation, is_explained(problem, relative_loss(problem, equation))


def _rooted(term: Term) -> Term:
    """Return a term with roots in place of powers next to one half."""
    if not term.args:
        return term
    args = [_rooted(arg) for arg in term.args]
    if term.op == "pow" and args[1].is_constant and abs(args[1].value - 0.5) < _NEAR_ROOT:
        return Term.apply("sqrt", args[0])
    return Term.apply(term.op, *args)
