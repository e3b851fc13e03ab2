"""Formulas recorded once and replayed: what an interpreter computes, without its walk.

A function of named arrays is run once on `Traced` values, which note every operation; the tape
then repeats those operations in the same order on numbers. Equal subexpressions are computed
once, what no result needs is left out, and arrays that are no longer needed are let go.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from jaxsr.expressions.sines import sine_and_cosine

Array = Any
Tree = Any
"""A number, a `Traced`, or a list, tuple or dict of trees."""


class UntraceableError(TypeError):
    """A function asks for the value of what is only being recorded."""


class Traced(NDArrayOperatorsMixin):
    """A value of a recording: NumPy functions and operators of it are noted."""

    __slots__ = ("number", "recorder")

    def __init__(self, recorder: _Recorder, number: int) -> None:
        self.recorder, self.number = recorder, number

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """Note a ufunc."""
        if method != "__call__" or options:
            raise UntraceableError(f"{ufunc.__name__}.{method}")
        return self.recorder.apply(_OPERATORS[ufunc] if ufunc in _OPERATORS else ufunc, inputs)

    def __array_function__(self, function: Any, types: Any, args: Any, options: Any) -> Any:
        """Note np.where, and nothing else of that kind."""
        if function is not np.where or len(args) != 3 or options:
            raise UntraceableError(function.__name__)
        return self.recorder.apply(np.where, args)

    def __array__(self, *args: Any, **options: Any) -> Any:
        """Refuse to be an array."""
        raise UntraceableError("array")

    def __bool__(self) -> bool:
        """Refuse to decide."""
        raise UntraceableError("bool")

    def called(self, function: Callable[..., tuple[Array, ...]], *args: Any, results: int) -> tuple:
        """Note a call of a function that decides by values itself; return its results."""
        whole = self.recorder.apply(function, args)
        return tuple(self.recorder.apply(_ITEMS[i], (whole,)) for i in range(results))


_ITEMS = tuple(operator.itemgetter(i) for i in range(3))
_OPERATORS: dict[Any, Callable] = {
    # Operators are quicker than ufuncs where both sides are numbers, and ** than power; but
    # a number divided by zero would be an error.
    np.add: operator.add,
    np.subtract: operator.sub,
    np.multiply: operator.mul,
    np.power: operator.pow,
    np.negative: operator.neg,
}


class _Recorder:
    """Operations in the order of their first use; a number of a node each."""

    def __init__(self) -> None:
        self.nodes: list[tuple[Callable | None, tuple[Any, ...]]] = []
        self._known: dict[Any, Traced] = {}

    def variable(self, name: str) -> Traced:
        return self._added(None, (name,))

    def apply(self, function: Callable, args: Sequence[Any]) -> Any:
        """Note an operation; what is void of effect is left out."""
        shorter = _SHORTER.get(function)
        if shorter is not None and (found := shorter(self.apply, *args)) is not None:
            return found
        try:
            key = (
                function,
                *((a.number, Traced) if isinstance(a, Traced) else (a, type(a)) for a in args),
            )
            known = self._known.get(key)
        except TypeError:  # a constant that has no hash
            return self._added(function, tuple(args))
        if known is None:
            known = self._known[key] = self._added(function, tuple(args))
        return known

    def _added(self, function: Callable | None, args: tuple[Any, ...]) -> Traced:
        self.nodes.append((function, args))
        return Traced(self, len(self.nodes) - 1)


def _is(value: Any, number: float) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value == number


def _negated(value: Any) -> Any:
    """Return a where a value is -a, None where it is none."""
    if not isinstance(value, Traced):
        return None
    function, args = value.recorder.nodes[value.number]
    return args[0] if function is operator.neg else None


def _opposite(note: _Note, a: Any) -> Any:
    if (positive := _negated(a)) is not None:
        return positive
    return note(operator.neg, (a,)) if isinstance(a, Traced) else -a


def _product(note: _Note, a: Any, b: Any) -> Any:
    for one, other in ((a, b), (b, a)):
        if _is(one, 0.0):
            return 0.0
        if _is(one, 1.0):
            return other
        if _is(one, -1.0):
            return _opposite(note, other)
        if (positive := _negated(one)) is not None:
            return _opposite(note, note(operator.mul, (positive, other)))
    return None


def _quotient(note: _Note, a: Any, b: Any) -> Any:
    if _is(b, 1.0):
        return a
    if (positive := _negated(a)) is not None:
        return _opposite(note, note(np.divide, (positive, b)))
    if (positive := _negated(b)) is not None:
        return _opposite(note, note(np.divide, (a, positive)))
    return None


def _sum(note: _Note, a: Any, b: Any) -> Any:
    for one, other in ((a, b), (b, a)):
        if _is(one, 0.0):
            return other
        if (positive := _negated(one)) is not None:
            return note(operator.sub, (other, positive))
    return None


def _difference(note: _Note, a: Any, b: Any) -> Any:
    if _is(b, 0.0):
        return a
    if _is(a, 0.0):
        return _opposite(note, b)
    if (positive := _negated(b)) is not None:
        return note(operator.add, (a, positive))
    if (positive := _negated(a)) is not None:
        return _opposite(note, note(operator.add, (positive, b)))
    return None


_Note = Callable[[Callable, Sequence[Any]], Any]
_SHORTER: dict[Callable, Callable[[_Note, Any, Any], Any]] = {
    operator.mul: _product,
    np.divide: _quotient,
    operator.add: _sum,
    operator.sub: _difference,
}
"""What an operation with a zero, a one or a sign comes to, None if it has to be done; nothing is
rounded otherwise than before."""


@dataclass(frozen=True, eq=False)
class Recording:
    """What a function does.

    Attributes
    ----------
    nodes : list of (callable or None, tuple)
        Operations and their operands, a `Traced` or a number each; None and a name is a value that
        is given.
    tree : tree
        What the function returned.
    """

    nodes: Sequence[tuple[Callable | None, tuple[Any, ...]]]
    tree: Tree

    @staticmethod
    def of(function: Callable[[Mapping[str, Any]], Tree], names: Sequence[str]) -> Recording:
        """Record a function.

        Parameters
        ----------
        function : callable
            Of a mapping from names to values; returns lists, tuples and dicts of values.
        names : sequence of str
            What the mapping holds.

        Raises
        ------
        UntraceableError
            The function asks for a value before there is one.
        """
        recorder = _Recorder()
        tree = function({name: recorder.variable(name) for name in names})
        return Recording(recorder.nodes, tree)


class Tape:
    """A recorded function of named arrays, as one straight piece of Python."""

    def __init__(self, recording: Recording) -> None:
        nodes, tree = recording.nodes, recording.tree
        wanted: list[int] = []
        mapped(tree, lambda leaf: wanted.append(leaf.number))
        text = _Text()
        last = _last_uses(nodes, wanted)
        partners = _partners(nodes, last)
        place: dict[int, str] = {}
        free: list[str] = []

        def placed(number: int) -> str:
            place[number] = free.pop() if free else f"r{number}"
            return place[number]

        for number, (call, args) in enumerate(nodes):
            if number not in last:
                continue
            if call is None:
                place[number] = text.assigned(f"r{number}", f"given[{args[0]!r}]")
                continue
            values = [place[a.number] if isinstance(a, Traced) else text.constant(a) for a in args]
            for a in {a.number for a in args if isinstance(a, Traced)}:
                if last[a] == number:
                    free.append(place[a])
            if number in place:  # beside its partner
                continue
            if number in partners:
                both = ", ".join(map(placed, partners[number]))
                text.assigned(both, text.operation(sine_and_cosine, values))
                continue
            text.assigned(placed(number), text.operation(call, values))
        leaves = mapped(tree, lambda leaf: _Name(place[leaf.number]))
        text.lines.append(f" return {text.tree(leaves)}")
        self._function = text.function()
        self._count = sum(nodes[number][0] is not None for number in last)

    def __len__(self) -> int:
        """Count the operations."""
        return self._count

    def __call__(self, environment: Mapping[str, Array]) -> Tree:
        """Return the function's result for arrays or numbers."""
        return self._function(environment)


class _Name(str):
    """Of the variable that holds a result."""


class _Text:
    """The lines of a function, and the objects that they name."""

    def __init__(self) -> None:
        self.lines: list[str] = ["def replayed(given):"]
        self._objects: dict[str, Any] = {}
        self._names: dict[Any, str] = {}

    def assigned(self, name: str, value: str) -> str:
        self.lines.append(f" {name} = {value}")
        return name

    def constant(self, value: Any) -> str:
        return self._named((type(value), repr(value)), value)

    def operation(self, call: Callable, values: Sequence[str]) -> str:
        symbol = _SYMBOLS.get(call)
        if symbol is not None:
            return symbol.format(*values)
        return f"{self._named(call, call)}({', '.join(values)})"

    def tree(self, tree: Tree) -> str:
        if isinstance(tree, _Name):
            return tree
        if isinstance(tree, dict):
            return "{" + ", ".join(f"{k!r}: {self.tree(v)}" for k, v in tree.items()) + "}"
        if isinstance(tree, list):
            return "[" + ", ".join(map(self.tree, tree)) + "]"
        if isinstance(tree, tuple):
            return "(" + "".join(f"{self.tree(v)}, " for v in tree) + ")"
        return self.constant(tree)

    def function(self) -> Callable[[Mapping[str, Array]], Tree]:
        # A replay from a list of operations takes a quarter longer.
        exec(compile("\n".join(self.lines), "<tape>", "exec"), self._objects)
        return self._objects["replayed"]

    def _named(self, key: Any, value: Any) -> str:
        if key not in self._names:
            self._names[key] = f"k{len(self._names)}"
            self._objects[self._names[key]] = value
        return self._names[key]


_SYMBOLS: dict[Callable, str] = {
    operator.add: "{} + {}",
    operator.sub: "{} - {}",
    operator.mul: "{} * {}",
    operator.pow: "{} ** {}",
    operator.neg: "-{}",
}


def mapped(tree: Tree, change: Callable[[Traced], Any]) -> Tree:
    """Return a tree with every recorded value changed."""
    if isinstance(tree, Traced):
        return change(tree)
    if isinstance(tree, dict):
        return {k: mapped(v, change) for k, v in tree.items()}
    if isinstance(tree, list | tuple):
        return type(tree)([mapped(v, change) for v in tree])
    return tree


def _partners(
    nodes: Sequence[tuple[Callable | None, tuple[Any, ...]]], used: Mapping[int, int]
) -> dict[int, tuple[int, int]]:
    """Return, for a sine and a cosine of the same value, the numbers of both."""
    found: dict[int, dict[Callable, int]] = {}
    for number, (call, args) in enumerate(nodes):
        if number in used and call in (np.sin, np.cos) and isinstance(args[0], Traced):
            found.setdefault(args[0].number, {})[call] = number
    pairs = [(p[np.sin], p[np.cos]) for p in found.values() if len(p) == 2]
    return {number: pair for pair in pairs for number in pair}


def _last_uses(
    nodes: Sequence[tuple[Callable | None, tuple[Any, ...]]], wanted: Sequence[int]
) -> dict[int, int]:
    """Return the last node that uses each node that a result needs; results last for ever."""
    last = {number: len(nodes) for number in wanted}
    for number in reversed(range(len(nodes))):
        if number not in last:
            continue
        call, args = nodes[number]
        for arg in args if call is not None else ():
            if isinstance(arg, Traced):
                last.setdefault(arg.number, number)
    return last
