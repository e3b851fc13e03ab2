"""The vmapped postfix stack machine: the reference for faster engines, and differentiable.

Under ``vmap`` the switch over primitives lowers to selects, so every primitive runs at every node.
That is slow and plain; agreement with it is what makes a faster schedule trustworthy.
"""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxsr.evaluation.schedule import numbers_of
from jaxsr.expressions.postfix import (
    CONSTANT,
    NOP,
    OPERATORS,
    PostfixBatch,
    arity_of,
)
from jaxsr.expressions.primitives import PRIMITIVES

# Operators after NOP, constant and variable, with their number of arguments.
_ARITY = np.array([0, 0, 0, *(arity_of(name) for name in OPERATORS)], dtype=np.int32)


def _branches(dtype: Any) -> list[Any]:
    def of(name: str) -> Any:
        function = PRIMITIVES[name].jax
        if arity_of(name) == 1:
            return lambda a, b, leaf: jnp.asarray(function(b), dtype)
        return lambda a, b, leaf: jnp.asarray(function(a, b), dtype)

    leaf = [lambda a, b, leaf: leaf] * 3
    return [*leaf, *(of(name) for name in OPERATORS)]


def run_term(opcode: jax.Array, operand: jax.Array, constants: jax.Array, data: jax.Array) -> Any:
    """Run one term's code (slots,) on data (variables, samples); differentiable in constants."""
    data = jnp.asarray(data)
    samples = data.shape[1]
    depth = opcode.shape[0] // 2 + 2
    branches = _branches(data.dtype)
    arity_table = jnp.asarray(_ARITY)

    def step(carry: tuple[jax.Array, jax.Array], code: Any) -> tuple[Any, None]:
        stack, top = carry  # top: number of values on the stack
        op, place, constant = code
        leaf = jnp.where(op == CONSTANT, jnp.full(samples, constant), data[place])
        a, b = stack[jnp.maximum(top - 2, 0)], stack[jnp.maximum(top - 1, 0)]
        value = jax.lax.switch(op, branches, a, b, leaf)
        position = top - arity_table[op]
        written = stack.at[position].set(value)
        idle = op == NOP
        return (jnp.where(idle, stack, written), jnp.where(idle, top, position + 1)), None

    start = (jnp.ones((depth, samples), data.dtype), jnp.asarray(0, dtype=jnp.int32))
    (stack, _), _ = jax.lax.scan(step, start, (opcode, operand, constants))
    return stack[0]


@functools.cache
def _compiled() -> Any:
    return jax.jit(jax.vmap(run_term, in_axes=(0, 0, 0, None)))


def interpret(batch: PostfixBatch, data: NDArray[np.floating]) -> NDArray[np.floating]:
    """Evaluate a batch on data (samples, variables); return theta (samples, terms).

    float32 data are computed in float32, anything else in float64.
    """
    dtype = np.float32 if data.dtype == np.float32 else np.float64
    columns = np.ascontiguousarray(data.T, dtype=dtype)
    with jax.enable_x64(dtype == np.float64):
        return np.asarray(interpreted(batch, jnp.asarray(columns))).T


def interpreted(
    batch: PostfixBatch, data: jax.Array, constants: NDArray[np.float64] | None = None
) -> jax.Array:
    """Return the columns (terms, samples) of data (variables, samples), in its type.

    The number of terms is padded to a power of two, so one compilation serves every population
    of a bucket. ``constants`` are the values of those that are open.
    """
    terms, slots = batch.opcode.shape
    rows = 16
    while rows < terms:
        rows *= 2
    opcode, operand = np.full((rows, slots), NOP, np.int32), np.zeros((rows, slots), np.int32)
    values = np.zeros((rows, slots), data.dtype)
    opcode[:, 0] = CONSTANT
    opcode[:terms], operand[:terms] = batch.opcode, batch.operand
    own = batch.constants
    if constants is not None:
        numbers = numbers_of(np.ascontiguousarray(own))
        own = np.where(numbers >= 0, constants[np.maximum(numbers, 0)], own)
    values[:terms] = own
    with jax.enable_x64(True):
        if not len(data):
            data = jnp.zeros((1, data.shape[1]), data.dtype)  # terms of constants alone
        return _compiled()(opcode, operand, values, data)[:terms]


def compilations() -> int:
    """Return how many shapes the interpreter has been compiled for in this process."""
    return int(_compiled()._cache_size())
