"""Which subtrees of a batch are the same: postfix arrays, linked and hashed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from jaxsr.expressions.postfix import CONSTANT, NOP, OPERATORS, VARIABLE, PostfixBatch, arity_of

Ints = NDArray[Any]  # whole numbers
Places = NDArray[Any]  # positions

ARITY = np.array([0, 0, 0, *(arity_of(name) for name in OPERATORS)], dtype=np.int8)
_COMMUTES = np.array(
    [False] * 3 + [name in ("add", "mul", "max", "min", "eq", "ne") for name in OPERATORS]
)


@dataclass(frozen=True, slots=True)
class Nodes:
    """Nodes of all terms, slot by slot of each: arguments stand before what uses them."""

    code: Ints  # postfix code
    payload: NDArray[Any]  # place of a variable, bits of a constant
    first: Ints  # flat position of the only, or left, argument; -1 for a leaf
    second: Ints
    hashes: NDArray[np.uint64]
    root: Places  # flat position of each term's root


def linked(batch: PostfixBatch) -> Nodes:
    """Find every node's arguments and hash by running the stacks of all terms side by side."""
    batch = _compact(batch)
    opcode, operand, constants = batch.opcode, batch.operand, batch.constants
    length = (opcode != NOP).sum(axis=1)
    terms, slots = opcode.shape
    flat = opcode.reshape(-1)
    payload = (np.where(opcode == CONSTANT, constants, 0.0) + 0.0).view(np.int64).reshape(-1)
    payload += np.where(opcode == VARIABLE, operand, 0).reshape(-1)
    scrambled = flat.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    hashes = _mixed(scrambled ^ _mixed(payload.view(np.uint64)))

    # long terms first: those that still have code are then a prefix
    order = np.argsort(-length, kind="stable")
    active = np.searchsorted(-length[order], -np.arange(slots), side="left")
    code = np.ascontiguousarray(opcode[order].T)
    start = (order * slots).astype(np.int32)
    first, second = np.full((2, terms * slots), -1, dtype=np.int32)
    depth = slots // 2 + 3
    held: Places = np.full(
        depth * terms, -1, dtype=np.int32
    )  # stacks of flat positions, row by row
    level: Places = np.arange(terms) + terms  # where each stack's next value goes
    for slot in range(slots):
        count = int(active[slot])
        if not count:
            break
        operator, here = code[slot, :count], start[:count] + np.int32(slot)
        takes = ARITY[operator]
        top = level[:count]
        last, before = top - terms, top - 2 * terms
        takers = np.flatnonzero(takes)
        place, two = here[takers], takes[takers] == 2
        b = held[last[takers]]
        a = np.where(two, held[before[takers]], b)
        if np.any(a < 0):
            raise ValueError("postfix code is not well formed: an operator lacks arguments")
        first[place], second[place] = a, np.where(two, b, -1)
        hashes[place] = _joined(scrambled[place], operator[takers], hashes[a], hashes[b], two)
        level[:count] = last + (1 - takes.astype(np.int64)) * terms + terms
        if level[:count].max() >= depth * terms:
            raise ValueError("postfix code is not well formed: a term leaves several values")
        held[level[:count] - terms] = here
    if np.any(level >= 3 * terms) or np.any(level < 2 * terms):
        raise ValueError("postfix code is not well formed: a term leaves several values, or none")
    root = np.empty(terms, dtype=np.int64)
    root[order] = held[terms : 2 * terms]
    return Nodes(flat, payload, first, second, hashes, root)


def _compact(batch: PostfixBatch) -> PostfixBatch:
    """Return the batch with all padding behind the code."""
    used = batch.opcode != NOP
    if np.all(used[:, 1:] <= used[:, :-1]):
        return batch
    order = np.argsort(~used, axis=1, kind="stable")
    return PostfixBatch(
        np.take_along_axis(batch.opcode, order, axis=1),
        np.take_along_axis(batch.operand, order, axis=1),
        np.take_along_axis(batch.constants, order, axis=1),
        batch.variables,
    )


def _joined(
    code: NDArray[np.uint64],
    operator: Ints,
    a: NDArray[np.uint64],
    b: NDArray[np.uint64],
    two: NDArray[np.bool_],
) -> NDArray[np.uint64]:
    """Hash an operator with its arguments; a sum or product is the same either way."""
    swapped = _COMMUTES[operator] & (a > b)
    low, high = np.where(swapped, b, a), np.where(swapped, a, b)
    return _mixed(code + _mixed(low) + np.where(two, high, np.uint64(0)))


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Scramble bits (the finaliser of splitmix64)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def distinct(nodes: Nodes, inner: Places) -> tuple[Places, NDArray[Any]]:
    """Return the first node of every class of equal subtrees, and each inner node's class.

    The second array covers all nodes; it is -1 for leaves.
    """
    label, _ = pd.factorize(nodes.hashes[inner])
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


def _is_first(label: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell where a label occurs first, for labels numbered in the order they appear."""
    highest = np.maximum.accumulate(label)
    return np.concatenate(([True], highest[1:] > highest[:-1])) if len(label) else label > 0


def _each_alone(nodes: Nodes, inner: Places) -> NDArray[Any]:
    """Return classes of one node each: what is left when two hashes collide."""
    number = np.full(len(nodes.code), -1, dtype=np.int64)
    number[inner] = np.arange(len(inner))
    return number


def _alike(nodes: Nodes, number: NDArray[Any], a: Places, b: Places) -> NDArray[np.bool_]:
    leaf = (nodes.code[a] == nodes.code[b]) & (nodes.payload[a] == nodes.payload[b])
    return (number[a] == number[b]) & ((number[a] >= 0) | leaf | ((a < 0) & (b < 0)))
