"""From postfix arrays to one stream of instructions in which no subtree is computed twice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jaxsr.expressions.postfix import CONSTANT, NOP, OPERATORS, VARIABLE, PostfixBatch, arity_of

Ints = NDArray[np.int32]
Places = NDArray[np.int64]

_FIRST = 3  # postfix code of the first operator
_ARITY = np.array([0, 0, 0, *(arity_of(name) for name in OPERATORS)], dtype=np.int8)
_COMMUTES = np.array(
    [False] * 3 + [name in ("add", "mul", "max", "min", "eq", "ne") for name in OPERATORS]
)
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


@dataclass(frozen=True, slots=True)
class Schedule:
    """Instructions of a register machine that computes a batch of terms.

    Instruction k applies ``INSTRUCTIONS[code[k]]`` to rows ``left[k]`` and ``right[k]`` of a
    buffer, or to ``left[k]`` and ``immediate[k]``, and writes row ``target[k]``. The rows of the
    buffer are the outputs, one a term, then the variables, then registers.

    Attributes
    ----------
    code, left, right, target : ndarray of int32, (instructions,)
    immediate : ndarray of float64, (instructions,)
    outputs, variables, registers : int
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
    outputs: int
    variables: int
    registers: int
    inner_nodes: int
    unique_nodes: int

    def __len__(self) -> int:
        return len(self.code)

    @property
    def rows(self) -> int:
        """Rows of the buffer."""
        return self.outputs + self.variables + self.registers

    @property
    def unique_fraction(self) -> float:
        """Distinct inner nodes over all inner nodes; 1 where there are none."""
        return self.unique_nodes / self.inner_nodes if self.inner_nodes else 1.0


@dataclass(frozen=True, slots=True)
class _Nodes:
    """Nodes of all terms in one flat order, arguments before what uses them."""

    code: Ints  # postfix code
    payload: NDArray[np.int64]  # place of a variable, bits of a constant
    first: Places  # flat position of the only, or left, argument; -1 for a leaf
    second: Places
    root: Places  # flat position of each term's root


def schedule(batch: PostfixBatch) -> Schedule:
    """Order the distinct subtrees of a batch into instructions.

    Subtrees are told apart by a 64-bit hash of their postfix code, computed slot by slot for all
    terms at once, and equal hashes are checked node by node, so that sharing never depends on
    luck. Sums and products are one subtree in either order.

    Raises
    ------
    ValueError
        The postfix code of a term is not one whole expression.
    """
    nodes = _linked(batch)
    inner = np.flatnonzero(nodes.first >= 0)
    kept, number = _distinct(nodes, inner)
    return _instructions(nodes, kept, number, len(inner), len(batch.variables))


def _linked(batch: PostfixBatch) -> _Nodes:
    """Find every node's arguments by running all stacks side by side."""
    terms, slots = batch.opcode.shape
    opcode = np.ascontiguousarray(batch.opcode.T)  # slot by slot
    first, second = np.full((2, slots, terms), -1, dtype=np.int64)
    stack = np.full((slots // 2 + 3, terms), -1, dtype=np.int64)
    lane = np.arange(terms)
    top = np.zeros(terms, dtype=np.int64)
    arity = _ARITY[opcode]
    for slot in range(slots):
        used = opcode[slot] != NOP
        if not used.any():
            continue
        takes = arity[slot].astype(np.int64)
        if np.any((takes > top) & used) or np.any(top >= len(stack) - 1):
            raise ValueError("postfix code is not well formed: an operator lacks arguments")
        last, before = stack[top - 1, lane], stack[top - 2, lane]
        one, two = takes == 1, takes == 2
        first[slot] = np.where(one, last, np.where(two, before, -1))
        second[slot] = np.where(two, last, -1)
        top = np.where(used, top - takes, top)
        here = lane * slots + slot
        stack[top, lane] = np.where(used, here, stack[top, lane])
        top = np.where(used, top + 1, top)
    if np.any(top != 1):
        raise ValueError("postfix code is not well formed: a term leaves several values, or none")
    flat = batch.opcode.reshape(-1)
    constant = np.where(flat == CONSTANT, batch.constants.reshape(-1) + 0.0, 0.0)
    payload = constant.view(np.int64) + np.where(flat == VARIABLE, batch.operand.reshape(-1), 0)
    return _Nodes(
        flat, payload, first.T.reshape(-1).copy(), second.T.reshape(-1).copy(), stack[0].copy()
    )


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Scramble bits (the finaliser of splitmix64)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def _hashes(nodes: _Nodes, inner: Places) -> NDArray[np.uint64]:
    code = nodes.code.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    value = _mixed(code ^ _mixed(nodes.payload.view(np.uint64)))
    # Arguments stand before their operator, within a few slots: settle them level by level.
    left, right = nodes.first[inner], nodes.second[inner]
    level = _levels(nodes, inner)
    order = np.argsort(level, kind="stable")
    bounds = np.searchsorted(level[order], np.arange(1, level.max(initial=0) + 2))
    commutes = _COMMUTES[nodes.code[inner]]
    start = 0
    for stop in bounds.tolist():
        part = order[start:stop]
        start = stop
        if not len(part):
            continue
        a, b = value[left[part]], np.where(right[part] >= 0, value[right[part]], 0)
        swap = commutes[part] & (a > b)
        a, b = np.where(swap, b, a), np.where(swap, a, b)
        value[inner[part]] = _mixed(code[inner[part]] + _mixed(a * np.uint64(3)) + b)
    return value


def _levels(nodes: _Nodes, inner: Places) -> NDArray[np.int64]:
    """Return the height of every inner node above its lowest leaf."""
    height = np.zeros(len(nodes.code) + 1, dtype=np.int64)  # the last stands in for no argument
    left, right = nodes.first[inner], nodes.second[inner]
    while True:
        new = 1 + np.maximum(height[left], height[right])
        if np.array_equal(new, height[inner]):
            return new
        height[inner] = new


def _distinct(nodes: _Nodes, inner: Places) -> tuple[Places, NDArray[np.int64]]:
    """Return the first node of every class of equal subtrees, and each inner node's class.

    The second array covers all nodes; it is -1 for leaves.
    """
    hashes = _hashes(nodes, inner)
    label, _ = pd.factorize(hashes[inner])
    kept = inner[np.flatnonzero(_is_first(label))]
    number = np.full(len(nodes.code), -1, dtype=np.int64)
    number[inner] = label
    # a class is one subtree: same operator, and arguments that are leaves alike or one class
    twin = kept[label]
    same = nodes.code[twin] == nodes.code[inner]
    pairs = [(nodes.first[inner], nodes.first[twin]), (nodes.second[inner], nodes.second[twin])]
    straight = _alike(nodes, number, *pairs[0]) & _alike(nodes, number, *pairs[1])
    crossed = _alike(nodes, number, pairs[0][0], pairs[1][1])
    crossed &= _alike(nodes, number, pairs[1][0], pairs[0][1])
    if not np.all(same & (straight | (crossed & _COMMUTES[nodes.code[inner]]))):
        return inner, _each_alone(nodes, inner)
    return kept, number


def _is_first(label: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell where a label occurs first, for labels numbered in the order they appear."""
    highest = np.maximum.accumulate(label)
    return np.concatenate(([True], highest[1:] > highest[:-1])) if len(label) else label > 0


def _each_alone(nodes: _Nodes, inner: Places) -> NDArray[np.int64]:
    """Return classes of one node each: what is left when two hashes collide."""
    number = np.full(len(nodes.code), -1, dtype=np.int64)
    number[inner] = np.arange(len(inner))
    return number


def _alike(nodes: _Nodes, number: NDArray[np.int64], a: Places, b: Places) -> NDArray[np.bool_]:
    leaf = (nodes.code[a] == nodes.code[b]) & (nodes.payload[a] == nodes.payload[b])
    return (number[a] == number[b]) & ((number[a] >= 0) | leaf | ((a < 0) & (b < 0)))


def _instructions(
    nodes: _Nodes, kept: Places, number: NDArray[np.int64], inner: int, variables: int
) -> Schedule:
    """Choose instructions, then rows, for the distinct subtrees and for the roots.

    Values are numbered: constants that need a register, distinct subtrees, variables. The number
    of the first two is also the place of their instruction.
    """
    code, immediate, left, right = _chosen(nodes, kept)
    constant = nodes.code == CONSTANT
    needed = np.unique(np.concatenate([left[constant[left]], right[constant[right]]]))
    label, loads = pd.factorize(nodes.payload[needed])
    computed = len(loads) + len(kept)
    value = np.where(number >= 0, number + len(loads), computed + nodes.payload)
    value[constant] = -1
    value[needed] = label

    place, rest = _placed(nodes, number, len(loads), computed)
    rest_constant = constant[nodes.root[rest]]
    unread = np.zeros(len(loads), dtype=np.int64) + computed  # a load reads no row that matters
    source = np.where(rest_constant, computed, value[nodes.root[rest]])
    a = np.concatenate([unread, value[left], source])
    b = np.concatenate([unread, value[right], source])
    load, copy = _CODE["constant"], _CODE["copy"]
    codes = np.concatenate(
        [np.full(len(loads), load), code, np.where(rest_constant, load, copy)]
    ).astype(np.int32)
    numbers = nodes.payload.view(np.float64)
    values = np.concatenate(
        [
            np.asarray(loads, np.int64).view(np.float64),
            immediate,
            np.where(rest_constant, numbers[nodes.root[rest]], 0.0),
        ]
    )
    outputs = len(nodes.root)
    registers = _assign_registers(place, a, b, outputs + variables)
    row = np.concatenate([place, outputs + np.arange(max(variables, 1))])
    return Schedule(
        codes,
        row[a].astype(np.int32),
        row[b].astype(np.int32),
        np.concatenate([place, rest]).astype(np.int32),
        values,
        outputs,
        variables,
        registers,
        inner,
        len(kept),
    )


def _chosen(nodes: _Nodes, kept: Places) -> tuple[Places, NDArray[np.float64], Places, Places]:
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
    return code, immediate, left, np.where(by_left | by_right, left, second)


def _placed(
    nodes: _Nodes, number: NDArray[np.int64], loads: int, computed: int
) -> tuple[NDArray[np.int64], Places]:
    """Give the first root of every class its output row.

    Returns
    -------
    place : ndarray, (computed,)
        Output row of each computed value; -1 where it is no root.
    rest : ndarray
        Terms whose root is a leaf, or the same subtree as an earlier root.
    """
    outputs = len(nodes.root)
    place = np.full(computed, -1, dtype=np.int64)
    root = number[nodes.root]
    inner = np.flatnonzero(root >= 0)
    place[root[inner[::-1]] + loads] = inner[::-1]  # the first of equal ones is written last
    own = np.zeros(outputs, dtype=bool)
    own[place[place >= 0]] = True
    return place, np.flatnonzero(~own)


def _assign_registers(place: NDArray[np.int64], a: Places, b: Places, base: int) -> int:
    """Give every value without a row a register, from row ``base`` on; return their number.

    Values are sorted by how long they live into classes (up to 4, 16, 64, ... instructions), and
    each class takes the rows of a ring in turn, just long enough that none is overwritten before
    its last use. Short-lived values stay in a few rows that the nearest cache holds.
    """
    computed = len(place)
    last = np.arange(computed)
    steps = np.arange(len(a))
    for uses in (a, b):
        known = uses < computed
        later = np.zeros(computed, dtype=np.int64)
        later[uses[known]] = steps[known]  # of several uses the last one stands
        last = np.maximum(last, later)
    homeless = np.flatnonzero(place < 0)
    life = last[homeless] - homeless
    rank = np.ceil(np.log2(np.maximum(life, 1)) / 2.0).astype(np.int64)
    registers = 0
    for group in np.unique(rank).tolist():
        members = homeless[rank == group]
        own = np.arange(len(members))
        alive = np.searchsorted(members, last[members], side="right") - own
        ring = int(alive.max())
        place[members] = base + registers + own % ring
        registers += ring
    return registers
