r"""Variable projection from products alone: long columns are gone through in pieces.

With Q an orthonormal basis of what does not move, the loss of a set at given constants, and its
derivatives, follow from the products of its moving columns and their slopes, Z, with each other,
with Q and with the target's rest: :math:`Z Z^T - (Z Q^T)(Z Q^T)^T` are the products of what Q
leaves of them. No column is ever held. Normal equations lose half the digits, so a set for which
that shows is marked unsure and left to :mod:`jaxsr.regression.projection`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.evaluation.evaluator import TOGETHER
from jaxsr.evaluation.open import mark
from jaxsr.expressions.postfix import PostfixBatch
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array
from jaxsr.regression.linear import LinearProblem
from jaxsr.regression.marquardt import ROUNDING
from jaxsr.regression.projection import Mask, Places, orthonormal, without
from jaxsr.regression.slopes import constants_of, with_leaves

SURE = 1e-7
"""Share of the target that a loss must keep, times the square of the sine between a column and
the others, for products to tell it to eight digits."""
_SLOPE_SURE = 10.0 * ROUNDING
"""Square of the sine between a slope and the columns, times that of the columns, from which on
products tell it to a hundredth: enough for a step, whose worth the next loss tells."""
_LARGE, _SMALL = 1e190, 1e-190  # squares of columns
_AGAIN = 80_000  # samples of sets that no longer move for which a program is made anew
_FEW = 12  # rows whose products are all taken, though only those of one set are needed
_BYTES = 64 * 2**20


@dataclass(frozen=True, slots=True)
class Still:
    """Orthonormal rows that do not move and, last, the target's rest: (q + 1, rows)."""

    rows: Array
    usable: bool
    total: float


@dataclass(frozen=True, slots=True)
class OpenSet:
    """A set: its still terms, forms of its moving terms, their constants, where they start."""

    still: tuple[Term, ...]
    codes: tuple[PostfixBatch, ...]
    counts: tuple[int, ...]
    start: tuple[float, ...]

    @property
    def rows(self) -> int:
        return sum(self.counts) + len(self.counts)


def opened(problem: LinearProblem, terms: Sequence[Term], most: int) -> OpenSet | None:
    """Return a set with its constants open; None where it has to be gone through otherwise."""
    still: list[Term] = []
    codes: list[PostfixBatch] = []
    start: list[list[float]] = []
    for term in terms:
        values = constants_of(term)
        if not values:
            still.append(term)
            continue
        form = with_leaves(term, map(mark, itertools.count()))
        code = problem.evaluator.opens(form, len(values))
        if code is None:
            return None
        codes.append(code)
        start.append(values)
    counts = tuple(map(len, start))
    if not codes or sum(counts) > most or sum(counts) + len(counts) > TOGETHER:
        return None
    return OpenSet(tuple(still), tuple(codes), counts, tuple(itertools.chain(*start)))


@dataclass(slots=True)
class StreamedPoint:
    """Fits at given constants.

    Attributes
    ----------
    loss : ndarray, (sets,)
    matrix, moment : ndarray, (sets, constants, constants) and (sets, constants)
        :math:`J^T J` and :math:`J^T r` in Kaufman's form.
    unsure : ndarray of bool, (sets,)
        Where rounding of the products may show.
    """

    loss: Array
    matrix: Array
    moment: Array
    unsure: Mask

    def update(self, where: Places, other: StreamedPoint, rows: Places) -> None:
        """Take over ``rows`` of another point at ``where``."""
        for name in ("loss", "matrix", "moment", "unsure"):
            getattr(self, name)[where] = getattr(other, name)[rows]


@dataclass(frozen=True, slots=True)
class _Group:
    """Sets of one pattern beside the same still terms: neighbouring rows of a program."""

    sets: Places
    counts: tuple[int, ...]
    still: int
    span: slice


class StreamedFits:
    """Fits of sets as functions of their constants.

    Parameters
    ----------
    problem : LinearProblem
        Without a view.
    sets : sequence of OpenSet
    stills : sequence of Still
    which : sequence of int
        What stands still in each set.
    """

    def __init__(
        self,
        problem: LinearProblem,
        sets: Sequence[OpenSet],
        stills: Sequence[Any],
        which: Sequence[int],
    ) -> None:
        self._problem, self._sets, self._stills, self._which = problem, sets, stills, which
        most = max(len(s.start) for s in sets)
        self.start = np.zeros((len(sets), most))
        for row, own in enumerate(sets):
            self.start[row, : len(own.start)] = own.start
        self.moves = np.ones(len(sets), dtype=bool)
        self._scheduled: Places = np.zeros(0, dtype=np.intp)
        self._idle = 0  # samples of sets that were gone through for nothing
        self._groups: list[_Group] = []
        self._run: Any = None

    def _schedule(self, rows: Places) -> None:
        """Make a program for some sets, those of one pattern beside the same terms together."""
        keys = {int(k): (self._which[k], self._sets[k].counts) for k in rows}
        order = sorted(keys, key=keys.__getitem__)
        self._groups, at = [], 0
        for (still, counts), members in itertools.groupby(order, keys.__getitem__):
            who = np.array(list(members))
            size = len(who) * (sum(counts) + len(counts))
            self._groups.append(_Group(who, counts, still, slice(at, at + size)))
            at += size
        most = self.start.shape[1]
        codes = [code for k in order for code in self._sets[k].codes]
        first = [
            k * most + place
            for k in order
            for place in itertools.accumulate(self._sets[k].counts[:-1], initial=0)
        ]
        self._run = self._opened(codes, first)
        self._scheduled, self._idle = rows, 0

    def _opened(self, codes: Sequence[PostfixBatch], first: Sequence[int]) -> Any:
        return self._problem.evaluator.opened(codes, first)

    def evaluate(self, constants: Array, rows: Places) -> StreamedPoint:
        """Fit the sets ``rows`` at ``constants`` (rows, constants)."""
        self._problem.check()
        self._idle += (len(self._scheduled) - len(rows)) * self._problem.rows
        # what is wasted pays for the next program: never twice the least that could be paid
        if self._idle > _AGAIN or not np.all(np.isin(rows, self._scheduled)):
            self._schedule(rows)
        every = self.start.copy()
        every[rows] = constants
        products = self._products(every.reshape(-1))
        size, most = self.start.shape
        point = StreamedPoint(
            np.full(size, np.inf),
            np.zeros((size, most, most)),
            np.zeros((size, most)),
            np.zeros(size, dtype=bool),
        )
        alike: dict[tuple[int, ...], list[tuple[Any, ...]]] = {}
        with np.errstate(all="ignore"):
            for group, (gram, beside) in zip(self._groups, products, strict=True):
                still = self._stills[group.still]
                if still.usable:
                    share = beside[:, :, :-1]
                    left = gram - share @ share.transpose(0, 2, 1)
                    square = np.einsum("skk->sk", gram)
                    total = np.full(len(gram), still.total)
                    sets = np.asarray(group.sets)
                    parts = sets, total, square, left, np.asarray(beside[:, :, -1])
                    alike.setdefault(group.counts, []).append(parts)
            for counts, found in alike.items():
                _fit(point, counts, *map(np.concatenate, zip(*found, strict=True)))
        return StreamedPoint(*(getattr(point, n)[rows] for n in StreamedPoint.__slots__))

    def curvature(self, point: StreamedPoint, rows: Places) -> tuple[Array, Array]:
        """Return J^T J (rows, constants, constants) and J^T residual."""
        return point.matrix[rows], point.moment[rows]

    def _products(self, constants: Array) -> list[tuple[Array, Array]]:
        """Return each group's products (sets, k, k), and those with still rows (sets, k, q + 1)."""

        def of(block: Array, part: slice) -> list[tuple[Array, Array]]:
            out = []
            for group in self._groups:
                rows = block[group.span]
                with np.errstate(all="ignore"):
                    beside = rows @ self._stills[group.still].rows[:, part].T
                    out.append((_squares(rows, len(group.sets)), beside))
            return out

        pieces = self._run(constants, of)
        out = []
        for group, parts in zip(self._groups, zip(*pieces, strict=True), strict=True):
            with np.errstate(all="ignore"):
                gram = np.sum([part[0] for part in parts], axis=0)
                beside = np.sum([part[1] for part in parts], axis=0)
            out.append((gram, beside.reshape(len(group.sets), gram.shape[1], -1)))
        return out


def _squares(rows: Array, sets: int) -> Array:
    """Return the products (sets, k, k) of rows (sets k, samples) with those of the same set."""
    count = len(rows) // sets
    if len(rows) > max(_FEW, count):
        own = rows.reshape(sets, count, -1)
        return np.einsum("skr,sjr->skj", own, own)
    every = (rows @ rows.T).reshape(sets, count, sets, count)
    return np.einsum("sksj->skj", every)


def _fit(
    point: StreamedPoint,
    counts: tuple[int, ...],
    sets: Places,
    total: Array,
    square: Array,
    left: Array,
    moment: Array,
) -> None:
    """Write losses and curvature of sets whose moving terms hold so many constants each.

    Parameters
    ----------
    total : ndarray, (sets,)
        Square of the target's rest.
    square : ndarray, (sets, k)
        Squares of each term's column, then its slopes.
    left : ndarray, (sets, k, k)
        Products of what is left of them beside the still terms.
    moment : ndarray, (sets, k)
        Their products with the target's rest.
    """
    columns = np.cumsum([0, *(1 + count for count in counts[:-1])])
    slopes = np.setdiff1d(np.arange(left.shape[1]), columns)
    owner = np.repeat(np.arange(len(columns)), counts)
    norm = np.sqrt(square[:, columns])
    unit = left[:, columns[:, None], columns] / (norm[:, :, None] * norm[:, None, :])
    least, inverse = _inverse(unit)
    b = moment[:, columns] / norm
    xi = np.einsum("sij,sj->si", inverse, b)
    loss = total - np.einsum("si,si->s", b, xi)
    finite = np.all(np.isfinite(square[:, columns]), axis=1)
    sized = np.all((square[:, columns] < _LARGE) & (square[:, columns] > _SMALL), axis=1)
    sure = sized & (loss * least > SURE * total) & (least > 0.0)

    cross = left[:, columns[:, None], slopes] / norm[:, :, None]  # (sets, terms, slopes)
    solved = inverse @ cross
    weight = (xi / norm)[:, owner]
    bent = left[:, slopes[:, None], slopes] - cross.transpose(0, 2, 1) @ solved
    before = square[:, slopes]
    kept = np.einsum("skk->sk", bent) * least[:, None]
    own = kept > ROUNDING * before
    sure &= np.all((kept > _SLOPE_SURE * before) | (~own & (least[:, None] > 0.1)), axis=1)
    own &= weight != 0.0
    weight = np.where(own, weight, 0.0)
    bent = np.where(own[:, :, None] & own[:, None, :], bent, 0.0)
    pull = moment[:, slopes] - np.einsum("sik,si->sk", cross, xi)
    pull = np.where(own, -weight * pull, 0.0)
    # a column that is not finite is no column; whatever else is not, is looked at in full
    sure &= np.all(np.isfinite(bent), axis=(1, 2)) & np.all(np.isfinite(pull), axis=1)
    count = len(slopes)
    point.loss[sets] = np.where(finite, loss, np.inf)
    point.matrix[sets, :count, :count] = weight[:, :, None] * bent * weight[:, None, :]
    point.moment[sets, :count] = pull
    point.unsure[sets] = finite & ~sure


def _inverse(unit: Array) -> tuple[Array, Array]:
    """Return the least pivot of each matrix (sets, n, n), and its inverse; zero without one."""
    count = unit.shape[1]
    factor, least = np.zeros_like(unit), np.full(len(unit), np.inf)
    for j in range(count):
        row = factor[:, j, :j]
        pivot = unit[:, j, j] - np.einsum("sk,sk->s", row, row)
        least = np.fmin(least, np.where(np.isnan(pivot), 0.0, pivot))
        root = np.sqrt(np.where(pivot > 0.0, pivot, 1.0))
        factor[:, j, j] = root
        below = unit[:, j + 1 :, j] - np.einsum("smk,sk->sm", factor[:, j + 1 :, :j], row)
        factor[:, j + 1 :, j] = below / root[:, None]
    inverse = np.zeros_like(unit)
    good = least > 0.0
    if np.any(good):
        lower = np.linalg.inv(factor[good])
        inverse[good] = lower.transpose(0, 2, 1) @ lower
    return np.maximum(least, 0.0), inverse


def fits(
    problem: LinearProblem, sets: Sequence[OpenSet]
) -> Iterator[tuple[list[int], StreamedFits]]:
    """Yield positions in ``sets`` and their fits, those beside the same terms together."""
    order = sorted(range(len(sets)), key=[hash(frozenset(s.still)) for s in sets].__getitem__)
    room = max(1, _BYTES // (8 * problem.rows * 12))
    members: list[int] = []
    stills: dict[tuple[Term, ...], Still] = {}
    rows = 0
    for k in order:
        new = sets[k].still not in stills
        if members and (rows + sets[k].rows > TOGETHER or (new and len(stills) >= room)):
            yield members, _made(problem, sets, members, stills)
            stills = {s: v for s, v in stills.items() if s == sets[k].still}
            members, rows = [], 0
        if sets[k].still not in stills:
            stills[sets[k].still] = _still(problem, sets[k].still)
        members.append(k)
        rows += sets[k].rows
    if members:
        yield members, _made(problem, sets, members, stills)


def _made(
    problem: LinearProblem,
    sets: Sequence[OpenSet],
    members: Sequence[int],
    stills: dict[tuple[Term, ...], Still],
) -> StreamedFits:
    place = {still: k for k, still in enumerate(stills)}
    own = [sets[k] for k in members]
    which = [place[s.still] for s in own]
    return StreamedFits(problem, own, list(stills.values()), which)


def _still(problem: LinearProblem, terms: Sequence[Term]) -> Still:
    """Return an orthonormal basis of the fixed columns and of terms that do not move."""
    problem.check()
    fixed = problem.basis.T
    target = problem.target
    rows = [fixed]
    usable = True
    if terms:
        columns = problem.seen(problem.evaluator.columns(terms)).T[None]
        used = np.ones(columns.shape[:2], dtype=bool)
        basis, _, good = orthonormal(columns, used, np.zeros((1, 0, columns.shape[2])))
        target = without(target[None, None], basis)[0, 0]
        rows.append(basis[0])
        usable = bool(good[0])
    whole = np.concatenate([*rows, target[None]])
    return Still(whole, usable, float(target @ target))
