r"""Variable projection on a device: columns and slopes stay there, their products come back.

With S the unit columns that do not move, L the Cholesky factor of their products, the orthonormal
basis is :math:`Q = L^{-1} S`, and all that is asked of it are products with the moving columns and
the target, :math:`Z Q^T = (Z S^T) L^{-T}`. So one product of matrices serves all sets of a batch.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from jaxsr.evaluation.evaluator import TOGETHER
from jaxsr.evaluation.resident import padded
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array
from jaxsr.regression.linear import LinearProblem
from jaxsr.regression.projection import Places
from jaxsr.regression.streamed_projection import SURE, OpenSet, StreamedFits, StreamedPoint

_PIVOT = 1e-6
"""Least square of the sine between a still column and the others that products tell well."""


@dataclass(frozen=True, slots=True)
class ResidentStill:
    """Terms that do not move, by their products alone.

    Attributes
    ----------
    places : list of int
        Of their columns in the store.
    inverse : ndarray, (q, q)
        :math:`L^{-1}`.
    share : ndarray, (q,)
        Products of the orthonormal rows with the target.
    usable : bool
    total : float
        Square of the target's rest.
    pivot : float
        Least square of the sine between one of them and those before it.
    """

    places: list[int]
    inverse: Array
    share: Array
    usable: bool
    total: float
    pivot: float = 1.0


@functools.cache
def _reduced() -> Any:
    def products(
        rows: jax.Array, store: jax.Array, places: jax.Array, target: jax.Array
    ) -> tuple[jax.Array, ...]:
        return rows @ rows.T, rows @ store[places].T, rows @ target

    return jax.jit(products)


class ResidentFits(StreamedFits):
    """Fits of sets as functions of their constants, on the device of the problem's columns."""

    def _opened(self, codes: Sequence[Any], first: Sequence[int]) -> Any:
        return self._problem.evaluator.opened_there(codes, first)

    def evaluate(self, constants: Array, rows: Places) -> StreamedPoint:
        """Fit the sets ``rows`` at ``constants`` (rows, constants)."""
        point = super().evaluate(constants, rows)
        stills: list[ResidentStill] = [self._stills[self._which[k]] for k in rows]
        # rounding grows with the dependence among still terms too
        pivot = np.array([still.pivot for still in stills])
        total = np.array([still.total for still in stills])
        point.unsure |= np.isfinite(point.loss) & (point.loss * pivot <= SURE * total)
        return point

    def _products(self, constants: Array) -> list[tuple[Array, Array]]:
        store = self._problem.resident
        assert store is not None
        stills: Sequence[ResidentStill] = self._stills
        used = sorted({k for group in self._groups for k in stills[group.still].places})
        places = np.zeros(padded(len(used), 64), np.int32)
        places[: len(used)] = used
        with jax.enable_x64(True):
            rows = self._run(constants)
            found = _reduced()(rows, store.store, places, store.target)
            gram, beside, moment = map(np.asarray, found)
        slot = {k: n for n, k in enumerate(used)}
        scale = self._problem.scale
        out = []
        for group in self._groups:
            still, sets, span = stills[group.still], len(group.sets), group.span
            count = (span.stop - span.start) // sets
            own = gram[span, span].reshape(sets, count, sets, count)
            with np.errstate(all="ignore"):
                share = beside[span, [slot[k] for k in still.places]] @ still.inverse.T
                rest = moment[span] * scale - share @ still.share
            parts = np.column_stack([share, rest]).reshape(sets, count, -1)
            out.append((np.einsum("sksj->skj", own), parts))
        return out


def resident_fits(
    problem: LinearProblem, sets: Sequence[OpenSet]
) -> Iterator[tuple[list[int], ResidentFits]]:
    """Yield positions in ``sets`` and their fits; sets whose still terms depend are left out."""
    problem.index([term for own in sets for term in own.still])  # places that do not change
    order = sorted(range(len(sets)), key=[hash(frozenset(s.still)) for s in sets].__getitem__)
    members: list[int] = []
    stills: dict[tuple[Term, ...], ResidentStill | None] = {}
    rows = 0

    def made() -> ResidentFits:
        known = {s: still for s, still in stills.items() if still is not None}
        place = {s: k for k, s in enumerate(known)}
        own = [sets[k] for k in members]
        return ResidentFits(problem, own, list(known.values()), [place[s.still] for s in own])

    for k in order:
        if members and rows + sets[k].rows > TOGETHER:
            yield members, made()
            members, rows = [], 0
        if sets[k].still not in stills:
            stills[sets[k].still] = _still(problem, sets[k].still)
        if stills[sets[k].still] is not None:
            members.append(k)
            rows += sets[k].rows
    if members:
        yield members, made()


def _still(problem: LinearProblem, terms: Sequence[Term]) -> ResidentStill | None:
    """Return what the products of terms tell; None where they tell too little."""
    total = problem.total
    if not terms:
        return ResidentStill([], np.zeros((0, 0)), np.zeros(0), True, total)
    matrix, moment, places = problem.products(terms)
    if -1 in places:
        return ResidentStill([], np.zeros((0, 0)), np.zeros(0), False, total)
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return None
    pivot = float(np.min(np.diag(factor))) ** 2
    if pivot < _PIVOT:
        return None
    inverse = np.asarray(np.linalg.inv(factor), np.float64)
    share = inverse @ moment * problem.scale
    return ResidentStill(places, inverse, share, True, total - float(share @ share), pivot)
