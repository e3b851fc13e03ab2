"""Least squares over given columns, and all sets of them: what clever searches answer to."""

from __future__ import annotations

import itertools

import numpy as np

from jaxsr.expressions import Term
from jaxsr.regression import RegressionProblem


def relative_loss(columns: np.ndarray, y: np.ndarray) -> float:
    """Residual sum of squares relative to the target's."""
    scaled = columns / np.linalg.norm(columns, axis=0)
    residual = y - scaled @ np.linalg.lstsq(scaled, y, rcond=None)[0]
    return float(residual @ residual / (y @ y))


def column_problem(columns: np.ndarray, y: np.ndarray) -> tuple[RegressionProblem, list[Term]]:
    """Return a problem whose terms are the columns themselves, each under a name of its own."""
    names = [f"x{k}" for k in range(columns.shape[1])]
    problem = RegressionProblem(y, dict(zip(names, columns.T, strict=True)))
    return problem, [Term.variable(n) for n in names]


def places_of(terms: tuple[Term, ...]) -> tuple[int, ...]:
    return tuple(sorted(int(term.name[1:]) for term in terms))


def best_sets(columns: np.ndarray, y: np.ndarray, size: int) -> list[tuple[int, ...]]:
    """Return all sets of so many columns, the best first."""
    sets = list(itertools.combinations(range(columns.shape[1]), size))
    return sorted(sets, key=lambda s: relative_loss(columns[:, s], y))
