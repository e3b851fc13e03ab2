"""Recorded formulas as instructions of a register machine.

An instruction is an operation on registers, each a row of samples; `models.machine_steps` runs
them. What depends on no sample is calculated before the first one.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions.slopes import power_with_slope
from jaxsr.expressions.tape import Recording, Traced, Tree, mapped

Array = np.ndarray
CODE: Mapping[str, int] = {
    name: k
    for k, name in enumerate(
        "add sub mul div neg where sine_cosine sine cosine tanh abs sign power power_value "
        "power_slope less less_equal greater greater_equal equal not_equal and or not maximum "
        "minimum exp log sqrt tan sinh cosh asin acos atan atan2 floor step".split()
    )
}
"""Operation to its number."""
_NAMES: Mapping[Any, str] = {
    operator.add: "add",
    operator.sub: "sub",
    operator.mul: "mul",
    operator.neg: "neg",
    operator.pow: "power",
    np.divide: "div",
    np.float_power: "power",
    np.sin: "sine",
    np.cos: "cosine",
    np.tan: "tan",
    np.sinh: "sinh",
    np.cosh: "cosh",
    np.tanh: "tanh",
    np.exp: "exp",
    np.log: "log",
    np.sqrt: "sqrt",
    np.arcsin: "asin",
    np.arccos: "acos",
    np.arctan: "atan",
    np.arctan2: "atan2",
    np.abs: "abs",
    np.sign: "sign",
    np.floor: "floor",
    np.heaviside: "step",
    np.maximum: "maximum",
    np.minimum: "minimum",
    np.less: "less",
    np.less_equal: "less_equal",
    np.greater: "greater",
    np.greater_equal: "greater_equal",
    np.equal: "equal",
    np.not_equal: "not_equal",
    np.logical_and: "and",
    np.bitwise_and: "and",
    np.logical_or: "or",
    np.bitwise_or: "or",
    np.logical_not: "not",
    np.where: "where",
}
PASSED = 3
"""Operands of an instruction, at most."""
_Operand = int | float
"""Node of the recording, or a number."""


@dataclass(frozen=True, eq=False)
class Instructions:
    """Instructions in the order of their execution, and where what they need and find stands.

    Attributes
    ----------
    once, each : ndarray of int, shape (instructions, 2 + `PASSED`)
        Operation, target, operands: of what depends on no sample, and of what does. The third
        operand of a sine with its cosine is the register of the latter.
    preset : ndarray, shape (registers,)
        Numbers in registers before anything is run.
    given : dict of str to int
        Name to the register of its value, of names that occur.
    results : tree
        What the function returned, a register in the place of every value.
    """

    once: Array
    each: Array
    preset: Array
    given: Mapping[str, int]
    results: Tree

    @staticmethod
    def of(recording: Recording, by_sample: Collection[str]) -> Instructions | None:
        """Return the instructions of a recording; None where it calls what the machine has not.

        Parameters
        ----------
        by_sample : collection of str
            Names whose values differ from sample to sample.
        """
        try:
            return _Assembler(recording, by_sample).assembled()
        except KeyError:
            return None


class _Assembler:
    """Turns nodes into instructions and gives them registers."""

    def __init__(self, recording: Recording, by_sample: Collection[str]) -> None:
        self.nodes, self.tree = recording.nodes, recording.tree
        self.steps = _operations(self.nodes)
        wanted: list[int] = []
        mapped(self.tree, lambda leaf: wanted.append(leaf.number))
        self.last = _last_uses(self.steps, wanted)
        self.preset: list[float] = []
        self.numbers: dict[float, int] = {}
        self.free: list[int] = []
        self.by_sample = frozenset(by_sample)

    def assembled(self) -> Instructions:
        place: dict[int, int] = {}
        given: dict[str, int] = {}
        moving: set[int] = set()  # nodes that differ from sample to sample
        once: list[tuple[int, ...]] = []
        each: list[tuple[int, ...]] = []
        partners = _partners(self.steps, self.last)
        ends = self._ends(partners)
        for number, (name, args) in enumerate(self.steps):
            if number not in self.last or number in place or name is None:
                continue
            if name == "given":
                place[number] = given[args[0]] = self._fresh()
                if args[0] in self.by_sample:
                    moving.add(number)
                continue
            both = partners.get(number, (number,))
            moves = any(isinstance(a, int) and a in moving for a in args)
            if moves:
                moving.update(both)
            operands = [self._number(a) if isinstance(a, float) else place[a] for a in args]
            for own in both:
                place[own] = self._placed() if moves else self._fresh()
            operands += [0] * (PASSED - len(operands))
            if len(both) == 2:
                name, operands[2] = "sine_cosine", place[both[1]]
            (each if moves else once).append((CODE[name], place[both[0]], *operands))
            if moves:  # after the target is placed: rows of an instruction are never the same
                gone = {a for a in args if isinstance(a, int) and a in moving}
                self.free += [
                    place[a] for a in gone if ends[a] <= number and self.steps[a][0] != "given"
                ]
        results = mapped(self.tree, lambda leaf: _Register(place[leaf.number]))
        results = _whole(results, self._number)
        return Instructions(_table(once), _table(each), np.array(self.preset), given, results)

    def _ends(self, partners: Mapping[int, tuple[int, int]]) -> dict[int, int]:
        """Return where each node is used last; a sine and a cosine are calculated at the first."""
        ends = {
            number: len(self.steps) for number, end in self.last.items() if end == len(self.steps)
        }
        for number in self.last:
            at = min(partners.get(number, (number,)))
            if self.steps[number][0] not in (None, "given"):
                for arg in self.steps[number][1]:
                    if isinstance(arg, int):
                        ends[arg] = max(ends.get(arg, at), at)
        return ends

    def _fresh(self, value: float = np.nan) -> int:
        self.preset.append(value)
        return len(self.preset) - 1

    def _placed(self) -> int:
        return self.free.pop() if self.free else self._fresh()

    def _number(self, value: float) -> int:
        if value not in self.numbers:
            self.numbers[value] = self._fresh(value)
        return self.numbers[value]


class _Register(int):
    """Where a result stands."""


def _whole(tree: Tree, placed: Callable[[float], int]) -> Tree:
    """Return a tree of registers, numbers in it placed in registers of their own."""
    if isinstance(tree, dict):
        return {k: _whole(v, placed) for k, v in tree.items()}
    if isinstance(tree, list | tuple):
        return [_whole(v, placed) for v in tree]
    return int(tree) if isinstance(tree, _Register) else placed(float(tree))


def _table(rows: Sequence[tuple[int, ...]]) -> Array:
    return np.array(rows, dtype=np.int64).reshape(-1, 2 + PASSED)


def _operations(
    nodes: Sequence[tuple[Callable | None, tuple[Any, ...]]],
) -> list[tuple[str | None, tuple[Any, ...]]]:
    """Return the name of each node's operation, and its operands: numbers of nodes, or numbers.

    Raises
    ------
    KeyError
        Of a function that the machine has not.
    """
    found: list[tuple[str | None, tuple[Any, ...]]] = []
    for function, args in nodes:
        if function is None:
            found.append(("given", args))
        elif function is power_with_slope:
            found.append((None, tuple(map(_operand, args[:2]))))
        elif isinstance(function, operator.itemgetter):
            whole = args[0].number
            value = function(("power_value", "power_slope"))
            found.append((value, found[whole][1]))
        else:
            found.append((_NAMES[function], tuple(map(_operand, args))))
    return found


def _operand(arg: Any) -> _Operand:
    return arg.number if isinstance(arg, Traced) else float(arg)


def _last_uses(
    steps: Sequence[tuple[str | None, tuple[Any, ...]]], wanted: Sequence[int]
) -> dict[int, int]:
    """Return the last operation that uses each node that a result needs; results last for ever."""
    last = {number: len(steps) for number in wanted}
    for number in reversed(range(len(steps))):
        if number in last and steps[number][0] not in (None, "given"):
            for arg in steps[number][1]:
                if isinstance(arg, int):
                    last.setdefault(arg, number)
    return last


def _partners(
    steps: Sequence[tuple[str | None, tuple[Any, ...]]], used: Mapping[int, int]
) -> dict[int, tuple[int, int]]:
    """Return, for a sine and a cosine of the same value, the numbers of both, the sine first."""
    found: dict[int, dict[str, int]] = {}
    for number, (name, args) in enumerate(steps):
        if number in used and name in ("sine", "cosine") and isinstance(args[0], int):
            found.setdefault(args[0], {})[name] = number
    pairs = [(p["sine"], p["cosine"]) for p in found.values() if len(p) == 2]
    return {number: pair for pair in pairs for number in pair}
