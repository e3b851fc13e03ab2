"""From postfix arrays to one stream of instructions in which no subtree is computed twice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jaxsr.evaluation.sharing import Ints, Nodes, Places, distinct, linked
from jaxsr.expressions.postfix import CONSTANT, OPERATORS, PostfixBatch

_FIRST = 3  # postfix code of the first operator
BOX = 0x7FF8000000000000
"""Bits of a quiet NaN: a constant written so, with a whole number from 1 on in its lowest bits, is
open, and two with one number are the same."""
# Operators that take a constant beside a column without a register for it.
_IMMEDIATE = ("add", "sub", "mul", "div", "pow")
INSTRUCTIONS: tuple[str, ...] = (
    "copy",
    "constant",
    *OPERATORS,
    *(f"{name}_right" for name in _IMMEDIATE),  # column o constant
    *(f"{name}_left" for name in ("sub", "div", "pow")),  # constant o column
    "square",
    "cube",
)
"""What one instruction of the register machine can be; its code is the position here."""
_CODE = {name: k for k, name in enumerate(INSTRUCTIONS)}
_OPERATOR = np.array([-1, -1, -1, *(_CODE[name] for name in OPERATORS)], dtype=np.int32)
_RIGHT, _LEFT = np.full((2, len(_OPERATOR)), -1, dtype=np.int32)
for _name in _IMMEDIATE:
    _RIGHT[_FIRST + OPERATORS.index(_name)] = _CODE[f"{_name}_right"]
    # a commutative operator takes its constant from either side
    _LEFT[_FIRST + OPERATORS.index(_name)] = _CODE.get(f"{_name}_left", _CODE[f"{_name}_right"])


def numbers_of(constants: NDArray[np.float64]) -> Places:
    """Return the numbers of constants that are open; negative for one that is closed."""
    bits = constants.view(np.int64)
    return np.where(bits & BOX == BOX, bits & ~BOX, 0) - 1


@dataclass(frozen=True, slots=True)
class Schedule:
    """Instructions of a register machine that computes a batch of terms.

    Instruction k applies ``INSTRUCTIONS[code[k]]`` to rows ``left[k]`` and ``right[k]`` of a
    buffer, or to ``left[k]`` and ``immediate[k]``, and writes row ``target[k]``. The buffer's
    first ``window`` rows are outputs, then come the variables, then registers.

    Terms come in segments of ``window``, whose outputs take the same rows in turn: whoever runs
    the instructions up to ``ends[i]`` finds there the columns of terms i*window, i*window + 1, ...
    and takes them before going on. So what is written is read again while a cache holds it.

    Attributes
    ----------
    code, left, right, target : ndarray of int32, (instructions,)
    immediate : ndarray of float64, (instructions,)
    ends : tuple of int
        Number of instructions up to the end of each segment.
    outputs : int
        Number of terms.
    window, variables, registers : int
        Numbers of rows.
    inner_nodes : int
        Inner nodes of the terms as given.
    unique_nodes : int
        Distinct ones among them: those computed.
    """

    code: Ints
    left: Ints
    right: Ints
    target: Ints
    immediate: NDArray[np.float64]
    ends: tuple[int, ...]
    outputs: int
    window: int
    variables: int
    registers: int
    inner_nodes: int
    unique_nodes: int

    def __len__(self) -> int:
        return len(self.code)

    @property
    def number(self) -> Places:
        """Numbers of the open constants that instructions take; negative for one that is closed."""
        return numbers_of(self.immediate)

    @property
    def open(self) -> Places:
        """Positions of the instructions that take an open constant."""
        return np.flatnonzero(self.number >= 0)

    @property
    def rows(self) -> int:
        """Rows of the buffer."""
        return self.window + max(self.variables, 1) + self.registers

    @property
    def unique_fraction(self) -> float:
        """Distinct inner nodes over all inner nodes; 1 where there are none."""
        return self.unique_nodes / self.inner_nodes if self.inner_nodes else 1.0


def schedule(batch: PostfixBatch, window: int = 512) -> Schedule:
    """Order the distinct subtrees of a batch into instructions.

    Subtrees are told apart by a 64-bit hash of their postfix code, computed slot by slot for all
    terms at once, and equal hashes are checked node by node, so that sharing never depends on
    luck. Sums and products are one subtree in either order.

    Raises
    ------
    ValueError
        The postfix code of a term is not one whole expression.
    """
    nodes = linked(batch)
    inner = np.flatnonzero(nodes.first >= 0)
    kept, number = distinct(nodes, inner)
    chosen = _chosen(nodes, kept)
    stream = _stream(nodes, kept, number, chosen, batch.opcode.shape, window)
    base = window + max(len(batch.variables), 1)
    row, registers = _assigned(stream, base)
    row = np.concatenate([row, window + np.arange(base - window)])
    return Schedule(
        stream.code,
        row[stream.left].astype(np.int32),
        row[stream.right].astype(np.int32),
        row[: len(stream.code)].astype(np.int32),
        stream.immediate,
        stream.ends,
        len(batch),
        window,
        len(batch.variables),
        registers,
        len(inner),
        len(kept),
    )


@dataclass(frozen=True, slots=True)
class _Chosen:
    """What each distinct subtree's instruction is; arguments are flat positions of nodes."""

    code: Places
    immediate: NDArray[np.float64]
    left: Places
    right: Places


def _chosen(nodes: Nodes, kept: Places) -> _Chosen:
    """Return instruction, immediate, left and right argument of every distinct subtree."""
    operator, first, second = nodes.code[kept], nodes.first[kept], nodes.second[kept]
    second = np.where(second >= 0, second, first)
    numbers = nodes.payload.view(np.float64)
    a, b = nodes.code[first] == CONSTANT, nodes.code[second] == CONSTANT
    by_right, by_left = b & ~a & (_RIGHT[operator] >= 0), a & ~b & (_LEFT[operator] >= 0)
    code = np.where(by_right, _RIGHT[operator], np.where(by_left, _LEFT[operator], -1))
    code = np.where(code < 0, _OPERATOR[operator], code)
    immediate = np.where(by_right, numbers[second], np.where(by_left, numbers[first], 0.0))
    power = code == _CODE["pow_right"]
    code = np.where(power & (immediate == 2.0), _CODE["square"], code)
    code = np.where(power & (immediate == 3.0), _CODE["cube"], code)
    left = np.where(by_left, second, first)
    return _Chosen(code, immediate, left, np.where(by_left | by_right, left, second))


@dataclass(frozen=True, slots=True)
class _Stream:
    """Instructions in order. A value is numbered by the instruction that computes it.

    Variables are numbered from the number of instructions on.
    """

    code: Ints
    left: Places
    right: Places
    immediate: NDArray[np.float64]
    output: Places  # row of an output, -1 for a value of which no term is made
    ends: tuple[int, ...]


def _stream(
    nodes: Nodes,
    kept: Places,
    number: NDArray[Any],
    chosen: _Chosen,
    shape: tuple[int, ...],
    window: int,
) -> _Stream:
    """Put loads of constants, distinct subtrees and copies into one order, term by term.

    A term's own subtree writes the output. It is copied there instead where it is a leaf, was
    computed for an earlier term, or is used again after its segment, when the row is another's.
    """
    terms, slots = shape
    constant = nodes.code == CONSTANT
    both = np.concatenate([chosen.left, chosen.right])
    needed = np.unique(both[constant[both]])
    label, loads = pd.factorize(nodes.payload[needed])
    first, count = len(loads), len(kept)

    owner = kept // slots  # the term for which a subtree is computed
    root = number[nodes.root]
    users = _last_users(nodes, number, owner, chosen, count)
    inner = root >= 0
    np.maximum.at(users, root[inner], np.flatnonzero(inner))
    own = np.zeros(terms, dtype=bool)
    term = np.flatnonzero(inner)
    own[term] = (owner[root[term]] == term) & (users[root[term]] // window == term // window)
    copied = np.flatnonzero(~own)

    # a copy stands after the subtrees of its term
    after = np.searchsorted(owner, copied, side="right")
    at_copy = first + after + np.arange(len(copied))
    at_inner = np.ones(count + len(copied), dtype=bool)
    at_inner[after + np.arange(len(copied))] = False
    at_inner = first + np.flatnonzero(at_inner)
    total = first + count + len(copied)

    value = np.where(constant, 0, total + nodes.payload)
    value[number >= 0] = at_inner[number[number >= 0]]
    value[needed] = label
    leaf = constant[nodes.root[copied]]
    code = np.full(total, _CODE["constant"], dtype=np.int32)
    left, immediate = np.full(total, total), np.zeros(total)
    right, output = left.copy(), np.full(total, -1)
    immediate[:first] = np.asarray(loads, np.int64).view(np.float64)
    code[at_inner], immediate[at_inner] = chosen.code, chosen.immediate
    left[at_inner], right[at_inner] = value[chosen.left], value[chosen.right]
    code[at_copy] = np.where(leaf, _CODE["constant"], _CODE["copy"])
    immediate[at_copy] = np.where(leaf, nodes.payload.view(np.float64)[nodes.root[copied]], 0.0)
    left[at_copy] = right[at_copy] = np.where(leaf, total, value[nodes.root[copied]])
    output[at_copy] = copied % window
    written = np.flatnonzero(own)
    output[at_inner[root[written]]] = written % window
    # a segment ends before the first instruction of the next one's terms
    bounds = np.arange(window, terms + window, window)
    ends = first + np.searchsorted(owner, bounds) + np.searchsorted(copied, bounds)
    return _Stream(code, left, right, immediate, output, tuple(ends.tolist()))


def _last_users(
    nodes: Nodes, number: NDArray[Any], owner: Places, chosen: _Chosen, count: int
) -> Places:
    """Return the last term for which a subtree is used as an argument, or computed."""
    last = owner.copy()
    for argument in (chosen.left, chosen.right):
        used = number[argument]
        known = used >= 0
        latest = np.zeros(count, dtype=np.int64)
        latest[used[known]] = owner[known]  # owners rise, and of several the last one stands
        last = np.maximum(last, latest)
    return last


def _assigned(stream: _Stream, base: int) -> tuple[NDArray[Any], int]:
    """Return each instruction's row, registers from row ``base`` on, and the number of those.

    Values are sorted by how long they live into classes (up to 4, 16, 64, ... instructions), and
    each class takes the rows of a ring in turn, just long enough that none is overwritten before
    its last use. Short-lived values stay in a few rows that the nearest cache holds.
    """
    total = len(stream.code)
    steps = np.arange(total)
    last = steps.copy()
    for uses in (stream.left, stream.right):
        known = uses < total
        later = np.zeros(total, dtype=np.int64)
        later[uses[known]] = steps[known]  # of several uses the last one stands
        last = np.maximum(last, later)
    row = stream.output.copy()
    homeless = np.flatnonzero(row < 0)
    life = last[homeless] - homeless
    rank = np.ceil(np.log2(np.maximum(life, 1)) / 2.0)
    registers = 0
    for group in np.unique(rank).tolist():
        members = homeless[rank == group]
        own = np.arange(len(members))
        alive = np.searchsorted(members, last[members], side="right") - own
        ring = int(alive.max())
        row[members] = base + registers + own % ring
        registers += ring
    return row, registers
