"""Losses on rows that the coefficients have not seen (paper section 4.2.2, few data)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from jaxsr._result import InputError
from jaxsr.evaluation.evaluator import Evaluator
from jaxsr.expressions.term import Term
from jaxsr.regression.fitting import fit_terms
from jaxsr.regression.gram import Array
from jaxsr.regression.linear import LinearProblem, View

_LIMIT_BYTES = 32 * 2**20


@dataclass(frozen=True, eq=False)
class Judge:
    """Rows to judge by.

    Attributes
    ----------
    variables : mapping of str to ndarray, (samples,)
    y : ndarray, (rows,)
        Target in the view.
    view : callable, optional
        As the problem's, for these samples.
    fixed : ndarray, (rows, p), optional
        The problem's fixed columns on these rows.
    group, instants : ndarray, (samples,), optional
        As the problem's, for these samples.
    """

    variables: Mapping[str, Array]
    y: Array
    view: View | None = None
    fixed: Array | None = None
    group: NDArray[np.intp] | None = None
    instants: Array | None = None
    _columns: dict[Term, Array] = field(default_factory=dict, init=False, repr=False)
    _evaluators: dict[str, Evaluator] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        y = np.asarray(self.y, dtype=np.float64)
        if y.ndim != 1 or not len(y) or not np.all(np.isfinite(y)):
            raise InputError("y must be a non-empty vector of finite values", "Judge.y")
        object.__setattr__(self, "y", y)
        lengths = {len(v) for v in self.variables.values()}
        if len(lengths) > 1 or (self.view is None and lengths not in (set(), {len(y)})):
            raise InputError(f"variables have {sorted(lengths)} samples, y {len(y)}", "Judge")

    @property
    def rows(self) -> int:
        """Number of rows judged by."""
        return len(self.y)

    def losses(self, problem: LinearProblem, sets: Sequence[Sequence[Term]]) -> Array:
        """Return each set's residual sum of squares here relative to the target's.

        Coefficients are those of ``problem``; inf where a term is not finite on either rows.
        """
        total = float(self.y @ self.y) or 1.0
        self._add([term for terms in sets for term in terms], problem.time)
        # losses are not kept: what they are must not depend on what was asked before
        weights, fitted = problem.solve(sets) if len(sets) else ([], np.zeros(0))
        out = np.full(len(sets), np.inf)
        with np.errstate(all="ignore"):
            for k in np.flatnonzero(np.isfinite(fitted)).tolist():
                left = self._residual(problem, tuple(sets[k]), weights[k])
                out[k] = float(left @ left) / total
        return np.where(np.isfinite(out), out, np.inf)

    def _residual(self, problem: LinearProblem, terms: tuple[Term, ...], shares: Array) -> Array:
        columns = [self._columns[term] for term in terms]
        if self.fixed is None:
            xi = problem.in_units(terms, shares)
            return self.y - sum((c * column for c, column in zip(xi, columns, strict=True)), 0.0)
        fit = fit_terms(problem, terms)
        rest = self.y - self.fixed @ fit.fixed
        return rest - sum(c * column for c, column in zip(fit.coefficients, columns, strict=True))

    def _add(self, terms: Sequence[Term], time: str) -> None:
        fresh = [term for term in dict.fromkeys(terms) if term not in self._columns]
        if not fresh:
            return
        if len(self._columns) + len(fresh) > max(2000, 2**24 // self.rows):
            self._columns.clear()
            fresh = list(dict.fromkeys(terms))
        when = time if self.instants is None else self.instants
        if time not in self._evaluators:
            own = Evaluator(self.variables, _LIMIT_BYTES, time=when, group=self.group)
            self._evaluators[time] = own
        samples = self._evaluators[time].columns(fresh, keep=False)
        if self.view is not None:
            finite = np.all(np.isfinite(samples), axis=0)
            with np.errstate(over="ignore", invalid="ignore"):
                seen = self.view(np.where(finite, samples, 0.0))
            samples = np.where(finite, seen, np.nan)
        self._columns.update(zip(fresh, samples.T.copy(), strict=True))
