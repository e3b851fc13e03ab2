"""Landmarks of a law: the places, scales, frequencies and exponents that its writing holds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from jaxsr.expressions import Term, affine_slope, evaluate
from jaxsr.expressions.canonical import simplify
from jaxsr.expressions.normal_form import normal_form, summands

_SWITCHES = frozenset({"sign", "abs", "heaviside"})
_COMPARED = frozenset({"max", "min", "lt", "le", "gt", "ge"})
_SCALED = frozenset({"exp", "tanh", "atan", "sinh", "cosh"})


@dataclass(frozen=True)
class Landmarks:
    """Constants that stand inside a law, from which those of a mechanism are sought.

    Attributes
    ----------
    frequencies : mapping of str to tuple of float
        Variable to the slopes of the sines' arguments in it.
    values : tuple of float
        Places where something switches, scales of exponentials, broken exponents.
    """

    frequencies: Mapping[str, tuple[float, ...]]
    values: tuple[float, ...]

    @staticmethod
    def of(law: Term) -> Landmarks:
        """Read the landmarks off a law and off its normal form."""
        frequencies: dict[str, list[float]] = {}
        values: list[float] = []
        for node in {n for form in (law, normal_form(law)) for n in form.distinct() if n.args}:
            if node.op in ("sin", "cos"):
                for name, slope, _ in _lines(node.args[0]):
                    frequencies.setdefault(name, []).append(abs(slope))
            elif node.op in _SWITCHES:
                values += _zeros(node.args[0])
            elif node.op in _COMPARED:
                first, *others = node.args
                for other in others:
                    values += _zeros(Term("sub", (first, other)))
                values += [arg.value for arg in node.args if arg.is_constant]
            elif node.op in _SCALED:
                values += _scales(node.args[0])
            elif node.op == "pow" and node.args[1].is_constant:
                values.append(abs(node.args[1].value))
        found = {name: _distinct(slopes) for name, slopes in frequencies.items()}
        return Landmarks(found, _distinct([v for v in values if v]))


def _lines(term: Term) -> Iterator[tuple[str, float, float]]:
    """Yield the variable, slope and value at zero of a line in one variable."""
    term = simplify(term)
    if len(term.variables) != 1 or term.uses(frozenset({"piecewise"})):
        return
    (name,) = term.variables
    slope = affine_slope(term, name)
    if slope is not None and slope.is_constant and slope.value:
        yield name, slope.value, float(evaluate(term, {name: 0.0}))


def _zeros(term: Term) -> list[float]:
    return [-offset / slope for _, slope, offset in _lines(term)]


def _scales(term: Term) -> list[float]:
    """Return s where a summand of the argument is (x/s)**n."""
    found = []
    for part, coefficient in summands(term).items():
        if len(part.variables) != 1 or not coefficient:
            continue
        degree = part.args[1].value if part.op == "pow" and part.args[1].is_constant else 1.0
        found.append(abs(coefficient) ** (-1.0 / degree))
    return found


def _distinct(values: list[float]) -> tuple[float, ...]:
    """Leave out what repeats to six digits."""
    return tuple({float(f"{v:.6g}"): v for v in values}.values())


__all__ = ["Landmarks"]
