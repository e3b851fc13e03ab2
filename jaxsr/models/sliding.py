"""Motion along the surfaces on which laws jump: rates of states that stick there.

See `switching` for the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
        if not self.stuck.any():
            return self.signed.rates(at)
        return list(self.motion(at)[0])

    def motion(self, at: Point) -> tuple[Array, Array, Array]:
        """Return rates, their derivatives by the signs, and these with those that stick.

        Returns
        -------
        rates : ndarray, shape (states, ...)
        by_signs : ndarray, shape (states, switches, ...)
        signs : ndarray, shape (switches, ...)
        """
        brief = replace(self, field=self.field.by_signs())
        f, by, change, (_, inverse) = brief._moving(at)
        along = _carried(by, by, self._answer(inverse, by))
        return _carried(f, by, change), along, self.signs + change

    def slopes(self, at: Point) -> tuple[list[Array], list[Row]]:
        """Return rates and their derivatives."""
        if not self.stuck.any():
            return self.signed.slopes(at)
        f, by, change, (rows, inverse) = self._moving(at)
        names = list(dict.fromkeys(k for row in rows for k in row))
        columns = _columns(rows, names, f.shape[1:])
        columns = _carried(columns, by, self._answer(inverse, columns))
        projected = [dict(zip(names, own, strict=True)) for own in columns]
        return list(_carried(f, by, change)), list(projected)

    def _moving(self, at: Point) -> tuple[Array, Array, Array, tuple[list[Row], Array]]:
        """Return rates on the sides of `signs`, and what takes them along the surfaces.

        Returns
        -------
        rates : ndarray, shape (states, ...)
        by_signs : ndarray, shape (states, switches, ...)
        change : ndarray, shape (switches, ...)
            Of the signs that stick.
        (rows, inverse)
            All derivatives of the rates, and the inverse by which signs answer to changes of them.
        """
        rates, rows = self.signed.slopes(at)
        f, by = np.stack(rates), _columns(rows, self.names, self.stuck.shape[1:])
        matrix = np.einsum("in,nj...->...ij", self.slope, by)
        held = np.moveaxis(self.stuck, 0, -1)
        matrix = np.where(held[..., :, None] & held[..., None, :], matrix, 0.0)
        own = np.arange(len(self.slope))
        matrix[..., own, own] += ~held
        inverse = np.linalg.inv(matrix)
        return f, by, self._answer(inverse, f[:, None])[:, 0], (rows, inverse)

    def _answer(self, inverse: Array, values: Array) -> Array:
        """Return how the signs that stick answer to changes of the rates, (switches, changes, ...).

        Parameters
        ----------
        values : ndarray, shape (states, changes, ...)
        """
        pull = -np.einsum("in,nk...->ik...", self.slope, values)
        pull = np.where(self.stuck[:, None], pull, 0.0)
        return np.einsum("...ij,jk...->ik...", inverse, pull)


def _columns(rows: Sequence[Row], names: Sequence[str], shape: tuple[int, ...]) -> Array:
    """Return derivatives of rates by some names, shape (states, names, ...)."""
    found = np.zeros((len(rows), len(names), *shape))
    for own, row in zip(found, rows, strict=True):
        for column, name in zip(own, names, strict=True):
            if name in row:
                column[...] = row[name]
    return found


def _carried(values: Array, by: Array, changes: Array) -> Array:
    """Add to rates, or their changes, what changes of the signs do to them.

    Parameters
    ----------
    values : ndarray, shape (states, ...) or (states, changes, ...)
    by : ndarray, shape (states, switches, ...)
    changes : ndarray, shape (switches, ...) or (switches, changes, ...)
    """
    axes = "nj...,jk...->nk..." if changes.ndim == by.ndim else "nj...,j...->n..."
    return values + np.einsum(axes, by, changes)


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
