"""One call for a caller that wants terms: a view, variables, a target, columns that stay."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr._progress import Budget
from jaxsr.evolution.config import SearchConfig
from jaxsr.evolution.loop import SearchInfo, search
from jaxsr.expressions.term import Term
from jaxsr.regression import Rules
from jaxsr.regression.problem import RegressionProblem, View


@dataclass(frozen=True, slots=True)
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

    Returns
    -------
    list of Proposal
        The Pareto front, the shortest description of the data first.
    """
    config = config or SearchConfig()
    rules = Rules(threshold=config.threshold)
    problem = RegressionProblem(y, variables, view=view, fixed=fixed, rules=rules)
    state, _ = search(rng, problem, config, guesses=guesses, budget=budget, progress=progress)
    out = []
    for member in state.front.members:
        fit = problem.fit(member.terms)
        relative = fit.loss * problem.rows / problem.total if problem.total else 0.0
        out.append(
            Proposal(fit.terms, fit.coefficients, fit.fixed, fit.loss, relative, member.size)
        )
    rows = problem.rows
    return sorted(out, key=lambda p: rows * np.log(p.relative_loss + 1e-16) + p.size * np.log(rows))
