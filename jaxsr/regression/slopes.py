"""Columns of terms and their exact derivatives with respect to inner constants.

One pass over the tree carries value and tangents together (forward differentiation); terms that
differ in their constants alone share a pass.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array

# Central differences at the cube root of the float64 rounding: error about 1e-11.
_STEP = 6e-6

Values = list[Any]
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
_FLAT = frozenset({"sign", "floor", "heaviside", "lt", "le", "gt", "ge", "eq", "ne"}) | {
    "and",
    "or",
    "not",
}


def is_whole_exponent(term: Term, place: int) -> bool:
    """Tell whether an argument is a whole exponent: it is part of the form, not a constant."""
    arg = term.args[place]
    return term.op == "pow" and place == 1 and arg.is_constant and float(arg.value).is_integer()


def constants_of(term: Term) -> list[float]:
    """Return the inner constants that may move, in preorder; whole exponents stay whole.

    A term that is itself a constant has none: its coefficient says it all.
    """
    return [leaf.value for leaf in _free(term)] if term.args else []


def with_constants(term: Term, values: Iterator[float]) -> Term:
    """Return the term with its movable constants taken from ``values``, in preorder."""
    if not term.args:
        return term
    args = []
    for place, arg in enumerate(term.args):
        if arg.is_constant and not is_whole_exponent(term, place):
            args.append(Term.constant(next(values)))
        else:
            args.append(with_constants(arg, values))
    return Term.apply(term.op, *args)


def _free(term: Term) -> Iterator[Term]:
    if term.op == "constant":
        yield term
    for place, arg in enumerate(term.args):
        if not is_whole_exponent(term, place):
            yield from _free(arg)


@dataclass(frozen=True, slots=True)
class Node:
    """One step of a form: a constant's place, a column that does not move, or a primitive."""

    op: str
    place: int = -1
    column: Term | None = None
    args: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Form:
    """A term with its constants left open, as a list of steps in the order of evaluation."""

    nodes: tuple[Node, ...]
    constants: int

    @classmethod
    def of(cls, term: Term) -> Form:
        """Read the form of a term; constants are counted in preorder."""
        nodes: list[Node] = []
        count = 0

        def visit(term: Term, movable: bool) -> int:
            nonlocal count
            if term.is_constant and movable:
                nodes.append(Node("constant", place=count))
                count += 1
            elif next(_free(term), None) is None or not movable:
                nodes.append(Node("column", column=term))
            else:
                args = tuple(
                    visit(arg, not is_whole_exponent(term, k)) for k, arg in enumerate(term.args)
                )
                nodes.append(Node(term.op, args=args))
            return len(nodes) - 1

        visit(term, bool(term.args))
        return cls(tuple(nodes), count)

    def columns(
        self, constants: Array, column_of: Callable[[Term], Array], *, tangents: bool = True
    ) -> tuple[Any, Tangents]:
        """Return values (sets, samples) for sets of constants (sets, constants), and tangents.

        Tangents map the place of a constant to d value / d constant. What is not finite stays so.
        """
        values: Values = []
        slopes: list[Tangents] = []
        with np.errstate(all="ignore"):
            for node in self.nodes:
                if node.op == "constant":
                    values.append(constants[:, node.place, None])
                    slopes.append({node.place: 1.0} if tangents else {})
                elif node.column is not None:
                    values.append(column_of(node.column))
                    slopes.append({})
                else:
                    args = [values[k] for k in node.args]
                    value = _apply(node.op, args)
                    values.append(value)
                    slopes.append(_chain(node.op, args, value, [slopes[k] for k in node.args]))
        return values[-1], slopes[-1]


def _apply(op: str, args: Sequence[Any]) -> Any:
    function = PRIMITIVES[op].numpy
    if op in _PARTIALS or op in _FLAT or op in ("max", "min", "piecewise"):
        return np.asarray(function(*args), dtype=np.float64)
    # A primitive that is not known to work element by element sees one recording's column.
    whole = np.broadcast_arrays(*args)
    rows = [np.atleast_2d(arg) for arg in whole]
    out = [np.asarray(function(*row), dtype=np.float64) for row in zip(*rows, strict=True)]
    return np.array([np.broadcast_to(row, rows[0].shape[1:]) for row in out])


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
