"""Components of a Python vector field that are no terms: primitives that call it.

A component is evaluated and differentiated by JAX, compiled for a power of two of samples, so
that arrays of many sizes share few programs.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxsr.expressions import PRIMITIVES, Primitive, Term
from jaxsr.expressions.primitives import undefined

Array = Any
LEAST = 8
"""Samples of the smallest program."""
_NUMBERS = itertools.count()


class Opaque(Protocol):
    """A scalar function of `arity` scalars that is no formula, with its derivatives."""

    @property
    def name(self) -> str:
        """Of its primitive."""
        ...

    def slopes(
        self, args: Sequence[Array], wanted: Sequence[bool] | None = None
    ) -> tuple[Array, ...]:
        """Return the derivatives by every argument, anything for those that are not wanted."""
        ...

    def derivative(self, position: int) -> str:
        """Register the derivative by an argument, and return its name."""
        ...

    def gain(self, position: int, names: Sequence[str]) -> Term:
        """Return the derivative by an argument where that is zero; `names` are those of all."""
        ...


@dataclass(frozen=True)
class OpaquePrimitive(Primitive):
    """A scalar JAX function of scalars as a primitive, with its derivatives."""

    called: Opaque | None = None

    def partial(self, position: int) -> str:
        """Return the name of the primitive that is the derivative by an argument."""
        assert self.called is not None
        return self.called.derivative(position)

    def partials(self, args: Sequence[Array], wanted: Sequence[bool]) -> tuple[Array, ...]:
        """Return the derivatives by the arguments, anything for those that are not wanted."""
        assert self.called is not None
        return self.called.slopes(args, wanted)


@dataclass(frozen=True, eq=False)
class Called:
    """A scalar JAX function of `arity` scalars, evaluated for many samples at once."""

    name: str
    function: Callable[..., Any]
    arity: int

    def primitive(self) -> Primitive:
        """Register the primitive that stands for the function."""
        found = OpaquePrimitive(
            self.name,
            self.arity,
            self.values,
            self.in_jax,
            undefined(self.name),
            self.name,
            called=self,
        )
        PRIMITIVES[self.name] = found
        return found

    def values(self, *args: Array) -> Array:
        """Return the function at NumPy arrays or numbers."""
        return self._many(self._compiled, args)

    def slopes(
        self, args: Sequence[Array], wanted: Sequence[bool] | None = None
    ) -> tuple[Array, ...]:
        """Return the derivatives by every argument: together they cost hardly more than one."""
        found = self._many(self._differentiated, args)
        return tuple(np.moveaxis(found, -1, 0))

    def in_jax(self, *args: Array) -> Array:
        """Return the function at JAX arrays."""
        wide = jnp.broadcast_arrays(*(jnp.asarray(a, dtype=float) for a in args))
        flat = [a.reshape(-1) for a in wide]
        return jax.vmap(self.function)(*flat).reshape(wide[0].shape)

    def derivative(self, position: int) -> str:
        """Register the derivative by an argument, and return its name."""
        if position not in self._derivatives:
            by = jax.jacfwd(self.function, argnums=position)
            name = f"{self.name}_by_{position}"
            self._derivatives[position] = Called(name, by, self.arity)
            self._derivatives[position].primitive()
        return self._derivatives[position].name

    def gain(self, position: int, names: Sequence[str]) -> Term:
        """Return the derivative by an argument where that is zero; `names` are those of all."""
        others = [n for k, n in enumerate(names) if k != position]

        def at_zero(*values: Array) -> Array:
            zero = jnp.zeros_like(values[0] if values else 0.0)
            every = [*values[:position], zero, *values[position:]]
            return jax.jacfwd(self.function, argnums=position)(*every)

        if not others:
            return Term.constant(float(self.slopes([np.zeros(1)])[0][0]))
        return opaque(f"{self.name}_by_{names[position]}", at_zero, others)

    @cached_property
    def _derivatives(self) -> dict[int, Called]:
        return {}

    @cached_property
    def _compiled(self) -> Callable[..., Any]:
        return jax.jit(jax.vmap(self.function))

    @cached_property
    def _differentiated(self) -> Callable[..., Any]:
        every = jax.jacfwd(self.function, argnums=tuple(range(self.arity)))
        return jax.jit(jax.vmap(lambda *a: jnp.stack(every(*a))))

    def _many(self, compiled: Callable[..., Any], args: Sequence[Array]) -> Array:
        """Evaluate at the samples, the last one repeated up to a power of two."""
        wide = np.broadcast_arrays(*args)
        shape, count = wide[0].shape, max(wide[0].size, 1)
        size = max(LEAST, 1 << (count - 1).bit_length())
        padded = [
            np.concatenate([flat, np.full(size - flat.size, flat[-1] if flat.size else 0.0)])
            for flat in (np.asarray(a, dtype=float).ravel() for a in wide)
        ]
        with jax.enable_x64(True):
            found = np.asarray(compiled(*padded))
        return found[: wide[0].size].reshape((*shape, *found.shape[1:]))


def opaque(label: str, function: Callable[..., Any], variables: Sequence[str]) -> Term:
    """Return a term that calls a scalar JAX function of the variables' values, in their order."""
    called = Called(f"{label}_{next(_NUMBERS)}", function, len(variables))
    called.primitive()
    return Term(called.name, tuple(Term.variable(v) for v in variables))
