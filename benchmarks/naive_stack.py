"""The naive population machine: one stack machine, a switch over primitives, vmapped over terms.

Under ``vmap`` the index of the switch is batched, so XLA computes every branch at every node and
selects. It is given only the primitives that the population holds, and padded code is all it pays
beyond that.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from jaxsr.expressions import PRIMITIVES, Term

IDLE, CONSTANT, VARIABLE = 0, 1, 2


class NaiveStack:
    """Postfix code of terms, to be evaluated on float32 data (samples, variables)."""

    def __init__(self, terms: Sequence[Term], variables: Sequence[str]) -> None:
        self.names = tuple(sorted({n.op for term in terms for n in term.walk() if n.args}))
        places = {name: k for k, name in enumerate(variables)}
        opcodes = {name: 3 + k for k, name in enumerate(self.names)}
        shape = (len(terms), max(term.size for term in terms))
        self.opcode, self.place = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
        self.constant = np.zeros(shape, np.float32)
        for row, term in enumerate(terms):
            # parents before children, read backwards: the first argument lies on top
            for slot, node in enumerate(reversed(list(term.walk()))):
                if node.is_constant:
                    self.opcode[row, slot], self.constant[row, slot] = CONSTANT, node.value
                elif node.is_variable:
                    self.opcode[row, slot], self.place[row, slot] = VARIABLE, places[node.name]
                else:
                    self.opcode[row, slot] = opcodes[node.op]

    def evaluate(self, data: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return theta (terms, samples)."""
        columns = np.ascontiguousarray(data.T)
        code = (self.opcode, self.place, self.constant)
        return np.asarray(_machine(self.names)(*code, columns))


@functools.cache
def _machine(names: tuple[str, ...]) -> Any:
    arity = jnp.array([0, 0, 0, *(PRIMITIVES[name].arity for name in names)], jnp.int32)
    branches = [lambda a, b, leaf: leaf] * 3 + [_branch(name) for name in names]

    def run(opcode: jax.Array, place: jax.Array, constant: jax.Array, data: jax.Array) -> Any:
        samples, depth = data.shape[1], opcode.shape[0] // 2 + 1

        def step(carry: tuple[jax.Array, jax.Array], code: Any) -> tuple[Any, None]:
            stack, top = carry
            op, variable, value = code
            leaf = jnp.where(op == CONSTANT, value, data[variable])
            a, b = stack[top - 1], stack[jnp.maximum(top - 2, 0)]
            out = jax.lax.switch(op, branches, a, b, leaf)
            at = top - arity[op]
            idle = op == IDLE
            stack = jnp.where(idle, stack, stack.at[at].set(out))
            return (stack, jnp.where(idle, top, at + 1)), None

        start = (jnp.zeros((depth, samples), data.dtype), jnp.int32(0))
        (stack, _), _ = jax.lax.scan(step, start, (opcode, place, constant))
        return stack[0]

    return jax.jit(jax.vmap(run, in_axes=(0, 0, 0, None)))


def _branch(name: str) -> Any:
    function = PRIMITIVES[name].jax
    if PRIMITIVES[name].arity == 1:
        return lambda a, b, leaf: function(a)
    return lambda a, b, leaf: function(a, b)
