"""Choose one set of terms from a front by its error on rows the regression has not seen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.evaluation import ColumnCache
from jaxsr.evolution import complexity
from jaxsr.expressions.primitives import INTEGRALS
from jaxsr.expressions.term import Term
from jaxsr.regression import Fit, RegressionProblem

_SAME = 9.0  # fits within three times the error of the target itself are both exact
_HUGE = 1e3  # size of the terms relative to their sum at which they cancel
_BETWEEN = 10.0  # size of a term between samples over that at samples from which it is unresolved
_BLOCKS = 20
# A tenth of the rms error does not pay for another term: recordings are never quite of the
# class of models searched, and with thousands of samples any term becomes significant.
_WORTH = 1.25
_TIE = 1.02  # one per cent of the rms does not pay for a phase or another inner constant


@dataclass(frozen=True, slots=True)
class Candidate:
    """A fit on training rows, and its mean squares there and on the rows to choose by."""

    fit: Fit
    size: int
    train_mse: float
    validation_mse: float


def predict(
    terms: Sequence[Term],
    coefficients: np.ndarray,
    variables: Mapping[str, np.ndarray],
    *,
    time: str = "t",
    group: np.ndarray | None = None,
) -> np.ndarray:
    """Return the weighted sum of terms on samples (samples,).

    ``time`` and ``group`` (the recording of each sample) are for terms that hold integrals.
    """
    cache = ColumnCache(variables, time=time, group=group)
    total = np.zeros(len(next(iter(variables.values()))))
    for c, term in zip(coefficients, terms, strict=True):
        total = total + c * cache.column(term)
    return total


def resolved(
    terms: Iterable[Term], variables: Mapping[str, np.ndarray], group: np.ndarray, time: str
) -> set[Term]:
    """Return the terms that do between samples what they do at samples.

    A sine whose frequency is a multiple of the sampling rate, or a pole between two samples, can
    fit rows with any coefficient, ``2.7e10*sin(207.7*t)``, and says nothing of the motion. Terms
    are compared at the rows and halfway between neighbours. Integrals are smooth, and kept.
    """
    distinct = set(terms)
    if len(group) < 2:
        return distinct
    near = np.flatnonzero(group[1:] == group[:-1])
    halfway = {n: 0.5 * (v[near] + v[near + 1]) for n, v in variables.items()}
    at = ColumnCache(variables, time=time, group=group)
    between = ColumnCache(halfway, time=time, group=group[near])
    kept = set()
    with np.errstate(all="ignore"):
        for term in distinct:
            if any(node.op in INTEGRALS for node in term.walk()):
                kept.add(term)
                continue
            largest = float(np.max(np.abs(at.column(term)), initial=0.0))
            there = np.max(np.abs(between.column(term)), initial=0.0)
            if not there > _BETWEEN * largest:
                kept.add(term)
    return kept


def choose(
    problem: RegressionProblem, sets: Sequence[Sequence[Term]], judge: RegressionProblem
) -> tuple[list[Candidate], int]:
    """Fit every set on ``problem``, judge it on the rows of ``judge``, pick the least as good.

    As good as the best means: a mean square within a quarter of the best one's, or squared
    errors above its own by no more than one standard error of the difference, taken over
    consecutive blocks of rows: neighbours in time are not independent, and pairing removes what
    all candidates share. The fewest terms come first; between sets of equally many terms the
    smaller wins if it is as good by the standard error, or within 2 %. Fits that leave no more
    than the errors of the target itself are all exact, and one is no better than another; sets
    whose terms cancel each other almost wholly are not considered.

    Returns
    -------
    candidates : list of Candidate
        Smallest first.
    pick : int
    """
    candidates, squares = [], []
    for terms in sets:
        fit = problem.fit(terms)
        seen = judge.columns(terms) @ fit.coefficients if terms else 0.0
        error = (judge.y - seen) ** 2
        error = np.where(np.isfinite(error) & ~_cancel(problem, fit), error, np.inf)
        mse = float(np.mean(error))
        candidates.append(Candidate(fit, complexity(terms), fit.loss, mse))
        squares.append(error)
    order = sorted(range(len(candidates)), key=lambda k: candidates[k].size)
    candidates, squares = [candidates[k] for k in order], [squares[k] for k in order]
    errors = np.array([c.validation_mse for c in candidates])
    terms = np.array([len(c.fit.terms) for c in candidates])
    exact = _SAME * judge.floor * float(np.mean(judge.y**2))
    good = _as_good(squares, errors, exact) | (errors <= _WORTH * np.min(errors))
    fewest = terms == np.min(terms[good])
    # among sets of that many terms size decides only where the errors do not
    rivals = np.flatnonzero(fewest)
    tied = _as_good([squares[k] for k in rivals], errors[rivals], exact)
    tied |= errors[rivals] <= _TIE * np.min(errors[rivals])
    return candidates, int(rivals[np.argmax(tied)])


def _cancel(problem: RegressionProblem, fit: Fit) -> bool:
    """Tell whether the terms are huge beside their sum: a difference quotient, not a law."""
    if not fit.terms:
        return False
    parts = problem.columns(fit.terms) * fit.coefficients
    with np.errstate(over="ignore"):
        return bool(np.sum(parts**2) > _HUGE**2 * float(problem.y @ problem.y))


def _as_good(squares: Sequence[np.ndarray], errors: np.ndarray, exact: float) -> np.ndarray:
    """Tell which sets err no more than the best, within one standard error of the difference."""
    best = int(np.argmin(errors))
    good = errors <= max(exact, errors[best])
    if errors[best] <= exact:
        return good
    for k in np.flatnonzero(np.isfinite(errors) & ~good).tolist():
        parts = np.array_split(squares[k] - squares[best], min(_BLOCKS, len(squares[k])))
        means = np.array([np.mean(part) for part in parts])
        error = np.std(means, ddof=1) / np.sqrt(len(means)) if len(means) > 1 else 0.0
        good[k] = np.mean(means) <= error
    return good
