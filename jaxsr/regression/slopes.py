"""Columns of terms and their exact derivatives with respect to inner constants.

One pass over the tree carries value and tangents together (forward differentiation); terms that
differ in their constants alone share a pass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from jaxsr._cores import side_by_side
from jaxsr.evaluation.evaluator import PIECE
from jaxsr.expressions.primitives import DISCONTINUOUS, PRIMITIVES
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array

# Central differences at the cube root of the float64 rounding: error about 1e-11.
_STEP = 6e-6

Tangents = dict[int, Any]

# Partial derivatives (one for each argument) from the arguments and the value.
_PARTIALS: dict[str, Callable[..., tuple[Any, ...]]] = {
    "add": lambda a, b, f: (1.0, 1.0),
    "sub": lambda a, b, f: (1.0, -1.0),
    "mul": lambda a, b, f: (b, a),
    "div": lambda a, b, f: (1.0 / b, -f / b),
    "pow": lambda a, b, f: (b * np.float_power(a, b - 1.0), f * np.log(a)),
    "neg": lambda a, f: (-1.0,),
    "sin": lambda a, f: (np.cos(a),),
    "cos": lambda a, f: (-np.sin(a),),
    "tan": lambda a, f: (1.0 + f**2,),
    "sinh": lambda a, f: (np.cosh(a),),
    "cosh": lambda a, f: (np.sinh(a),),
    "tanh": lambda a, f: (1.0 - f**2,),
    "exp": lambda a, f: (f,),
    "log": lambda a, f: (1.0 / a,),
    "sqrt": lambda a, f: (0.5 / f,),
    "asin": lambda a, f: (1.0 / np.sqrt(1.0 - a**2),),
    "acos": lambda a, f: (-1.0 / np.sqrt(1.0 - a**2),),
    "atan": lambda a, f: (1.0 / (1.0 + a**2),),
    "atan2": lambda a, b, f: (b / (a**2 + b**2), -a / (a**2 + b**2)),
    "abs": lambda a, f: (np.sign(a),),
}
_FLAT = DISCONTINUOUS | {"and", "or", "not"}
_KNOWN = _FLAT | _PARTIALS.keys() | {"max", "min", "piecewise"}


def constants_of(term: Term) -> list[float]:
    """Return the inner constants that may move, in preorder.

    Whole exponents are part of the form, and a factor of the whole term is its coefficient's.
    """
    return [leaf.value for leaf in _movable(term, outer=True)]


def with_constants(term: Term, values: Iterator[float]) -> Term:
    """Return the term with its movable constants taken from ``values``, in preorder."""
    return with_leaves(term, map(Term.constant, values))


def with_leaves(term: Term, leaves: Iterator[Term], *, outer: bool = True) -> Term:
    """Return the term with ``leaves`` in place of its movable constants, in preorder."""
    if term.is_constant:
        return term if outer else next(leaves)
    if not term.args:
        return term
    return Term(
        term.op, tuple(with_leaves(a, leaves, outer=still) for a, still in _parts(term, outer))
    )


def _movable(term: Term, outer: bool) -> Iterator[Term]:
    if term.is_constant and not outer:
        yield term
    for arg, still in _parts(term, outer):
        yield from _movable(arg, still)


def _parts(term: Term, outer: bool) -> Iterator[tuple[Term, bool]]:
    """Yield the arguments, and whether a constant that stands there is none that moves."""
    factors = outer and term.op in ("mul", "div", "neg")
    for place, arg in enumerate(term.args):
        whole = arg.is_constant and float(arg.value).is_integer()
        yield arg, factors or (whole and term.op == "pow" and place == 1)


@dataclass(frozen=True, slots=True)
class Node:
    """One step of a form: a constant's place, a column that does not move, or a primitive."""

    op: str
    place: int = -1
    column: Term | None = None
    args: tuple[int, ...] = ()


class ColumnOf(Protocol):
    """A cache's way to a term's column (samples,)."""

    def __call__(self, term: Term, *, keep: bool = True) -> Array: ...


@dataclass(frozen=True, slots=True)
class Form:
    """A term with its constants left open, as a list of steps in the order of evaluation.

    A primitive whose derivative is not known here, or that looks at a whole recording, makes the
    term opaque: it is evaluated as a whole (``template``) and its slopes are differences.
    """

    nodes: tuple[Node, ...]
    constants: int
    template: Term | None = None

    @classmethod
    def of(cls, term: Term) -> Form:
        """Read the form of a term; constants are counted in preorder."""
        if any(node.args and node.op not in _KNOWN for node in term.walk()):
            count = len(constants_of(term))
            return cls((), count, with_constants(term, iter([0.0] * count)))
        nodes: list[Node] = []
        count = 0

        def visit(term: Term, outer: bool) -> int:
            nonlocal count
            if term.is_constant and not outer:
                nodes.append(Node("constant", place=count))
                count += 1
            elif next(_movable(term, outer), None) is None:
                nodes.append(Node("column", column=term))
            else:
                args = tuple(visit(arg, still) for arg, still in _parts(term, outer))
                nodes.append(Node(term.op, args=args))
            return len(nodes) - 1

        visit(term, outer=True)
        return cls(tuple(nodes), count)

    def columns(self, constants: Array, column_of: ColumnOf) -> tuple[Any, Tangents]:
        """Return values (sets, samples) for sets of constants (sets, constants), and tangents.

        Tangents map the place of a constant to d value / d constant. What is not finite stays so.
        """
        if self.template is not None:
            return _opaque(self.template, constants, column_of)
        values: list[Any] = []
        slopes: list[Tangents] = []
        with np.errstate(all="ignore"):
            for node in self.nodes:
                if node.op == "constant":
                    values.append(constants[:, node.place, None])
                    slopes.append({node.place: 1.0})
                elif node.column is not None:
                    values.append(column_of(node.column))
                    slopes.append({})
                else:
                    args = [values[k] for k in node.args]
                    value = _apply(node.op, args)
                    values.append(value)
                    slopes.append(_chain(node.op, args, value, [slopes[k] for k in node.args]))
        return values[-1], slopes[-1]

    def pieces(
        self, constants: Array, column_of: ColumnOf, samples: int, threads: int | None = None
    ) -> list[tuple[slice, Any, Tangents]]:
        """Return (rows, values, tangents) as :meth:`columns`, long columns piece by piece.

        What lies between two steps of a piece stays in a core's cache; threads, one for each core
        when None, take pieces.
        """
        if self.template is not None or samples <= 2 * PIECE:
            return [(slice(None), *self.columns(constants, column_of))]
        still = dict.fromkeys(node.column for node in self.nodes if node.column is not None)
        held = {term: column_of(term) for term in still}

        def piece(first: int) -> tuple[slice, Any, Tangents]:
            part = slice(first, min(first + PIECE, samples))

            def column(term: Term, *, keep: bool = True) -> Array:
                return held[term][part]

            return part, *self.columns(constants, column)

        return side_by_side(piece, range(0, samples, PIECE), threads)


def _opaque(template: Term, constants: Array, column_of: ColumnOf) -> tuple[Any, Tangents]:
    def column(c: Array) -> Array:
        return column_of(with_constants(template, iter(c.tolist())), keep=False)

    values = np.array([column(c) for c in constants])
    tangents: Tangents = {}
    for place in range(constants.shape[1]):
        steps = _STEP * np.maximum(np.abs(constants[:, place]), 1e-2)
        shift = steps[:, None] * np.eye(constants.shape[1])[place]
        pairs = zip(constants + shift, constants - shift, strict=True)
        with np.errstate(all="ignore"):
            rise = np.array([column(up) - column(down) for up, down in pairs])
            tangents[place] = rise / (2.0 * steps[:, None])
    return values, tangents


def _apply(op: str, args: Sequence[Any]) -> Any:
    return np.asarray(PRIMITIVES[op].numpy(*args), dtype=np.float64)


def _chain(op: str, args: Sequence[Any], value: Any, inner: Sequence[Tangents]) -> Tangents:
    if op in _FLAT or not any(inner):
        return {place: 0.0 for slopes in inner for place in slopes}
    if op in _PARTIALS:
        partials = _PARTIALS[op](*args, value)
        return {
            place: partial * slope
            for partial, slopes in zip(partials, inner, strict=True)
            for place, slope in slopes.items()
        }
    return {
        place: _difference(op, args, k, slope)
        for k, slopes in enumerate(inner)
        for place, slope in slopes.items()
    }


def _difference(op: str, args: Sequence[Any], place: int, slope: Any) -> Any:
    """Return the derivative along one argument's tangent, by central differences."""
    size = max(float(np.max(np.abs(args[place]))), 1e-2)
    step = _STEP * size / (float(np.max(np.abs(slope))) or 1.0)
    up, down = list(args), list(args)
    up[place], down[place] = args[place] + step * slope, args[place] - step * slope
    return (_apply(op, up) - _apply(op, down)) / (2.0 * step)
