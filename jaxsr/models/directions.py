"""What steps are differentiated by, and the inputs along them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.models.field import Row

Array = Any


@dataclass(frozen=True, eq=False)
class Stages:
    """Inputs along a step: at its start, middle and end, and their derivatives by their delays.

    Attributes
    ----------
    values : ndarray, shape (3, inputs, ...)
    rates : mapping
        Position of an input to d(values)/d(delay), shape (3, ...).
    """

    values: Array
    rates: Mapping[int, Array]

    def at(self, share: float) -> list[Array]:
        """Inputs at a share of the step, by the parabola through the three."""
        return list(_parabola(self.values, share))

    def rate(self, number: int, share: float) -> Array:
        """Derivative of an input by its delay."""
        return _parabola(self.rates[number], share)


def _parabola(values: Array, share: float) -> Array:
    if share == 0.0:
        return values[0]
    if share == 1.0:
        return values[2]
    if share == 0.5:
        return values[1]
    a, b, c = (1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)
    return a * values[0] + b * values[1] + c * values[2]


@dataclass(frozen=True, eq=False)
class Directions:
    """What states are differentiated by: every state at the start, then parameters.

    Attributes
    ----------
    states : tuple of str
    columns : mapping
        Parameter to its direction.
    delays : mapping
        Position of an input to the direction of its delay.
    inputs : tuple of str
    """

    states: tuple[str, ...]
    columns: Mapping[str, int]
    delays: Mapping[int, int]
    inputs: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of directions."""
        return len(self.states) + len({*self.columns.values(), *self.delays.values()})

    def by_states(self, row: Row) -> Iterator[tuple[int, Array]]:
        """Yield the derivatives of a rate by the states, with their directions."""
        for j, state in enumerate(self.states):
            if state in row:
                yield j, row[state]

    def by_parameters(self, row: Row, stages: Stages, share: float) -> Iterator[tuple[int, Array]]:
        """Yield the derivatives of a rate by parameters and delays, with their directions."""
        for name, k in self.columns.items():
            if name in row:
                yield k, row[name]
        for number, k in self.delays.items():
            if self.inputs[number] in row:
                yield k, row[self.inputs[number]] * stages.rate(number, share)


def in_a_column(
    time: Array, length: Array, stages: Callable[[int], Stages], chosen: Array
) -> tuple[Array, Array, Callable[[int], Stages]]:
    """Return times, lengths and inputs of some of the samples, one below the other."""

    def cut(number: int) -> Stages:
        own = stages(number)
        rates = {k: rate[:, chosen][..., None] for k, rate in own.rates.items()}
        return Stages(own.values[:, :, chosen][..., None], rates)

    time = np.broadcast_to(time, chosen.shape)[chosen][:, None]
    wide = np.broadcast_to(length, (chosen.shape[0], length.shape[1], chosen.shape[1]))
    return time, np.moveaxis(wide, 1, 2)[chosen][:, :, None], cut
