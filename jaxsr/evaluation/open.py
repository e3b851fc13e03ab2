"""Terms whose inner constants are open: values and slopes as functions of them, in one program.

A form, a term with its constants left open, is written out with its derivatives once. A batch of
terms is assembled from the arrays of their forms, its constants numbered; the program made of it
serves every value of the constants.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from jaxsr.evaluation.engine import Engine, EngineConfig
from jaxsr.evaluation.schedule import BOX
from jaxsr.expressions.derivatives import derivative
from jaxsr.expressions.postfix import (
    CONSTANT,
    OPERATORS,
    VARIABLE,
    PostfixBatch,
    compile_postfix,
)
from jaxsr.expressions.term import Term

Array = NDArray[Any]

_FORMS = 20_000  # remembered
_LARGEST = 400  # nodes of a form with its derivatives; a larger one is no term of a law


def mark(number: int) -> Term:
    """Return what stands for the open constant of that number in a form."""
    return Term.variable(f"#{number}")


@functools.lru_cache(maxsize=_FORMS)
def written(form: Term, count: int, names: tuple[str, ...]) -> PostfixBatch | None:
    """Return a form and its derivatives by ``count`` constants as postfix code (1 + count, slots).

    An open constant is a variable behind those of the data. None where the form holds what the
    machine or the rules of differentiation do not know.
    """
    if any(node.args and node.op not in OPERATORS for node in form.walk()):
        return None
    slopes = [derivative(form, mark(k).name) for k in range(count)]
    known = [slope for slope in slopes if slope is not None]
    if len(known) < count or sum(term.size for term in (form, *known)) > _LARGEST:
        return None
    return compile_postfix([form, *known], [*names, *(mark(k).name for k in range(count))])


class OpenTerms:
    """A batch of forms, with the numbers of their constants.

    Parameters
    ----------
    forms : sequence of PostfixBatch
        As :func:`written` gives them, for data of the same variables.
    first : sequence of int
        Number of each form's first constant; the others follow it.
    variables : tuple of str
    config : EngineConfig
    least : int
        Rows there are; those behind the forms' are zero.
    """

    def __init__(
        self,
        forms: Sequence[PostfixBatch],
        first: Sequence[int],
        variables: tuple[str, ...],
        config: EngineConfig,
        least: int = 0,
    ) -> None:
        rows = [len(form) for form in forms]
        slots = max(form.opcode.shape[1] for form in forms)
        opcode, operand = np.zeros((2, max(sum(rows), least), slots), np.int32)
        constants = np.zeros(opcode.shape)
        opcode[:, 0] = CONSTANT
        start = 0
        for form, count in zip(forms, rows, strict=True):
            here = slice(start, start + count), slice(form.opcode.shape[1])
            opcode[here], operand[here] = form.opcode, form.operand
            constants[here] = form.constants
            start += count
        owner = np.zeros(len(opcode), np.int64)
        owner[:start] = np.repeat(first, rows)
        number = operand.astype(np.int64) - len(variables) + owner[:, None]
        is_open = (opcode == VARIABLE) & (operand >= len(variables))
        opcode[is_open], operand[is_open] = CONSTANT, 0
        constants.view(np.int64)[is_open] = BOX + 1 + number[is_open]
        self._engine = Engine(PostfixBatch(opcode, operand, constants, variables), config)

    def resident(self, data: jax.Array, constants: Array) -> jax.Array:
        """Return every row at ``constants`` on the device (rows, samples), of data there."""
        return self._engine.resident(data, constants)

    def each(self, data: Array, constants: Array, use: Callable[[Array, slice], Any]) -> list[Any]:
        """Return what ``use(block, samples)`` makes of each piece of the samples.

        Parameters
        ----------
        data : ndarray, (variables, samples)
        constants : ndarray, (constants,)
        use : callable
            Gets (rows, samples of the piece), valid during the call: each form's value, then its
            slopes. It is called from several threads.
        """

        def piece(block: Array, _: slice, samples: slice) -> Any:
            return use(block, samples)

        return self._engine.each(data, piece, whole=True, constants=constants)
