"""The best pairs and triples of a dictionary's columns, by beam search over sets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.expressions.printing import kind
from jaxsr.expressions.term import Term
from jaxsr.regression.digits import largest, rounded
from jaxsr.regression.excerpt import Excerpt
from jaxsr.regression.linear import LinearProblem
from jaxsr.regression.store import DEPENDENT

Places = tuple[int, ...]
_ROWS = 600  # rows looked at: evenly spaced ones, an order of merit needs no more
_MOST = 2000  # columns,
_TOGETHER = 256  # and those made at once
_DEPENDENT = 1e-7  # share of a column's square that must be new beside the others
_SPREAD = 20  # pairs ranked for each set kept, so that different forms are among them


def beam(
    problem: LinearProblem, terms: Sequence[Term], width: int, depth: int = 3
) -> list[tuple[Term, ...]]:
    r"""Return sets of two to ``depth`` terms that leave the least, every pair being weighed.

    With unit columns of inner product :math:`g` and shares :math:`b_i = \theta_i^T y`, a pair
    explains :math:`(b_i^2 + b_j^2 - 2 g b_i b_j)/(1 - g^2)` of the target; all pairs are one
    product of matrices. The best of different forms are joined by the best third column, and so
    on. Where two terms explain much only together, a search that adds one at a time misses them.

    Parameters
    ----------
    terms : sequence of Term
        At most 2000 are looked at.
    width : int
        Sets kept of each size.
    """
    some = Excerpt(problem, _ROWS)
    terms = [t for t in terms[:_MOST] if problem.admitted([t])]
    if len(terms) < 2:
        return []
    with np.errstate(all="ignore"):
        parts = [terms[k : k + _TOGETHER] for k in range(0, len(terms), _TOGETHER)]
        found = [some.norms(part) for part in parts]
    columns, norms, whole = map(np.concatenate, zip(*found, strict=True))
    good = (norms > np.maximum(DEPENDENT * whole, 1e-100)) & (norms < 1e100)
    kept = [term for term, ok in zip(terms, good, strict=True) if ok]
    if len(kept) < 2:
        return []
    unit = columns[good] / norms[good, None]
    y = some.target
    y = y / (float(np.linalg.norm(y)) or 1.0)
    kinds = [kind(term) for term in kept]
    out: list[Places] = []
    sets = _different(_pairs(unit, y, width * _SPREAD), kinds, width)
    out += sets
    for _ in range(depth - 2):
        problem.check()
        sets = _different(_joined(unit, y, sets, width * _SPREAD), kinds, width)
        out += sets
    return [tuple(kept[k] for k in places) for places in out]


def _pairs(unit: np.ndarray, y: np.ndarray, count: int) -> list[Places]:
    gram = unit @ unit.T
    b = unit @ y
    left = 1.0 - gram**2
    np.fill_diagonal(left, 0.0)
    told = b[:, None] ** 2 + b[None, :] ** 2 - 2.0 * gram * np.outer(b, b)
    told = np.where(left > _DEPENDENT, told / np.maximum(left, _DEPENDENT), -1.0)
    first, second = np.triu_indices(len(unit), 1)
    values = told[first, second]
    best = largest(values, count)
    return [(int(first[k]), int(second[k])) for k in best if values[k] > 0.0]


def _joined(unit: np.ndarray, y: np.ndarray, sets: list[Places], count: int) -> list[Places]:
    """Return the best sets of one column more."""
    found: list[tuple[float, Places]] = []
    for places in sets:
        basis = np.linalg.qr(unit[list(places)].T)[0]
        shares = basis.T @ y
        gain = unit @ (y - basis @ shares)
        left = 1.0 - np.sum((unit @ basis) ** 2, axis=1)
        gain = np.where(left > _DEPENDENT, gain**2 / np.maximum(left, _DEPENDENT), -1.0)
        before = float(shares @ shares)
        for k in largest(gain, max(4, count // len(sets))):
            if gain[k] > 0.0:
                told = float(rounded(before + gain[k]))
                found.append((-told, tuple(sorted((*places, int(k))))))
    return [places for _, places in sorted(set(found))[:count]]


def _different(sets: list[Places], kinds: Sequence[str], width: int) -> list[Places]:
    """Return the first of every form, constants aside."""
    out: dict[tuple[str, ...], Places] = {}
    for places in sets:
        out.setdefault(tuple(sorted(kinds[k] for k in places)), places)
        if len(out) == width:
            break
    return list(out.values())
