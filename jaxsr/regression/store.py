"""Unit-norm columns of terms, kept between calls, whatever order they were asked for in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array, scale_columns
from jaxsr.regression.products import Places, dot
from jaxsr.regression.ridge import solve_many

# A column that keeps less than this of its norm beside the fixed columns adds only rounding.
DEPENDENT = 1e-9
_TOGETHER = 256
DAMPING = 1e-13  # of corrections: far below the share that independent columns have
CORRECTIONS, SMALL = 8, 0.1  # at most; a gain that needs no further one
_LARGEST, _SMALLEST = 1e100, 1e-100  # sizes whose squares are numbers


class Store(Protocol):
    """Where the columns of terms are, and their products."""

    epoch: int
    """Rises whenever places come to mean other columns."""

    def index(self, terms: Sequence[Term]) -> list[int]:
        """Return the place of each term's column; -1 for a term that cannot be used."""
        ...

    def forget(self) -> None:
        """Drop every column."""
        ...

    def norms(self, places: Sequence[int]) -> Array:
        """Return what the columns were divided by."""
        ...

    def moments(self) -> Array:
        """Return the products of all columns with the target."""
        ...

    def products(self, first: Places, second: Places) -> Array:
        """Return the products of pairs of columns."""
        ...

    def exact_losses(
        self, sets: Sequence[Sequence[int]], shares: Sequence[Array], grams: Sequence[Array]
    ) -> Array:
        """Return residual sums of squares free of the rounding of normal equations.

        ``shares`` solve the normal equations, whose matrices are ``grams``.
        """
        ...


def usable_sizes(largest: Array) -> np.ndarray:
    """Tell which columns can be scaled, from their largest entries (NaN where not finite)."""
    return np.isfinite(largest) & (largest < _LARGEST) & (largest > _SMALLEST)


def largest_of(columns: Array) -> Array:
    """Return the largest size in each column (terms, rows); NaN where it holds one."""
    return np.maximum(np.max(columns, axis=1, initial=0.0), -np.min(columns, axis=1, initial=0.0))


def refined_loss(theta: Array, gram: Array, y: Array, xi: Array) -> float:
    r"""Return the least :math:`\|y - \xi\Theta\|^2`, by iterative refinement from ``xi``.

    Every residual is taken from the columns, so that normal equations serve for corrections only:
    an exact fit is found exact, and no factorisation of long columns is needed.

    Parameters
    ----------
    theta : ndarray, (terms, rows)
        Columns of unit norm.
    gram : ndarray, (terms, terms)
        Their products.
    xi : ndarray, (terms,)
        Solution of the damped normal equations.
    """
    damped = (gram + DAMPING * np.eye(len(xi)))[None]
    least = np.inf
    for _ in range(CORRECTIONS):
        residual = y - xi @ theta
        loss = float(residual.dot(residual))
        if not loss < least:
            break
        least = loss
        slope = theta @ residual
        step = solve_many(damped, slope[None])[0]
        gain = float(slope.dot(step) + DAMPING * step.dot(step))
        if gain < SMALL * loss:  # the loss is a parabola: its least is known without another step
            return loss - gain
        xi = xi + step  # where there is no solution the next residual is NaN
    return least


class ColumnStore:
    """Columns of terms in a view, beside fixed columns, each divided by its norm.

    Every column is computed by itself, so that its last bit does not depend on what was asked
    before or with it: a search that is resumed goes on as if it had not stopped.

    Parameters
    ----------
    columns_of : callable
        Terms to their columns (rows, terms) in the view.
    project : callable or None
        A column (rows,) to what the fixed columns leave of it; None where there are none.
    admits : callable or None
        Whether a term may be used at all; None for all.
    target : ndarray, (rows,)
    capacity : int
        Columns kept; what one call needs is held in any case.
    """

    def __init__(
        self,
        columns_of: Callable[[Sequence[Term]], Array],
        project: Callable[[Array], Array] | None,
        admits: Callable[[Term], bool] | None,
        target: Array,
        capacity: int,
    ) -> None:
        self._columns_of, self._project, self._admits = columns_of, project, admits
        self._target, self._capacity = target, capacity
        self.epoch = 0
        self.forget()

    def forget(self) -> None:
        """Drop every column."""
        self._columns: list[Array] = []
        self._norms: list[float] = []
        self._moments: list[float] = []
        self._moment = np.zeros(0)
        self._index: dict[Term, int] = {}
        self.epoch += 1

    def norms(self, places: Sequence[int]) -> Array:
        """Return what the columns were divided by."""
        return np.array([self._norms[k] for k in places])

    def moments(self) -> Array:
        """Return the products of all columns with the target."""
        if len(self._moment) != len(self._moments):
            self._moment = np.array(self._moments)
        return self._moment

    def products(self, first: Places, second: Places) -> Array:
        """Return the products of pairs of columns."""
        columns = self._columns
        pairs = zip(first.tolist(), second.tolist(), strict=True)
        return np.array([dot(columns[i], columns[j]) for i, j in pairs])

    def exact_losses(
        self, sets: Sequence[Sequence[int]], shares: Sequence[Array], grams: Sequence[Array]
    ) -> Array:
        """Return residual sums of squares, from the residuals themselves."""
        columns = self._columns
        thetas = (np.array([columns[k] for k in places]) for places in sets)
        each = zip(thetas, grams, shares, strict=True)
        return np.array([refined_loss(theta, gram, self._target, xi) for theta, gram, xi in each])

    def index(self, terms: Sequence[Term]) -> list[int]:
        """Return where each term's column is held; -1 for a term that cannot be used."""
        known = self._index
        try:
            return [known[term] for term in terms]
        except KeyError:
            pass
        new = [term for term in dict.fromkeys(terms) if term not in known]
        if len(self._columns) + len(new) > self._capacity:
            self.forget()
            new = list(dict.fromkeys(terms))
        for start in range(0, len(new), _TOGETHER):
            self._add(new[start : start + _TOGETHER])
        return [self._index[term] for term in terms]

    def _add(self, terms: list[Term]) -> None:
        asked = terms
        if self._admits is not None:
            terms = [term for term in terms if self._admits(term)]
        if not terms:
            self._index.update(dict.fromkeys(asked, -1))
            return
        rows = np.ascontiguousarray(self._columns_of(terms).T)
        with np.errstate(all="ignore"):
            usable = usable_sizes(largest_of(rows))
        if not np.all(usable):
            rows = np.where(usable[:, None], rows, 0.0)
        if self._project is not None:
            before = np.linalg.norm(rows, axis=1)
            rows = np.array([self._project(row) for row in rows])
            usable &= np.linalg.norm(rows, axis=1) > DEPENDENT * before
        scaled, norms = scale_columns(rows if np.all(usable) else rows[usable])
        self._index.update(dict.fromkeys(asked, -1))
        places = range(len(self._columns), len(self._columns) + len(scaled))
        kept = (term for term, ok in zip(terms, usable, strict=True) if ok)
        self._index.update(zip(kept, places, strict=True))
        self._columns += list(scaled)
        self._norms += norms.tolist()
        self._moments += [dot(column, self._target) for column in scaled]
