"""Inner products of stored columns, each taken once and shared by all who use the pair."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from jaxsr.regression.gram import Array, GramBatch

Places = NDArray[np.intp]

# Rows multiplied at once: the parts of two columns lie in the cache, and BLAS stays on one core.
ROWS = 4096
_BITS = 19  # of the number of pairs remembered: 8 MiB
_SPREAD = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio (Knuth's hashing)
_HALF = np.uint64(32)
_LOW = np.uint64(2**32 - 1)


def dot(first: Array, second: Array) -> float:
    """Return an inner product whose last bit depends on the two columns alone.

    A product of matrices would be faster for a whole block, but its order of summation depends
    on the block's shape.
    """
    rows = len(first)
    if rows <= ROWS:
        return float(first.dot(second))
    return sum(float(first[k : k + ROWS].dot(second[k : k + ROWS])) for k in range(0, rows, ROWS))


class PairProducts:
    """Remember the products of pairs of places, in a table of fixed size.

    Every pair has one entry of the table where it may be; a newer pair with the same entry takes
    it over, and the older is computed again when it is asked for.

    Parameters
    ----------
    compute : callable
        Places (pairs,) and (pairs,) to products (pairs,).
    """

    def __init__(self, compute: Callable[[Places, Places], Array], bits: int = _BITS) -> None:
        self._compute = compute
        self._shift = np.uint64(64 - bits)
        self._pairs = np.empty(2**bits, dtype=np.uint64)
        self._values = np.empty(2**bits)
        self.computed = 0
        self.forget()

    def forget(self) -> None:
        """Drop everything: places have come to mean other columns."""
        self._pairs.fill(2**64 - 1)

    def of(self, first: Places, second: Places) -> Array:
        """Return the products of pairs of places."""
        low, high = np.minimum(first, second), np.maximum(first, second)
        pairs = (low.astype(np.uint64) << _HALF) | high.astype(np.uint64)
        entries = (pairs * _SPREAD) >> self._shift
        values = self._values[entries]
        missing = np.flatnonzero(self._pairs[entries] != pairs)
        if len(missing):
            new, back = np.unique(pairs[missing], return_inverse=True)
            found = self._compute((new >> _HALF).astype(np.intp), (new & _LOW).astype(np.intp))
            values[missing] = found[back]
            entries = (new * _SPREAD) >> self._shift
            # of pairs that share an entry the last is written to both tables
            self._pairs[entries], self._values[entries] = new, found
            self.computed += len(new)
        return values


def slots_of(places: Sequence[Sequence[int]]) -> Places:
    """Return rows of places, padded by -1 to the longest."""
    counts = np.fromiter(map(len, places), dtype=np.intp, count=len(places))
    slots = np.full((len(places), max(int(counts.max(initial=0)), 1)), -1, dtype=np.intp)
    flat = np.fromiter((k for row in places for k in row), dtype=np.intp, count=int(counts.sum()))
    slots[np.arange(slots.shape[1]) < counts[:, None]] = flat
    return slots


def gathered(products: PairProducts, moments: Array, total: float, slots: Places) -> GramBatch:
    """Return the normal equations of individuals (individuals, terms of each); -1 is no term.

    Parameters
    ----------
    moments : ndarray, (stored columns,)
        Products with the target.
    total : float
        The target's with itself.
    """
    individuals, terms = slots.shape
    used = slots >= 0
    matrix = np.zeros((individuals, terms, terms))
    above, right = np.triu_indices(terms)
    who, pair = np.nonzero(used[:, above] & used[:, right])
    above, right = above[pair], right[pair]
    values = products.of(slots[who, above], slots[who, right])
    matrix[who, above, right] = values
    matrix[who, right, above] = values
    matrix[:, np.arange(terms), np.arange(terms)] += ~used
    moment = np.where(used, moments[slots], 0.0) if len(moments) else np.zeros(slots.shape)
    return GramBatch(matrix, moment, used, total)
