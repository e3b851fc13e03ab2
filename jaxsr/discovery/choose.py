"""Choose one set of terms from a front by its error on rows the regression has not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.evaluation import ColumnCache
from jaxsr.expressions.term import Term
from jaxsr.regression import Fit, RegressionProblem

# Relative mean square below which two fits are both exact: a millionth of the target's rms.
_EXACT = 1e-12
_BLOCKS = 20


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fit on training rows, and its mean squares there and on the rows to choose by."""

    fit: Fit
    size: int
    train_mse: float
    validation_mse: float


def predict(
    terms: Sequence[Term], coefficients: np.ndarray, variables: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Return the weighted sum of terms on samples (samples,)."""
    cache = ColumnCache(variables)
    total = np.zeros(len(next(iter(variables.values()))))
    for c, term in zip(coefficients, terms, strict=True):
        total = total + c * cache.column(term)
    return total


def choose(
    problem: RegressionProblem,
    sets: Sequence[Sequence[Term]],
    variables: Mapping[str, np.ndarray],
    y: np.ndarray,
) -> tuple[list[Candidate], int]:
    """Fit every set on ``problem``, judge it on other rows, pick by the one-standard-error rule.

    The pick is the smallest set whose squared errors exceed those of the best one by no more than
    one standard error of the difference, taken over consecutive blocks of rows: neighbours in
    time are not independent, and pairing removes what all candidates share.

    Returns
    -------
    candidates : list of Candidate
        Smallest first.
    pick : int
    """
    candidates, squares = [], []
    for terms in sets:
        fit = problem.fit(terms)
        error = (y - predict(fit.terms, fit.coefficients, variables)) ** 2
        mse = float(np.mean(error)) if np.all(np.isfinite(error)) else np.inf
        size = sum(1 + term.size for term in terms)
        candidates.append(Candidate(fit, size, fit.loss, mse))
        squares.append(error)
    order = sorted(range(len(candidates)), key=lambda k: candidates[k].size)
    candidates, squares = [candidates[k] for k in order], [squares[k] for k in order]
    best = int(np.argmin([c.validation_mse for c in candidates]))
    floor = _EXACT * float(np.mean(y**2))
    for k, candidate in enumerate(candidates):
        if candidate.validation_mse <= max(floor, candidates[best].validation_mse):
            return candidates, k
        if not np.isfinite(candidate.validation_mse):
            continue
        blocks = np.array_split(squares[k] - squares[best], min(_BLOCKS, len(y)))
        means = np.array([np.mean(block) for block in blocks])
        if len(means) > 1 and np.mean(means) <= np.std(means, ddof=1) / np.sqrt(len(means)):
            return candidates, k
    return candidates, best
