"""Products of columns too long to be kept: the samples are gone through in pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from jaxsr.evaluation.evaluator import PIECE, TOGETHER
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array
from jaxsr.regression.products import Places
from jaxsr.regression.store import largest_of, usable_sizes

Reduced = Callable[[Sequence[Term], Callable[[Array, slice], Any]], list[Any]]


class StreamedStore:
    r"""Norms and products of terms' columns, no column of which is kept.

    Pieces have a fixed number of rows, and products add up piece by piece, so that a product
    depends on its two columns alone. A piece holds the columns that a call asks for, in groups
    that stay below the limit.

    Parameters
    ----------
    reduced : callable
        Terms, and what is to be made of their columns on each piece of the rows, to what was made
        of the pieces; as :meth:`jaxsr.evaluation.Evaluator.reduced`.
    admits : callable or None
        Whether a term may be used at all; None for all.
    target : ndarray, (rows,)
    limit_bytes : int
        Memory for the columns of a piece, shared with their subtrees.
    """

    def __init__(
        self,
        reduced: Reduced,
        admits: Callable[[Term], bool] | None,
        target: Array,
        limit_bytes: int,
    ) -> None:
        self._reduced, self._admits, self._target = reduced, admits, target
        # half for the columns of a piece, the rest for their subtrees
        self._together = min(max(64, limit_bytes // (16 * PIECE)), TOGETHER)
        self.epoch = 0
        self.forget()

    def forget(self) -> None:
        """Drop what is known of every term."""
        self._terms: list[Term] = []
        self._norms: list[float] = []
        self._moments: list[float] = []
        self._index: dict[Term, int] = {}
        self.epoch += 1

    def norms(self, places: Sequence[int]) -> Array:
        """Return what the columns are to be divided by."""
        return np.array([self._norms[k] for k in places])

    def moments(self) -> Array:
        """Return the products of all unit columns with the target."""
        return np.array(self._moments)

    def index(self, terms: Sequence[Term]) -> list[int]:
        """Return the place of each term; -1 for a term that cannot be used."""
        new = [term for term in dict.fromkeys(terms) if term not in self._index]
        if self._admits is not None:
            self._index.update((term, -1) for term in new if not self._admits(term))
            new = [term for term in new if term not in self._index]
        for first in range(0, len(new), self._together):
            self._add(new[first : first + self._together])
        return [self._index[term] for term in terms]

    def _add(self, terms: Sequence[Term]) -> None:
        def sizes(columns: Array, part: slice) -> tuple[Array, Array, Array]:
            with np.errstate(all="ignore"):
                square = np.vecdot(columns, columns)
                largest = np.sqrt(square)  # as good where both lie far inside the limits
                rest = ~((square < 1e190) & (square > 1e-190))
                largest[rest] = largest_of(columns[rest])
                return largest, square, np.vecdot(columns, self._target[part])

        largest, square, moment = np.zeros((3, len(terms)))
        with np.errstate(all="ignore"):
            for most, own, share in self._reduced(terms, sizes):
                largest = np.maximum(largest, most)  # NaN stays
                square += own
                moment += share
            norms = np.sqrt(square)
            usable = usable_sizes(largest)
        for term, ok, norm, share in zip(terms, usable, norms, moment, strict=True):
            self._index[term] = len(self._terms) if ok else -1
            if ok:
                self._terms.append(term)
                self._norms.append(float(norm))
                self._moments.append(float(share / norm))

    def products(self, first: Places, second: Places) -> Array:
        """Return the products of pairs of unit columns."""
        out = np.zeros(len(first))
        for part in self._groups(first, second):
            places, at = np.unique([first[part], second[part]], return_inverse=True)
            one, other = at.reshape(2, -1).tolist()

            def dots(columns: Array, _: slice, one: list = one, other: list = other) -> Array:
                rows = list(columns)
                return np.array([rows[i].dot(rows[j]) for i, j in zip(one, other, strict=True)])

            for own in self._reduced([self._terms[k] for k in places.tolist()], dots):
                out[part] += own
        norms = np.array(self._norms)
        return out / (norms[first] * norms[second])

    def _groups(self, first: Places, second: Places) -> Iterator[Places]:
        """Yield positions of pairs, each time of no more columns than may be held."""
        seen: set[int] = set()
        start = 0
        for place, (i, j) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
            if len(seen | {i, j}) > self._together:
                yield np.arange(start, place)
                seen, start = set(), place
            seen |= {i, j}
        yield np.arange(start, len(first))

    def exact_losses(
        self, sets: Sequence[Sequence[int]], shares: Sequence[Array], grams: Sequence[Array]
    ) -> Array:
        r"""Return residual sums of squares by a correction from the residual itself.

        With residual r of the given coefficients and its products
        :math:`g = \Theta^T r`, the loss is :math:`r^T r - g^T G^+ g`.
        """
        rss = np.zeros(len(sets))
        gains = [np.zeros(len(places)) for places in sets]
        for who in self._sharing(sets):
            used = sorted({k for row in who for k in sets[row]})
            slot = {k: n for n, k in enumerate(used)}
            norms = self.norms(used)[:, None]
            own = [[slot[k] for k in sets[row]] for row in who]

            def left(
                raw: Array, part: slice, who: list = who, own: list = own, norms: Array = norms
            ) -> list[tuple[float, Array]]:
                unit, y, out = raw / norms, self._target[part], []
                for row, places in zip(who, own, strict=True):
                    theta = unit[places]
                    residual = y - shares[row] @ theta
                    out.append((float(residual @ residual), theta @ residual))
                return out

            for answer in self._reduced([self._terms[k] for k in used], left):
                for row, (square, gain) in zip(who, answer, strict=True):
                    rss[row] += square
                    gains[row] += gain
        for row, (gain, gram) in enumerate(zip(gains, grams, strict=True)):
            rss[row] -= gain @ np.linalg.lstsq(gram, gain, rcond=1e-13)[0]
        return np.maximum(rss, 0.0)

    def _sharing(self, sets: Sequence[Sequence[int]]) -> Iterator[list[int]]:
        """Yield positions of sets, each time of no more columns than may be held."""
        seen: set[int] = set()
        who: list[int] = []
        for row, places in enumerate(sets):
            if who and len(seen.union(places)) > self._together // 2:
                yield who
                seen, who = set(), []
            seen |= set(places)
            who.append(row)
        yield who
