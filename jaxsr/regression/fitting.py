"""Weigh one set of terms: least squares, signs, or a penalty that selects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions.term import Term
from jaxsr.regression.elastic_net import ElasticNetRule, Penalty, selected
from jaxsr.regression.gram import Array
from jaxsr.regression.linear import LinearProblem
from jaxsr.regression.ridge import least_squares
from jaxsr.regression.signs import Signs, checked_signs, signed_least_squares, signs_of, wrong


@dataclass(frozen=True, slots=True)
class Fit:
    """Coefficients of one set of terms.

    Attributes
    ----------
    terms : tuple of Term
    coefficients : ndarray, (terms,)
        In the units of the columns as given.
    fixed : ndarray, (fixed columns,)
        Coefficients of the columns that are always included.
    loss : float
        Mean square of the residual in the view, in the unit of ``y`` squared.
    """

    terms: tuple[Term, ...]
    coefficients: Array
    fixed: Array
    loss: float


def fit_terms(
    problem: LinearProblem,
    terms: Sequence[Term],
    *,
    signs: Signs | None = None,
    penalty: Penalty = "ridge",
    rule: ElasticNetRule | None = None,
) -> Fit:
    """Solve one set of terms, fixed columns included.

    Parameters
    ----------
    signs : mapping of Term to int, optional
        Terms whose coefficients must not be negative (1) or not be positive (-1); they replace
        the problem's.
    penalty : str
        "ridge" (least squares by QR: a set of few terms needs no damping), "lasso" or
        "elastic_net", which leave terms out: their coefficients are zero. Signs hold for the
        first, and for the estimate of what the others selected.
    rule : ElasticNetRule, optional
        Strength of the latter two.

    Raises
    ------
    InputError
        The penalty is unknown.
    """
    if penalty not in ("ridge", "lasso", "elastic_net"):
        raise InputError(
            f"unknown penalty {penalty!r}", "fit", "Use 'ridge', 'lasso' or 'elastic_net'."
        )
    theta = problem.projected(terms)
    sign = signs_of(terms, problem.signs if signs is None else checked_signs(signs))
    rule = rule or ElasticNetRule()
    if penalty == "ridge" or not len(terms):
        xi, rss = least_squares(theta, problem.target)
        kept = np.ones(len(terms), dtype=bool)
    else:
        rule = replace(rule, mix=1.0) if penalty == "lasso" else rule
        xi = selected(theta, problem.target, rule)
        residual = problem.target - theta @ xi
        rss, kept = float(residual @ residual), xi != 0.0
    if wrong(xi, sign):
        xi = xi * 0.0
        xi[kept], rss = signed_least_squares(theta[:, kept], problem.target, sign[kept])
    rest = problem.y - (problem.columns(terms) @ xi if len(terms) else 0.0)
    beta, _ = least_squares(problem.fixed, rest)
    return Fit(tuple(terms), xi, beta, rss / problem.rows)
