"""Terms as fixed-size postfix arrays, the form in which machines walk a population."""

from __future__ import annotations

import functools
import itertools
import operator
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
_CODE = {"constant": CONSTANT, "variable": VARIABLE, **_OPCODE}
_OP, _NAME, _VALUE, _SIZE = map(operator.attrgetter, ("op", "name", "value", "size"))
_MANY = (_OPCODE["max"], _OPCODE["min"])


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


_ARITIES = np.array([0, 0, 0, *map(arity_of, OPERATORS)])  # by opcode
_UNARY = frozenset(np.flatnonzero(_ARITIES == 1).tolist())


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
    names = tuple(variables)
    nodes, codes = _flat(terms)
    if any(len(nodes[k].args) != 2 for k in np.flatnonzero(np.isin(codes, _MANY))):
        terms = [_paired(term) for term in terms]
        nodes, codes = _flat(terms)
    sizes = np.fromiter(map(_SIZE, terms), np.int64, len(terms))
    longest = int(sizes.max(initial=1))
    slots = slots_for(longest) if bucket is None else bucket
    if longest > slots:
        raise InputError(f"a term has {longest} nodes, the bucket {slots} slots", "bucket")
    first = np.arange(len(terms)) * slots - (np.cumsum(sizes) - sizes)
    where = np.arange(len(nodes)) + np.repeat(first, sizes)
    opcode = np.zeros((len(terms), slots), np.int32)
    operand = np.zeros_like(opcode)
    constants = np.zeros((len(terms), slots))
    opcode.reshape(-1)[where] = codes
    used, numbers = codes == VARIABLE, codes == CONSTANT
    operand.reshape(-1)[where[used]] = _operands(nodes, used, names)
    values = map(_VALUE, itertools.compress(nodes, numbers.tolist()))
    constants.reshape(-1)[where[numbers]] = np.fromiter(values, np.float64)
    return PostfixBatch(opcode, operand, constants, names)


def _flat(terms: Sequence[Term]) -> tuple[list[Term], NDArray[np.int32]]:
    """Return the nodes of all terms, arguments first, and their opcodes."""
    nodes: list[Term] = []
    stack = list(terms)
    while stack:
        node = stack.pop()
        nodes.append(node)
        if node.args:
            stack += node.args
    nodes.reverse()  # parents first and last arguments first, read from the end, is postorder
    try:
        codes = np.fromiter(map(_CODE.__getitem__, map(_OP, nodes)), np.int32, len(nodes))
    except KeyError as error:
        what = f"{error.args[0]} has no postfix code"
        raise InputError(what, "compile_postfix", "Evaluate it by columns.") from None
    return nodes, codes


def _operands(
    nodes: list[Term], used: NDArray[np.bool_], variables: tuple[str, ...]
) -> NDArray[np.int32]:
    """Return the positions of the variables among the nodes."""
    place = {name: k for k, name in enumerate(variables)}
    names = map(_NAME, itertools.compress(nodes, used.tolist()))
    try:
        return np.fromiter(map(place.__getitem__, names), np.int32)
    except KeyError as error:
        known = f"Known: {', '.join(variables)}."
        raise InputError(f"unknown variable {error.args[0]}", "", known) from None


def decompile(batch: PostfixBatch) -> list[Term]:
    """Return the terms of postfix code: the inverse of :func:`compile_postfix`.

    Raises
    ------
    InputError
        An opcode or a variable's position is unknown, or a row is no postfix code of one term.
    """
    _check(batch)
    used = batch.opcode != NOP
    leaves = [Term.variable(name) for name in batch.variables]
    parts = (batch.opcode[used], batch.operand[used], batch.constants[used])
    # every row leaves one value, so one stack serves them all and ends as the list of terms
    stack: list[Term] = []
    for code, operand, value in zip(*(part.tolist() for part in parts), strict=True):
        if code == VARIABLE:
            stack.append(leaves[operand])
        elif code == CONSTANT:
            stack.append(Term.constant(value))
        elif code in _UNARY:
            stack[-1] = Term(OPERATORS[code - 3], (stack[-1],))
        else:
            last = stack.pop()
            stack[-1] = Term(OPERATORS[code - 3], (stack[-1], last))
    return stack


def _check(batch: PostfixBatch) -> None:
    opcode, operand = batch.opcode, batch.operand
    for row, slot in np.argwhere((opcode < 0) | (opcode >= len(_ARITIES))):
        where = f"postfix row {row}, slot {slot}"
        raise InputError(f"unknown opcode {opcode[row, slot]}", where)
    outside = (operand < 0) | (operand >= len(batch.variables))
    for row, slot in np.argwhere((opcode == VARIABLE) & outside):
        where = f"postfix row {row}, slot {slot}"
        raise InputError(f"no variable stands at position {operand[row, slot]}", where)
    held = np.cumsum(np.where(opcode == NOP, 0, 1 - _ARITIES[opcode]), axis=1)
    for row, slot in np.argwhere((held < 1) & (opcode != NOP)):
        name = OPERATORS[opcode[row, slot] - 3]
        raise InputError(f"{name} lacks arguments at slot {slot}", f"postfix row {row}")
    ends = held[:, -1] if held.shape[1] else np.zeros(len(batch))
    for row in np.flatnonzero(ends != 1):
        raise InputError(f"code leaves {int(ends[row])} values, not one", f"postfix row {row}")


def _paired(term: Term) -> Term:
    """Return the term with Max and Min of many arguments as nested pairs."""
    if not term.args:
        return term
    args = tuple([_paired(arg) for arg in term.args])
    if term.op in ("max", "min"):
        return functools.reduce(lambda a, b: Term(term.op, (a, b)), args)
    return Term(term.op, args)
