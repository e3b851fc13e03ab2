"""Motion along the surfaces on which laws jump: rates of states that stick there.

See `switching` for the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.models.directions import Directions
from jaxsr.models.field import Field, Point, Row
from jaxsr.models.parts import Part
from jaxsr.models.steps import METHODS
from jaxsr.models.transitions import Taken, transition

Array = Any


@dataclass(frozen=True, eq=False)
class Sliding:
    """States in some modes as the field that methods of integration ask.

    Where modes stick, the rates are those along the surface.

    Attributes
    ----------
    names : tuple of str
        Of the signs in the field.
    slope : ndarray, shape (switches, states)
        Of the surfaces.
    field : Field
    signs, stuck : ndarray, shape (switches, samples, 1)
    """

    names: tuple[str, ...]
    slope: Array
    field: Field
    signs: Array
    stuck: Array

    @property
    def signed(self) -> Field:
        """The field of either side of the surfaces."""
        return self.field.valued(dict(zip(self.names, self.signs, strict=True)))

    def rates(self, at: Point) -> list[Array]:
        """Return rates."""
        return self.slopes_at(at)[0]

    def slopes(self, at: Point) -> tuple[list[Array], list[Row]]:
        """Return rates and their derivatives."""
        return self.slopes_at(at)[:2]

    def slopes_at(self, at: Point) -> tuple[list[Array], list[Row], Array]:
        """Return rates, their derivatives, and the values of the signs with those that stick."""
        rates, rows = self.signed.slopes(at)
        if not self.stuck.any():
            return rates, rows, self.signs
        names, none = self.names, np.zeros(self.stuck.shape[1:])
        by = np.stack(  # (states, switches, samples, 1)
            [np.stack([row.get(name, 0.0) + none for name in names]) for row in rows]
        )
        slope, stuck = self.slope, self.stuck
        matrix = np.einsum("in,nj...->...ij", slope, by)
        held = np.moveaxis(stuck, 0, -1)
        matrix = np.where(held[..., :, None] & held[..., None, :], matrix, 0.0)
        own = np.arange(len(slope))
        matrix[..., own, own] += ~held
        f = np.stack(rates)
        inverse = np.linalg.inv(matrix)

        def moved(value: Array) -> Array:
            """How the signs that stick answer to a change of the rates."""
            pull = np.where(stuck, -np.einsum("in,n...->i...", slope, value), 0.0)
            return np.einsum("...ij,j...->i...", inverse, pull)

        change = moved(f)
        f = f + np.einsum("nj...,j...->n...", by, change)
        projected: list[dict[str, Array]] = [dict(row) for row in rows]
        for name in dict.fromkeys(key for row in rows for key in row):
            column = np.stack([row.get(name, 0.0) + none for row in rows])
            answer = np.einsum("nj...,j...->n...", by, moved(column))
            for row, entry, extra in zip(projected, column, answer, strict=True):
                row[name] = entry + extra
        return list(f), list(projected), self.signs + change


def slid(
    field: Sliding, to: Directions | None, method: str, x: list[Array], parts: Sequence[Part]
) -> tuple[list[list[Array]], Array]:
    """Advance along surfaces by one step: as `followed`."""
    (tableau, step), (part,) = METHODS[method], parts
    ends, rows = step(field, x, part.begin, part.length, part.stages, to is not None)
    if to is None:
        return [x, ends], np.zeros((len(x), 0, *part.length.shape))
    taken = [Taken(part.length, rows, part.stages)]
    return [x, ends], transition(tableau, to, taken, (part.length.shape[0], 1))
