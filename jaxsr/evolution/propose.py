"""One call for a caller that wants terms: a view, variables, a target, columns that stay."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr._progress import Budget
from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.front import Front
from jaxsr.evolution.individual import Individual
from jaxsr.evolution.loop import SearchInfo, search
from jaxsr.expressions.description import opened
from jaxsr.expressions.term import Term
from jaxsr.regression import Rules
from jaxsr.regression.problem import RegressionProblem, View


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A set of terms found by the search.

    Attributes
    ----------
    terms : tuple of Term
    coefficients : ndarray, (terms,)
    fixed : ndarray
        Coefficients of the columns that stay.
    loss : float
        Mean square of the residual in the view.
    relative_loss : float
        Residual sum of squares over that left by the fixed columns alone.
    size : int
        Nodes plus coefficients.
    """

    terms: tuple[Term, ...]
    coefficients: np.ndarray
    fixed: np.ndarray
    loss: float
    relative_loss: float
    size: int


def propose(
    rng: np.random.Generator,
    y: np.ndarray,
    variables: Mapping[str, np.ndarray],
    *,
    view: View | None = None,
    fixed: np.ndarray | None = None,
    config: SearchConfig | None = None,
    guesses: Sequence[Sequence[Term]] = (),
    budget: float | Budget | None = None,
    progress: Callable[[SearchInfo], None] | None = None,
    near: float = 1.0,
) -> list[Proposal]:
    """Search for terms that explain what the fixed columns do not.

    Parameters
    ----------
    rng : numpy.random.Generator
    y : ndarray, (rows,)
        Target in the view.
    variables : mapping of str to ndarray, (samples,)
    view : callable, optional
        Columns (samples, k) to (rows, k); identity by default.
    fixed : ndarray, (rows, p), optional
        Columns of the known model in the view, re-weighed with every proposal.
    config, guesses, budget, progress
        Settings; sets of terms to start from; seconds; a callback for each generation.
    near : float
        How many times the least loss others may have to be returned as well.

    Returns
    -------
    list of Proposal
        The Pareto front, and of every other form that is `near` its end the best set; the shortest
        description of the data first.
    """
    config = config or SearchConfig()
    rules = Rules(threshold=config.threshold)
    problem = RegressionProblem(y, variables, view=view, fixed=fixed, rules=rules)
    seen: dict[tuple[Term, ...], Individual] = {}

    def tell(info: SearchInfo) -> None:
        if near > 1.0:
            seen.update((ind.terms, ind) for ind in info.population)
        if progress is not None:
            progress(info)

    state, _ = search(rng, problem, config, guesses=guesses, budget=budget, progress=tell)
    out = []
    for member in (*state.front.members, *beside(state.front, seen.values(), near)):
        fit = problem.fit(member.terms)
        relative = fit.loss * problem.rows / problem.total if problem.total else 0.0
        out.append(
            Proposal(fit.terms, fit.coefficients, fit.fixed, fit.loss, relative, member.size)
        )
    rows = problem.rows
    return sorted(out, key=lambda p: rows * np.log(p.relative_loss + 1e-16) + p.size * np.log(rows))


def beside(front: Front, seen: Iterable[Individual], near: float) -> list[Individual]:
    """Return the best individual of every form that a front does not have, if it errs as its end.

    Of one form are sets of terms that differ in constants alone, whole numbers apart.

    Parameters
    ----------
    near : float
        How many times the least loss it may leave.
    """
    most = near * max(front.best_loss, front.floor)
    known, found = {_form(ind) for ind in front.members}, list[Individual]()
    for ind in sorted(seen, key=lambda ind: (ind.loss, ind.size)):
        if ind.loss <= most and (form := _form(ind)) not in known:
            known.add(form)
            found.append(ind)
    return found


def _form(individual: Individual) -> frozenset[Term]:
    return frozenset(map(opened, individual.terms))
