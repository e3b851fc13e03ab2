"""Products of columns too long to be kept: the samples are gone through in pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from jaxsr.evaluation.cache import ColumnCache
from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import BOOLEAN, CONSTANT, VARIABLE, Term
from jaxsr.regression.gram import Array
from jaxsr.regression.products import ROWS, Places
from jaxsr.regression.store import usable_sizes

Evaluator = Callable[[Sequence[Term], Mapping[str, Array]], Array]

_LEAVES = frozenset({CONSTANT, VARIABLE, BOOLEAN})


class StreamedStore:
    r"""Norms and products of terms' columns, no column of which is kept.

    Pieces have a fixed number of rows, and products add up piece by piece, so that a product
    depends on its two columns alone. A piece holds the columns that a call asks for, in groups
    that stay below the limit.

    Parameters
    ----------
    pieces : callable
        Terms and a number of rows to (rows, columns (terms, rows)), as :func:`pieces`.
    admits : callable or None
        Whether a term may be used at all; None for all.
    target : ndarray, (rows,)
    limit_bytes : int
        Memory for the columns of a piece, shared with their subtrees.
    """

    def __init__(
        self,
        pieces: Callable[[Sequence[Term], int], Iterator[tuple[slice, Array]]],
        admits: Callable[[Term], bool] | None,
        target: Array,
        limit_bytes: int,
    ) -> None:
        self._of, self._admits, self._target = pieces, admits, target
        # half for the columns of a piece, the rest for their subtrees
        self._together = max(64, limit_bytes // (16 * ROWS))
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
        largest, square, moment = np.zeros((3, len(terms)))
        with np.errstate(all="ignore"):
            for part, columns in self._pieces(terms):
                largest = np.maximum(largest, np.max(np.abs(columns), axis=1))  # NaN stays
                square += np.vecdot(columns, columns)
                moment += np.vecdot(columns, self._target[part])
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
            for _, columns in self._pieces([self._terms[k] for k in places.tolist()]):
                rows = list(columns)
                pairs = zip(one, other, strict=True)
                out[part] += [rows[i].dot(rows[j]) for i, j in pairs]
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
            for part, raw in self._pieces([self._terms[k] for k in used]):
                unit = raw / norms
                for row in who:
                    theta = unit[[slot[k] for k in sets[row]]]
                    residual = self._target[part] - shares[row] @ theta
                    rss[row] += residual @ residual
                    gains[row] += theta @ residual
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

    def _pieces(self, terms: Sequence[Term]) -> Iterator[tuple[slice, Array]]:
        return self._of(terms, len(self._target))


def pieces(
    terms: Sequence[Term],
    variables: Mapping[str, Array],
    rows: int,
    cache: ColumnCache,
    evaluator: Evaluator | None,
) -> Iterator[tuple[slice, Array]]:
    """Yield rows, and the columns (terms, rows) on them, the same array each time.

    Parameters
    ----------
    cache : ColumnCache
        What evaluates terms that hold integrals: they need all samples, and are held for a pass.
    evaluator : callable or None
        What evaluates the others on the variables of a piece; each unique subtree once when None.
    """
    whole = {k: cache.column(t, keep=False) for k, t in enumerate(terms) if not _pointwise(t)}
    slots = [k for k in range(len(terms)) if k not in whole]
    plain = [terms[k] for k in slots]
    columns = np.empty((len(terms), min(ROWS, rows)))
    for first in range(0, rows, ROWS):
        part = slice(first, min(first + ROWS, rows))
        here = columns[:, : part.stop - first]
        samples = {name: values[part] for name, values in variables.items()}
        if evaluator is not None and plain:
            here[slots] = evaluator(plain, samples).T
        elif plain:
            subtrees = ColumnCache(samples, 8 * ROWS * max(64, len(plain)))
            for slot, term in zip(slots, plain, strict=True):
                here[slot] = subtrees.column(term)
        for slot, column in whole.items():
            here[slot] = column[part]
        yield part, here


def _pointwise(term: Term) -> bool:
    """Tell whether a value depends on the same sample's variables alone."""
    return all(node.op in _LEAVES or PRIMITIVES[node.op].pointwise for node in term.walk())
