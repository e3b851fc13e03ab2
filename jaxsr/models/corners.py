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
from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field, Point
from jaxsr.models.jumps import Part
from jaxsr.models.steps import METHODS
from jaxsr.models.transitions import Taken, transition

Array = Any
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
    """

    arguments: tuple[tuple[Term, float], ...]
    parts: int

    @staticmethod
    def of(field: Field, widths: Sequence[float], parts: int) -> Corners | None:
        """Return the corners of a field; None where steps are not cut, or nothing is rounded."""
        if parts <= 1 or not widths:
            return None
        everywhere = zip(field.simulator.smoothed_arguments, widths, strict=True)
        rounded = tuple((a, w) for a, w in everywhere if w > 0.0)
        return Corners(rounded, parts) if rounded else None

    def crossed(self, field: Field, before: Point, after: Point, length: Array) -> Array:
        """Return where a law turns over between two points, shape (1, ...)."""
        near = np.zeros(np.shape(length), dtype=bool)
        for argument, width in self.arguments:
            a, b = (evaluate(argument, field.environment(at)) for at in (before, after))
            near |= (a * b <= 0.0) | (np.minimum(np.abs(a), np.abs(b)) < NEAR * width)
        return (near & (length > 0.0))[None]

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
        """Advance by all substeps, each in parts: the arguments and results of `advanced`."""
        shape, taken = np.shape(x[0]), list[Taken]()
        tableau, step = METHODS[method]
        shares = np.linspace(0.0, 1.0, self.parts + 1)
        for number in range(length.shape[1]):
            h, own = length[:, number], stages(number)
            for first, last in itertools.pairwise(shares):
                part = Part(own, time, h, np.full(shape, first), np.full(shape, last))
                x, rows = step(field, x, part.begin, part.length, part.stages, to is not None)
                taken.append(Taken(part.length, rows, part.stages))
            time = time + h
        if to is None:
            return x, np.zeros((len(x), 0, *shape))
        return x, transition(tableau, to, taken, shape)
