"""Unit-norm columns of terms, kept between calls, whatever order they were asked for in."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array, gather_gram, scale_columns
from jaxsr.regression.rank import independent_in_grams

# A column that keeps less than this of its norm beside the fixed columns adds only rounding.
DEPENDENT = 1e-9
_TOGETHER = 256
_DEPENDENT_IN_SET = 1e-6  # share of a unit column; Gram matrices show no less


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
    rows : int
    capacity : int
        Columns kept; what one call needs is held in any case.
    """

    def __init__(
        self,
        columns_of: Callable[[Sequence[Term]], Array],
        project: Callable[[Array], Array] | None,
        admits: Callable[[Term], bool] | None,
        rows: int,
        capacity: int,
    ) -> None:
        self._columns_of, self._project, self._admits = columns_of, project, admits
        self._rows, self._capacity = rows, capacity
        self._forget()

    def _forget(self) -> None:
        self._columns = np.empty((min(1024, self._capacity), self._rows))
        self._norms: list[float] = []
        self._index: dict[Term, int] = {}
        self.terms: list[Term] = []

    @property
    def columns(self) -> Array:
        """Return the columns held (terms, rows)."""
        return self._columns[: len(self.terms)]

    def norms(self, places: Sequence[int]) -> Array:
        """Return what the columns were divided by."""
        return np.array([self._norms[k] for k in places])

    def index(self, terms: Sequence[Term]) -> list[int]:
        """Return where each term's column is held; -1 for a term that cannot be used."""
        new = [term for term in dict.fromkeys(terms) if term not in self._index]
        if len(self.terms) + len(new) > self._capacity:
            self._forget()
            new = list(dict.fromkeys(terms))
        for start in range(0, len(new), _TOGETHER):
            self._add(new[start : start + _TOGETHER])
        return [self._index[term] for term in terms]

    def _add(self, terms: list[Term]) -> None:
        if self._admits is not None:
            admitted = [term for term in terms if self._admits(term)]
            self._index.update(dict.fromkeys(terms, -1))
            terms = admitted
        if not terms:
            return
        viewed = self._columns_of(terms)
        size = np.max(np.abs(viewed), axis=0, initial=0.0)
        usable = np.isfinite(size) & (size < 1e100) & (size > 1e-100)
        rows = np.ascontiguousarray(np.where(usable, viewed, 0.0).T)
        if self._project is not None:
            before = np.linalg.norm(rows, axis=1)
            rows = np.array([self._project(row) for row in rows])
            usable &= np.linalg.norm(rows, axis=1) > DEPENDENT * before
        scaled, norms = scale_columns(rows[usable])
        place = len(self.terms)
        needed = place + len(scaled)
        if needed > len(self._columns):
            grown = np.empty((max(needed, 2 * len(self._columns)), self._rows))
            grown[:place] = self.columns
            self._columns = grown
        self._columns[place:needed] = scaled
        self._norms += norms.tolist()
        for term, ok in zip(terms, usable, strict=True):
            self._index[term] = len(self.terms) if ok else -1
            if ok:
                self.terms.append(term)


def independent_terms(store: ColumnStore, sets: Sequence[Sequence[Term]]) -> list[tuple[Term, ...]]:
    """Return each set of usable terms without those that depend on simpler ones of the set."""
    width = max(map(len, sets), default=1)
    slots = np.full((len(sets), width), -1, dtype=np.intp)
    order = [sorted(range(len(terms)), key=lambda k: terms[k].size) for terms in sets]
    places = iter(store.index([sets[row][k] for row, ks in enumerate(order) for k in ks]))
    for row, ks in enumerate(order):
        slots[row, : len(ks)] = [next(places) for _ in ks]
    gram = gather_gram(store.columns, np.zeros(store.columns.shape[1]), slots)
    kept = independent_in_grams(gram.matrix, _DEPENDENT_IN_SET)
    out = []
    for terms, ks, stays in zip(sets, order, kept, strict=True):
        if np.all(stays[: len(ks)]):
            out.append(tuple(terms))
        else:
            few = {k for k, stay in zip(ks, stays[: len(ks)], strict=True) if stay}
            out.append(tuple(term for k, term in enumerate(terms) if k in few))
    return out
