"""Evenly spaced rows of a problem, from which an order of merit is read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.evaluation.evaluator import Evaluator, is_pointwise
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array
from jaxsr.regression.linear import LinearProblem
from jaxsr.regression.ridge import least_squares

ROWS = 8192
"""Rows that tell which of some thousand candidates are worth a weighing on all rows: a share of
the residual is told from chance from one in a thousand on."""
_LIMIT_BYTES = 32 * 2**20


class Excerpt:
    """Some of a problem's rows; all of them where it has no more.

    Parameters
    ----------
    problem : LinearProblem
    most : int
        Rows.

    Attributes
    ----------
    rows : ndarray of int
    target : ndarray, (rows,)
        The problem's, without what the fixed columns explain.
    """

    def __init__(self, problem: LinearProblem, most: int = ROWS) -> None:
        self._problem = problem
        self.rows = np.linspace(0, problem.rows - 1, min(problem.rows, most)).astype(int)
        self.target = problem.target[self.rows]
        self._partial = len(self.rows) < problem.rows
        # what a row holds depends on its own sample alone: the others need no evaluation
        self._by_row = self._partial and problem.view is None
        self._evaluator = None
        if self._by_row and not problem.fixed.shape[1]:
            own = {name: values[self.rows] for name, values in problem.variables.items()}
            self._evaluator = Evaluator(own, _LIMIT_BYTES)

    def columns(self, terms: Sequence[Term], *, keep: bool = False) -> Array:
        """Return the viewed columns (terms, rows) without what the fixed columns explain."""
        self._problem.check()
        if self._evaluator is not None and all(map(is_pointwise, terms)):
            return self._evaluator.columns(terms, keep=keep).T
        found = self._problem.projected(terms, keep=keep)
        return found[self.rows].T if self._partial else found.T

    def norms(self, terms: Sequence[Term]) -> tuple[Array, Array, Array]:
        """Return the columns, their norms, and the norms before the fixed columns were taken off.

        What is not finite stays so.
        """
        with np.errstate(all="ignore"):
            found = self.columns(terms)
            own = np.sqrt(np.vecdot(found, found))
            if not self._problem.fixed.shape[1]:
                return found, own, own
            whole = self._problem.columns(terms, keep=False)[self.rows].T
            return found, own, np.sqrt(np.vecdot(whole, whole))

    def seen(self, samples: Array) -> Array:
        """Return columns (samples of :meth:`of`, k) in the view, on these rows (rows, k)."""
        seen = self._problem.seen_in_time(samples)
        return seen if self._by_row or not self._partial else seen[self.rows]

    def of(self, values: Array) -> Array:
        """Return the samples of a variable that :meth:`seen` needs."""
        return values[self.rows] if self._by_row else values

    def residual(self, terms: Sequence[Term]) -> Array:
        """Return the target minus its best fit by ``terms`` on these rows."""
        theta = self.columns(terms).T if terms else np.zeros((len(self.rows), 0))
        xi, _ = least_squares(theta, self.target)
        return self.target - theta @ xi
