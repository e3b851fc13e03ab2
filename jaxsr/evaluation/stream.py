"""Postfix code as a stream of instructions for a device of many threads, one sample each.

A thread holds a term's latest value in a register and the others on a stack of its own. A leaf
beside an inner node is read by the instruction itself, so that most terms never touch the stack,
and what is written to memory is the answer alone. Terms share no subtree here: computing one again
costs such a device less than fetching it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jaxsr.evaluation.schedule import numbers_of
from jaxsr.evaluation.sharing import linked
from jaxsr.expressions.postfix import CONSTANT, NOP, OPERATORS, VARIABLE, PostfixBatch

LOAD, FIRST = 0, 1
"""Instruction that pushes the latest value and takes a leaf; number of the first operator."""
NAMES: tuple[str, ...] = ("load", *OPERATORS, "square", "cube")
"""What an instruction can be; its number is the position here."""
BESIDE, RIGHT, LEFT = 0, 1, 2
"""How arguments come: from the stack, or the right or the left one from a leaf."""
_OPERATION, _PLACE = 6, 8  # bits of a word before the way of the arguments, and before the leaf


@dataclass(frozen=True, slots=True)
class Stream:
    """Instructions of terms, those of term k from ``starts[k]`` up to ``starts[k + 1]``.

    Attributes
    ----------
    words : ndarray of int32, (instructions,)
        Operation in the lowest six bits, then two that say how arguments come, then the place of
        the variable that is the leaf, from one; zero where the leaf is a number.
    values : ndarray of float64, (instructions,)
        The number that is the leaf.
    starts : ndarray of int32, (terms + 1,)
    depths : ndarray of int, (terms,)
        Most values on the stack of each.
    numbers : ndarray, (instructions,)
        Numbers of open constants; negative where the leaf is closed.
    """

    words: NDArray[np.int32]
    values: NDArray[np.float64]
    starts: NDArray[np.int32]
    depths: NDArray[np.int64]
    numbers: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.starts) - 1

    def at(self, constants: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values with the open constants at these."""
        return np.where(self.numbers >= 0, constants[np.maximum(self.numbers, 0)], self.values)


def unpacked(words: NDArray[np.int32]) -> tuple[NDArray[np.int32], ...]:
    """Return operation, way of the arguments, and place of the leaf."""
    low = (1 << _OPERATION) - 1
    return words & low, (words >> _OPERATION) & 3, words >> _PLACE


def streamed(batch: PostfixBatch) -> Stream:
    """Return the instructions of a batch of terms."""
    nodes = linked(batch)
    terms, slots = batch.opcode.shape
    code, first, second = nodes.code, nodes.first, nodes.second
    leaf = (code == CONSTANT) | (code == VARIABLE)
    right = (second >= 0) & leaf[second]
    left = (second >= 0) & ~right & leaf[first]
    absorbed = np.zeros(len(code), dtype=bool)
    absorbed[second[right]] = absorbed[first[left]] = True
    kept = np.flatnonzero((code != NOP) & ~absorbed)

    source = np.where(right, second, np.where(left, first, np.arange(len(code))))[kept]
    variable = code[source] == VARIABLE
    place = np.where(variable, nodes.payload[source] + 1, 0)
    closed = np.where(code[source] == CONSTANT, nodes.payload[source], 0)
    values = closed.view(np.float64)
    way = np.where(right, RIGHT, np.where(left, LEFT, BESIDE))[kept]
    operation = np.where(leaf[kept], LOAD, code[kept] - VARIABLE - 1 + FIRST)
    power = (operation == NAMES.index("pow")) & (way == RIGHT) & (place == 0)
    operation = np.where(power & (values == 2.0), NAMES.index("square"), operation)
    operation = np.where(power & (values == 3.0), NAMES.index("cube"), operation)

    both = (second[kept] >= 0) & (way == BESIDE)
    height = np.cumsum((operation == LOAD).astype(np.int64) - both)
    height -= kept // slots  # each term before has left one value
    words = operation | way << _OPERATION | place << _PLACE
    starts = np.searchsorted(kept, np.arange(terms + 1) * slots)
    return Stream(
        words.astype(np.int32),
        values,
        starts.astype(np.int32),
        np.maximum.reduceat(height, starts[:-1]),
        numbers_of(values),
    )
