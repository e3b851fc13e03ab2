"""Rounded jumps inside a step: where one turns over, the step is taken in parts.

A law that jumps within a width far below the change of its argument from sample to sample needs
short steps in the few samples in which it turns over, and nowhere else.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions import Term, evaluate
from jaxsr.models.directions import Directions, Stages, in_a_column
from jaxsr.models.field import Field, Point
from jaxsr.models.following import followed
from jaxsr.models.parts import Part

Array = Any
LOOKED, AHEAD, BETWEEN, EVEN = 16, 1e-3, 8, 0.25
"""Equal parts that tell where a corner lies, share of one after which its begin tells the rate,
places between two levels, and share of parts that is spread evenly."""
NEAR = 8.0
"""Distance from a jump, in its widths, from which its rounding is none: tanh(8) = 1 - 2e-7."""


@dataclass(frozen=True, eq=False)
class Corners:
    """Where laws turn over; asked as `Jumps` are, by `advanced`.

    Attributes
    ----------
    arguments : tuple of (Term, float)
        Of the rounded signs, each with its width.
    parts : int
        Steps that a substep is taken in there.
    method : str
        Of samples that stay in a corner, and by which it is looked for.
    """

    arguments: tuple[tuple[Term, float], ...]
    parts: int
    method: str = "rk4"

    @staticmethod
    def of(
        field: Field, widths: Sequence[float], parts: int, method: str = "rk4"
    ) -> Corners | None:
        """Return the corners of a field; None where steps are not cut, or nothing is rounded."""
        if parts <= 1 or not widths:
            return None
        everywhere = zip(field.simulator.smoothed_arguments, widths, strict=True)
        rounded = tuple((a, w) for a, w in everywhere if w > 0.0)
        return Corners(rounded, parts, method) if rounded else None

    def crossed(self, field: Field, before: Point, after: Point, length: Array) -> Array:
        """Return where a law turns over between two points, shape (1, ...)."""
        near = np.zeros(np.shape(length), dtype=bool)
        for argument, width in self.arguments:
            (a, da), (b, db) = (
                self._with_rate(field, argument, at, length) for at in (before, after)
            )
            near |= (a * b <= 0.0) | (np.minimum(np.abs(a), np.abs(b)) < NEAR * width)
            # Where it has been there and back, or stopped there, it is on its way at either end.
            near |= np.sign(a) * (a + da) < NEAR * width
            near |= np.sign(b) * (b - db) < NEAR * width
        return (near & (length > 0.0))[None]

    def _with_rate(
        self, field: Field, argument: Term, at: Point, length: Array
    ) -> tuple[Array, Array]:
        """Return an argument and its change over a step at the rate that it has."""
        moved = [x + AHEAD * length * f for x, f in zip(at.states, field.rates(at), strict=True)]
        there = Point(at.time, moved, at.inputs)
        here, there = (evaluate(argument, field.environment(p)) for p in (at, there))
        none = np.zeros(np.shape(length))
        return here + none, (there - here) / AHEAD + none

    def through(
        self,
        field: Field,
        to: Directions | None,
        method: str,
        x: list[Array],
        time: Array,
        length: Array,
        stages: Callable[[int], Stages],
    ) -> tuple[list[Array], Array]:
        """Advance by all substeps, each in parts: the arguments and results of `advanced`.

        Samples that stay in a corner may be stiff there: they have a method of their own.
        """
        if method == self.method and self.parts <= LOOKED:  # equal ones, whatever is there
            shares = np.linspace(0.0, 1.0, self.parts + 1).reshape(-1, *(1 for _ in np.shape(x[0])))
            parts = [np.broadcast_to(shares, (len(shares), *np.shape(x[0])))] * length.shape[1]
            return _in_parts(field, to, method, x, time, length, stages, parts)
        staying, shares = self._seen(field, x, time, length, stages)
        if method == self.method:
            return _in_parts(field, to, method, x, time, length, stages, shares)
        ends = [np.array(a) for a in x]
        slopes = np.zeros((len(x), 0 if to is None else to.count, *staying.shape))
        for own, chosen in ((self.method, staying), (method, ~staying)):
            if not chosen.any():
                continue
            place = in_a_column(time, length, stages, chosen)
            begun = [a[chosen][:, None] for a in x]
            parts = [share[:, chosen][..., None] for share in shares]
            after, by = _in_parts(field.column(chosen), to, own, begun, *place, parts)
            for end, part in zip(ends, after, strict=True):
                end[chosen] = part[:, 0]
            slopes[:, :, chosen] = by[..., 0]
        return ends, slopes

    def _seen(
        self,
        field: Field,
        x: list[Array],
        time: Array,
        length: Array,
        stages: Callable[[int], Stages],
    ) -> tuple[Array, list[Array]]:
        """Return which samples stay in a corner, and where parts begin and end.

        They are in it at two neighbouring of `LOOKED` equal parts, or at the end.
        """
        staying, shares = np.zeros(np.shape(x[0]), dtype=bool), []
        for number in range(length.shape[1]):
            heights, x = self._looked(field, x, time, length[:, number], stages(number))
            time = time + length[:, number]
            shares.append(self._shares(heights))
            for own, (_, width) in zip(heights, self.arguments, strict=True):
                near = np.abs(own[0]) < NEAR * width
                staying |= (near[1:] & near[:-1]).any(axis=0) | near[-1]
        return staying, shares

    def _looked(
        self, field: Field, x: list[Array], time: Array, h: Array, stages: Stages
    ) -> tuple[list[tuple[Array, Array]], list[Array]]:
        """Return arguments and their changes at the begin of `LOOKED` equal parts, and the end.

        Their shapes are (`LOOKED` + 1, steps, segments).
        """
        shape, edges = np.shape(x[0]), np.linspace(0.0, 1.0, LOOKED + 1)
        parts = [
            Part(stages, time, h, np.full(shape, first), np.full(shape, last))
            for first, last in itertools.pairwise(edges)
        ]
        along, _ = followed(field, None, self.method, x, parts)
        points = [part.at(own, 0.0) for part, own in zip(parts, along, strict=False)]
        points.append(parts[-1].at(along[-1], 1.0))
        place = _stacked(points), np.array([part.length for part in (*parts, parts[-1])])
        heights = [self._with_rate(field, argument, *place) for argument, _ in self.arguments]
        return heights, along[-1]

    def _shares(self, heights: list[tuple[Array, Array]]) -> Array:
        """Return where the parts of a substep begin and end, shape (parts + 1, ...).

        Few parts are equally long. More are the shorter, the nearer to a corner they are, as
        arguments at the begin of `LOOKED` equal parts tell.
        """
        shape = heights[0][0].shape[1:]
        equal = np.linspace(0.0, 1.0, self.parts + 1).reshape(-1, *(1 for _ in shape))
        if self.parts <= LOOKED:
            return np.broadcast_to(equal, (self.parts + 1, *shape))
        counts = np.diff(np.linspace(0, self.parts, len(self.arguments) + 1).astype(int))
        found = [np.zeros((1, *shape)), np.ones((1, *shape))]
        for (at, ahead), count, (_, width) in zip(heights, counts, self.arguments, strict=True):
            found.append(graded(at, ahead[:-1], width, count + 1)[1:-1])
        joined = np.sort(np.concatenate(found), axis=0)
        missing = self.parts + 1 - len(joined)  # one argument less than there are parts
        return np.concatenate([np.zeros((missing, *shape)), joined]) if missing else joined


def _stacked(points: Sequence[Point]) -> Point:
    """Return several points of all samples as one."""
    states, inputs = (
        [np.array(values) for values in zip(*of, strict=True)]
        for of in ([p.states for p in points], [p.inputs for p in points])
    )
    return Point(np.array([p.time for p in points]), states, inputs)


def _in_parts(
    field: Field,
    to: Directions | None,
    method: str,
    x: list[Array],
    time: Array,
    length: Array,
    stages: Callable[[int], Stages],
    shares: Sequence[Array],
) -> tuple[list[Array], Array]:
    """Advance by all substeps, each from share to share."""
    parts = []
    for number, places in enumerate(shares):
        h, own = length[:, number], stages(number)
        parts += [Part(own, time, h, *ends) for ends in itertools.pairwise(places)]
        time = time + h
    along, slopes = followed(field, to, method, x, parts)
    return along[-1], slopes


def graded(at: Array, ahead: Array, width: float, count: int) -> Array:
    r"""Return shares of a step between which a corner's argument changes about equally.

    Where the argument is a, changes are measured by g = sign(a) log(1 + |a|/w), so that each part
    moves it by a share of its distance from the corner, or of the width w. `EVEN` of the parts are
    spread evenly.

    Parameters
    ----------
    at : ndarray, shape (pieces + 1, ...)
        The argument at the ends of equal pieces of the step.
    ahead : ndarray, shape (pieces, ...)
        Its change over a piece as it begins: what comes before a corner tells where it lies.
    width : float
    count : int
        Shares returned, the first 0 and the last 1.

    Returns
    -------
    ndarray, shape (count, ...)
    """
    pieces, shape = len(at) - 1, at.shape[1:]
    at, ahead = at.reshape(pieces + 1, -1), ahead.reshape(pieces, -1)
    low, high = at[:-1], at[1:]
    with np.errstate(all="ignore"):
        crossing = np.where(low * ahead < 0.0, -low / ahead, low / (low - high))
    through = low * high < 0.0
    share = np.where(through, np.clip(np.nan_to_num(crossing), 0.0, 1.0), 1.0)
    middle = np.where(through, 0.0, high)
    begin = np.arange(pieces)[:, None]
    halves = (low, middle, begin, begin + share), (middle, high, begin + share, begin + 1.0)
    nodes = np.stack([_along_logarithm(*half, width) for half in halves], axis=1)
    places, levels = (nodes[..., k, :].reshape(-1, at.shape[1]) for k in (0, 1))
    moved = np.concatenate([np.zeros((1, at.shape[1])), np.abs(np.diff(levels, axis=0))]).cumsum(0)
    places = np.minimum(np.maximum.accumulate(places, axis=0) / pieces, 1.0)
    total = np.where(moved[-1] > 0.0, moved[-1], 1.0)
    grade = np.where(moved[-1] > 0.0, (1.0 - EVEN) * moved / total + EVEN * places, places)
    lost = ~np.isfinite(grade).all(axis=0)  # what ran away tells nothing
    grade[:, lost] = places[:, lost] = np.linspace(0.0, 1.0, len(grade))[:, None]
    # All samples at once: the grades of one end where those of the next begin.
    apart = 2.0 * np.arange(at.shape[1])[:, None]
    wanted = apart + np.linspace(0.0, 1.0, count)
    found = np.interp(wanted.ravel(), (apart + grade.T).ravel(), places.T.ravel())
    found = found.reshape(-1, count).T
    found[0], found[-1] = 0.0, 1.0
    return found.reshape(count, *shape)


def _along_logarithm(a: Array, b: Array, first: Array, last: Array, width: float) -> Array:
    """Return places and levels along a line from a to b, equal steps of the level apart.

    Shape (pieces, `BETWEEN` + 1, 2, ...); the line does not cross zero.
    """
    low, high = (np.sign(c) * np.log1p(np.abs(c) / width) for c in (a, b))
    share = np.linspace(0.0, 1.0, BETWEEN + 1)[None, :, None]
    level = low[:, None] + share * (high - low)[:, None]
    value = np.sign(level) * width * np.expm1(np.abs(level))
    span = np.where(b == a, 1.0, b - a)[:, None]
    along = np.where((b == a)[:, None], share, (value - a[:, None]) / span)
    return np.stack([first[:, None] + along * (last - first)[:, None], level], axis=2)
