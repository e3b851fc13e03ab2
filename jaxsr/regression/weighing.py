"""Weigh sets of terms by the normal equations of their stored columns."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array, GramBatch
from jaxsr.regression.products import PairProducts, Places, gathered, slots_of
from jaxsr.regression.rank import independent_in_grams
from jaxsr.regression.ridge import solve_ridge
from jaxsr.regression.store import Store
from jaxsr.regression.threshold import HardThreshold

_NORMAL_EQUATIONS = 1e-8  # relative loss below which Gram matrices are too coarse
_ROUNDING = 1e-7  # of products, over the share of a loss that it may change
_REMEMBERED = 50_000  # losses free of the rounding of normal equations
_DEPENDENT_IN_SET = 1e-6  # share of a unit column; Gram matrices show no less


class Weighing:
    """Losses, thresholds and independence of sets of terms, every product taken once.

    Parameters
    ----------
    store : Store
        Unit-norm columns, and a target.
    total : float
        The target's product with itself.
    """

    def __init__(self, store: Store, total: float) -> None:
        self.store, self._total = store, total
        self._products = PairProducts(store.products)
        self._epoch = store.epoch
        self._exact: dict[tuple[Term, ...], float] = {}

    def forget(self) -> None:
        """Drop all columns, products and losses."""
        self.store.forget()
        self._exact.clear()

    def places(self, sets: Sequence[Sequence[Term]]) -> list[list[int]]:
        """Return the places of the terms of each set."""
        flat = self.store.index([term for terms in sets for term in terms])
        ends = np.cumsum([len(terms) for terms in sets], dtype=np.intp).tolist()
        return [flat[end - len(terms) : end] for terms, end in zip(sets, ends, strict=True)]

    def grams(self, slots: Places) -> GramBatch:
        """Return the normal equations of sets of places (sets, terms of each); -1 is no term."""
        if self._epoch != self.store.epoch:
            self._products.forget()
            self._epoch = self.store.epoch
        return gathered(self._products, self.store.moments(), self._total, slots)

    def solve(self, sets: Sequence[Sequence[Term]], ridge: float) -> tuple[GramBatch, Array, Array]:
        """Return normal equations, coefficients of unit-norm columns, and relative losses.

        A loss is inf where a term is unusable.
        """
        places = self.places(sets)
        gram = self.grams(slots_of(places))
        xi = solve_ridge(gram, ridge)
        losses = gram.loss(xi)
        unusable = np.array([-1 in row for row in places], dtype=bool)
        losses = np.where(unusable | ~np.isfinite(losses), np.inf, losses)
        # normal equations lose half the digits: a fit better than that is weighed again
        for row in self._exact_losses(sets, places, gram.matrix, xi, losses):
            losses[row] = self._exact[tuple(sets[row])]
        return gram, xi, losses

    def undamped(self, sets: Sequence[Sequence[Term]]) -> Array:
        """Return relative losses of sets; inf where a term is unusable, NaN where none is told.

        A loss is a difference of numbers as large as the coefficients' squares, and is told where
        those leave it nine digits: not where terms all but depend on each other.
        """
        places = self.places(sets)
        usable = np.array([-1 not in row for row in places], dtype=bool)
        _, xi, losses = self.solve(sets, 0.0)
        with np.errstate(invalid="ignore"):
            told = np.einsum("st,st->s", xi, xi) * _ROUNDING < losses
        told &= np.array([len(row) > 0 for row in places], dtype=bool)
        return np.where(usable, np.where(told, losses, np.nan), np.inf)

    def _exact_losses(
        self,
        sets: Sequence[Sequence[Term]],
        places: Sequence[Sequence[int]],
        gram: Array,
        xi: Array,
        losses: Array,
    ) -> list[int]:
        """Return the rows that need it, their losses having been computed or met before."""
        rows = np.flatnonzero(losses < _NORMAL_EQUATIONS).tolist()
        new = [row for row in rows if tuple(sets[row]) not in self._exact]
        if len(self._exact) + len(new) > _REMEMBERED:
            self._exact.clear()
            new = rows
        if new:
            sizes = [len(places[row]) for row in new]
            shares = [xi[row, :n] for row, n in zip(new, sizes, strict=True)]
            matrices = [gram[row, :n, :n] for row, n in zip(new, sizes, strict=True)]
            own = [places[row] for row in new]
            found = self.store.exact_losses(own, shares, matrices).tolist()
            self._exact.update((tuple(sets[r]), x) for r, x in zip(new, found, strict=True))
        return rows

    def independent(self, sets: Sequence[Sequence[Term]]) -> list[tuple[Term, ...]]:
        """Return each set of usable terms without those that depend on simpler ones of the set."""
        order = [sorted(range(len(t)), key=[x.size for x in t].__getitem__) for t in sets]
        ordered = [[terms[k] for k in ks] for terms, ks in zip(sets, order, strict=True)]
        gram = self.grams(slots_of(self.places(ordered)))
        dependent = ~independent_in_grams(gram.matrix, _DEPENDENT_IN_SET) & gram.used
        out = [tuple(terms) for terms in sets]
        for row in np.flatnonzero(np.any(dependent, axis=1)).tolist():
            left = {k for k, gone in zip(order[row], dependent[row], strict=False) if gone}
            out[row] = tuple(term for k, term in enumerate(out[row]) if k not in left)
        return out

    def prune(
        self, sets: Sequence[Sequence[Term]], threshold: HardThreshold, ridge: float
    ) -> list[tuple[Term, ...]]:
        """Return the terms of each set of usable ones that survive hard thresholding."""
        kept = threshold.keep_many(self.grams(slots_of(self.places(sets))), ridge)
        pairs = zip(sets, kept.tolist(), strict=True)
        return [tuple(t for t, ok in zip(terms, row, strict=False) if ok) for terms, row in pairs]
