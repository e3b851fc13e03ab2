"""Terms as fixed-size postfix arrays, the form in which machines walk a population."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jaxsr._result import InputError
from jaxsr.expressions.primitives import BUILT_IN, PRIMITIVES
from jaxsr.expressions.term import Term

NOP, CONSTANT, VARIABLE = 0, 1, 2
# Max and Min of several arguments are written as nested pairs.
OPERATORS: tuple[str, ...] = tuple(
    name
    for name in BUILT_IN
    if PRIMITIVES[name].pointwise and (PRIMITIVES[name].arity in (1, 2) or name in ("max", "min"))
)
_OPCODE = {name: 3 + k for k, name in enumerate(OPERATORS)}


@dataclass(frozen=True, slots=True)
class PostfixBatch:
    """Postfix code of a batch of terms, padded with NOP to one length.

    Attributes
    ----------
    opcode : ndarray of int32, (terms, slots)
        0 NOP, 1 constant, 2 variable, 3 + k the k-th of ``OPERATORS``.
    operand : ndarray of int32, (terms, slots)
        Position in ``variables``; zero elsewhere.
    constants : ndarray of float64, (terms, slots)
        Value of a constant; zero elsewhere.
    variables : tuple of str
        Order of the columns of the data.
    """

    opcode: NDArray[np.int32]
    operand: NDArray[np.int32]
    constants: NDArray[np.float64]
    variables: tuple[str, ...]

    def __post_init__(self) -> None:
        shapes = {self.opcode.shape, self.operand.shape, self.constants.shape}
        if len(shapes) > 1 or self.opcode.ndim != 2:
            raise InputError(
                f"postfix arrays must share one shape (terms, slots), got {shapes}", "PostfixBatch"
            )

    def __len__(self) -> int:
        return self.opcode.shape[0]


def arity_of(name: str) -> int:
    """Return the number of arguments an operator takes in postfix code: 1 or 2."""
    arity = PRIMITIVES[name].arity
    return 2 if arity == -1 else arity


def slots_for(size: int) -> int:
    """Return the bucket for a term of ``size`` nodes: 8, 16, 32, ..."""
    slots = 8
    while slots < size:
        slots *= 2
    return slots


def compile_postfix(
    terms: Sequence[Term], variables: Sequence[str], bucket: int | None = None
) -> PostfixBatch:
    """Write terms as postfix code.

    Parameters
    ----------
    terms : sequence of Term
    variables : sequence of str
    bucket : int, optional
        Number of slots; by default the smallest of 8, 16, 32, ... that holds every term.

    Raises
    ------
    InputError
        A variable is not listed, or a term does not fit the bucket.
    """
    terms = [_paired(term) for term in terms]
    longest = max((term.size for term in terms), default=1)
    slots = slots_for(longest) if bucket is None else bucket
    if longest > slots:
        raise InputError(f"a term has {longest} nodes, the bucket {slots} slots", "bucket")
    place = {name: k for k, name in enumerate(variables)}
    opcode = np.zeros((len(terms), slots), dtype=np.int32)
    operand = np.zeros_like(opcode)
    constants = np.zeros((len(terms), slots))
    for row, term in enumerate(terms):
        for slot, node in enumerate(_postorder(term)):
            if node.op == "constant":
                opcode[row, slot] = CONSTANT
                constants[row, slot] = node.value
            elif node.op == "variable":
                if node.name not in place:
                    known = ", ".join(variables)
                    raise InputError(f"unknown variable {node.name}", "", f"Known: {known}.")
                opcode[row, slot] = VARIABLE
                operand[row, slot] = place[node.name]
            elif node.op in _OPCODE:
                opcode[row, slot] = _OPCODE[node.op]
            else:
                raise InputError(
                    f"{node.op} has no postfix code", "compile_postfix", "Evaluate it by columns."
                )
    return PostfixBatch(opcode, operand, constants, tuple(variables))


def decompile(batch: PostfixBatch) -> list[Term]:
    """Return the terms of postfix code: the inverse of :func:`compile_postfix`."""
    return [_decompile_row(batch, row) for row in range(len(batch))]


def _decompile_row(batch: PostfixBatch, row: int) -> Term:
    stack: list[Term] = []
    for slot, code in enumerate(batch.opcode[row]):
        if code == NOP:
            continue
        if code == CONSTANT:
            stack.append(Term.constant(float(batch.constants[row, slot])))
        elif code == VARIABLE:
            stack.append(Term.variable(batch.variables[batch.operand[row, slot]]))
        elif 3 <= code < 3 + len(OPERATORS):
            name = OPERATORS[code - 3]
            arity = arity_of(name)
            if len(stack) < arity:
                raise InputError(f"{name} lacks arguments at slot {slot}", f"postfix row {row}")
            args = stack[len(stack) - arity :]
            del stack[len(stack) - arity :]
            stack.append(Term.apply(name, *args))
        else:
            raise InputError(f"unknown opcode {code}", f"postfix row {row}, slot {slot}")
    if len(stack) != 1:
        raise InputError(f"code leaves {len(stack)} values, not one", f"postfix row {row}")
    return stack[0]


def _paired(term: Term) -> Term:
    if not term.args:
        return term
    args = [_paired(arg) for arg in term.args]
    if term.op in ("max", "min"):
        return functools.reduce(lambda a, b: Term.apply(term.op, a, b), args)
    return Term.apply(term.op, *args)


def _postorder(term: Term) -> list[Term]:
    out: list[Term] = []
    stack = [term]
    while stack:
        node = stack.pop()
        out.append(node)
        stack.extend(node.args)
    out.reverse()
    return out
