"""Rates that another process computes, as primitives of terms.

Values and slopes of many samples are one request; JAX asks by a callback. Derivatives of
derivatives are central differences.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr.expressions import PRIMITIVES, Term
from jaxsr.expressions.primitives import undefined
from jaxsr.models.native.foreseen import Foreseen
from jaxsr.models.native.process import Native
from jaxsr.models.opaque import OpaquePrimitive

Array = Any
APART = 1e-3
"""Step of a difference of derivatives, relative to the size of what is moved."""
SAME = 1e-6
"""Change of a derivative, relative to its size, below which it does not depend on what moved."""
_NUMBERS = itertools.count()


@dataclass(frozen=True, eq=False)
class Rows:
    """How arguments by name stand in the rows that a process is asked.

    Attributes
    ----------
    native : Native
    names : tuple of str
        Symbol of every column.
    usual : ndarray, shape (columns,)
        What a column holds that no argument says.
    scales : ndarray, shape (columns,)
        Sizes of the columns.
    """

    native: Native
    names: tuple[str, ...]
    usual: np.ndarray
    scales: np.ndarray

    def filled(self, columns: Sequence[int], args: Sequence[Array]) -> np.ndarray:
        """Return rows, shape (samples, columns), in which some columns are given."""
        flat = [np.asarray(a, dtype=float).ravel() for a in args]
        rows = np.tile(self.usual, (flat[0].size if flat else 1, 1))
        for k, values in zip(columns, flat, strict=True):
            rows[:, k] = values
        return rows

    def rates(self, rows: np.ndarray) -> np.ndarray:
        """Return what the simulator says at rows."""
        return self.native.rates(rows)


@dataclass(frozen=True, eq=False)
class Asked:
    """A scalar function of columns: a result of the simulator, or a derivative of one.

    Attributes
    ----------
    name : str
    rows : Rows
    columns : tuple of int
        Those that are arguments, in their order.
    result : int
    by : int, optional
        Column by which the result is differentiated.
    """

    name: str
    rows: Rows
    columns: tuple[int, ...]
    result: int
    by: int | None = None
    foreseen: Foreseen = field(default_factory=Foreseen, repr=False)

    @property
    def arity(self) -> int:
        """Number of arguments."""
        return len(self.columns)

    def term(self) -> Term:
        """Register the primitive, and return it applied to its symbols."""
        self.primitive()
        return Term(self.name, tuple(Term.variable(self.rows.names[k]) for k in self.columns))

    def primitive(self) -> OpaquePrimitive:
        """Register the primitive that stands for the function."""
        meaning = undefined(self.name)
        found = OpaquePrimitive(
            self.name, self.arity, self.values, self.in_jax, meaning, self.name, called=self
        )
        PRIMITIVES[self.name] = found
        return found

    def values(self, *args: Array) -> Array:
        """Return the function at NumPy arrays or numbers."""
        wide = np.broadcast_arrays(*args)
        places = self.foreseen.expected(wide)
        if not places:
            return self._at(wide).reshape(wide[0].shape)
        value, slopes = self._with_slopes(wide, places)
        self.foreseen.keep(slopes)
        return value.reshape(wide[0].shape)

    def slopes(
        self, args: Sequence[Array], wanted: Sequence[bool] | None = None
    ) -> tuple[Array, ...]:
        """Return the derivatives by the arguments, 0 for those that are not wanted."""
        wide = np.broadcast_arrays(*args)
        places = [j for j in range(self.arity) if wanted is None or wanted[j]]
        parts: list[Array] = [0.0] * self.arity
        if not places:
            return tuple(parts)
        found = self.foreseen.known(wide, places)
        if found is None:
            found = self._with_slopes(wide, places)[1]
        for j, column in zip(places, found, strict=True):
            parts[j] = column.reshape(wide[0].shape)
        return tuple(parts)

    def _with_slopes(
        self, args: Sequence[Array], places: Sequence[int]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return values, shape (samples,), and slopes, shape (places, samples), of one request.

        A derivative's own slopes are central differences.
        """
        if self.by is None:
            rows = self.rows.filled(self.columns, args)
            columns = [self.columns[j] for j in places]
            found = self.rows.native.with_slopes(rows, columns)[:, self.result]
            return found[:, 0], found[:, 1:].T
        steps = [APART * self.rows.scales[self.columns[j]] for j in places]
        moves = [(j, side * h) for j, h in zip(places, steps, strict=True) for side in (-1, 1)]
        flat = [np.asarray(a, dtype=float).ravel() for a in args]
        joined = [
            np.concatenate([a, *(a + by if i == j else a for j, by in moves)])
            for i, a in enumerate(flat)
        ]
        ends = self._at(joined).reshape(1 + len(moves), -1)
        return ends[0], (ends[2::2] - ends[1::2]) / (2.0 * np.array(steps)[:, None])

    def derivative(self, position: int) -> str:
        """Register the derivative by an argument, and return its name."""
        name = f"{self.name}_by_{position}"
        if name not in PRIMITIVES:
            if self.by is None:
                Asked(
                    name, self.rows, self.columns, self.result, self.columns[position]
                ).primitive()
            else:
                _Slope(
                    name, self.rows, self.columns, self.result, self.by, place=position
                ).primitive()
        return name

    def gain(self, position: int, names: Sequence[str]) -> Term:
        """Return the derivative by an argument, of those alone that it depends on."""
        column = self.columns[position]
        label = f"{self.name}_by_{names[position]}_{next(_NUMBERS)}"
        whole = Asked(label, self.rows, self.columns, self.result, column)
        rng = np.random.default_rng(0)
        centre = self.rows.usual[list(self.columns)]
        size = self.rows.scales[list(self.columns)]
        at = list((centre + size * rng.uniform(-1.0, 1.0, (8, self.arity))).T)
        own = whole._at(at)
        kept = []
        for place, k in enumerate(self.columns):
            moved = [a + size[place] * 0.3 if j == place else a for j, a in enumerate(at)]
            change = np.abs(whole._at(moved) - own)
            if place != position and np.nanmax(change) > SAME * np.nanmax(np.abs(own)):
                kept.append(k)
        if not kept:
            return Term.constant(float(np.nanmedian(own)))
        return Asked(label, self.rows, tuple(kept), self.result, column).term()

    def in_jax(self, *args: Array) -> Array:
        """Return the function at JAX arrays."""
        wide = jnp.broadcast_arrays(*(jnp.asarray(a, dtype=float) for a in args))
        return self._called(*wide)

    @property
    def _called(self) -> Callable[..., Array]:
        def host(*args: Array) -> np.ndarray:
            return np.asarray(self.values(*(np.asarray(a) for a in args)), dtype=float)

        def host_slopes(*args: Array) -> np.ndarray:
            return np.stack(self.slopes([np.asarray(a) for a in args]), axis=-1)

        @jax.custom_jvp
        def called(*args: Array) -> Array:
            shape = jax.ShapeDtypeStruct(args[0].shape, args[0].dtype)
            return jax.pure_callback(host, shape, *args, vmap_method="broadcast_all")

        @called.defjvp
        def pushed(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
            # A derivative counts as constant where it is differentiated once more: what is
            # integrated implicitly needs it for its steps alone.
            still = [jax.lax.stop_gradient(a) for a in primals]
            shape = jax.ShapeDtypeStruct((*still[0].shape, len(still)), still[0].dtype)
            parts = jax.pure_callback(host_slopes, shape, *still, vmap_method="broadcast_all")
            parts = jax.lax.stop_gradient(parts)
            moved = sum(parts[..., k] * t for k, t in enumerate(tangents))
            return called(*primals), moved

        return called

    def _at(self, args: Sequence[Array]) -> np.ndarray:
        rows = self.rows.filled(self.columns, args)
        if self.by is None:
            return self.rows.rates(rows)[:, self.result]
        return self.rows.native.slopes(rows, (self.by,))[:, self.result, 0]


@dataclass(frozen=True, eq=False)
class _Slope(Asked):
    """The derivative of a derivative by one of its arguments."""

    place: int = 0

    def _at(self, args: Sequence[Array]) -> np.ndarray:
        parent = Asked(self.name, self.rows, self.columns, self.result, self.by)
        return np.asarray(parent.slopes(args)[self.place]).ravel()


def asked(rows: Rows, label: str, result: int, names: Sequence[str]) -> Term:
    """Return a result of a simulator as a term in some of the symbols of its rows."""
    columns = tuple(k for k, name in enumerate(rows.names) if name in names)
    if not columns:
        return Term.constant(float(rows.rates(rows.usual[None])[0, result]))
    return Asked(f"{label}_{next(_NUMBERS)}", rows, columns, result).term()
