"""Pieces of a step, each with the inputs along it."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxsr.models.directions import Stages
from jaxsr.models.field import Point

Array = Any


class Part:
    """A piece of a step of every sample, from one share of it to another; all of it by default.

    Parameters
    ----------
    whole : Stages
        Inputs along the step.
    time, h : ndarray, shape (steps, segments)
        Its begin and its length.
    first, last : ndarray or float
        Shares.
    """

    def __init__(
        self, whole: Stages, time: Array, h: Array, first: Array = 0.0, last: Array = 1.0
    ) -> None:
        self.whole, self.time, self.h, self.first, self.last = whole, time, h, first, last

    @property
    def begin(self) -> Array:
        """Time at its begin."""
        return self.time + self.first * self.h

    @property
    def length(self) -> Array:
        """Its length."""
        return (self.last - self.first) * self.h

    @functools.cached_property
    def stages(self) -> Stages:
        """Inputs along it."""
        if (
            np.ndim(self.first) == np.ndim(self.last) == 0
            and self.first == 0.0
            and self.last == 1.0
        ):
            return self.whole
        shares = [self.first, 0.5 * (self.first + self.last), self.last]
        values = np.stack([_along(self.whole.values, s) for s in shares])
        rates = self.whole.rates.items()
        return Stages(values, {k: np.stack([_along(rate, s) for s in shares]) for k, rate in rates})

    def upto(self, share: Array) -> Part:
        """Return the beginning of the piece."""
        last = self.first + share * (self.last - self.first)
        return Part(self.whole, self.time, self.h, self.first, last)

    def at(self, x: Sequence[Array], share: Array | float) -> Point:
        """States at a share of the piece, with time and inputs."""
        own = self.first + share * (self.last - self.first)
        return Point(self.time + own * self.h, list(x), list(_along(self.whole.values, own)))

    def column(self, chosen: Array) -> Part:
        """Return the same piece of some of the samples, one below the other."""

        def cut(value: Array) -> Array:
            return value if np.ndim(value) == 0 else value[..., chosen][..., None]

        rates = {k: cut(rate) for k, rate in self.whole.rates.items()}
        whole = Stages(cut(self.whole.values), rates)
        return Part(whole, *map(cut, (self.time, self.h, self.first, self.last)))

    @property
    def input_rates(self) -> list[Array]:
        """Mean rates of the inputs over the step."""
        with np.errstate(all="ignore"):
            change = (self.whole.values[2] - self.whole.values[0]) / self.h
        return list(np.nan_to_num(change, posinf=0.0, neginf=0.0))


def _along(values: Array, share: Array) -> Array:
    """Parabola through values at the start, the middle and the end of a step."""
    if values.size == 0:
        return values[0]
    a, b, c = (1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)
    return a * values[0] + b * values[1] + c * values[2]
