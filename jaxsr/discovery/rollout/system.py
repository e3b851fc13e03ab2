"""A system of found equations as one NumPy function, its constants as arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.term import BOOLEAN, Term

_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
_MOST_MULTIPLIED = 5  # whole powers up to this are written as products


@dataclass(frozen=True)
class System:
    """Right-hand sides: for each simulated state, what is known plus weighed terms.

    Parameters
    ----------
    terms : mapping of str to sequence of Term
        States that are simulated; every other name is an input.
    known : mapping of str to Term
        Parts without free constants, such as the velocity of a displacement.
    """

    terms: Mapping[str, Sequence[Term]]
    known: Mapping[str, Term]

    @property
    def states(self) -> tuple[str, ...]:
        """Return the simulated states, in order."""
        return tuple(self.terms)

    def constants(self, coefficients: Mapping[str, Sequence[float]]) -> np.ndarray:
        """Return the free constants: for each state, each coefficient and the term's own."""
        out: list[float] = []
        for state, terms in self.terms.items():
            for weight, term in zip(coefficients[state], terms, strict=True):
                out += [float(weight), *inner(term)]
        return np.array(out)

    def unpacked(self, constants: np.ndarray) -> dict[str, list[tuple[Term, float, slice]]]:
        """Return (term, coefficient, its places in the constants) for each state."""
        out: dict[str, list[tuple[Term, float, slice]]] = {}
        place = 0
        for state, terms in self.terms.items():
            out[state] = []
            for term in terms:
                count = len(inner(term))
                values = iter(constants[place + 1 : place + 1 + count].tolist())
                moved = _with(term, values)
                out[state].append((moved, float(constants[place]), slice(place, place + 1 + count)))
                place += 1 + count
        return out

    def function(self) -> Callable[[Mapping[str, Any], Any], list[Any]]:
        """Return f(values by name, constants) -> rates of the states, as compiled Python.

        The source is written from terms, node by node; no text from outside enters it.
        """
        writer = _Writer()
        results, place = [], 0
        for state, terms in self.terms.items():
            parts = [writer.write(self.known[state], None)] if state in self.known else []
            for term in terms:
                count = len(inner(term))
                places = iter(range(place + 1, place + 1 + count))
                body = writer.write(term, places)
                parts.append(f"c[{place}] * {body}")
                place += 1 + count
            results.append(" + ".join(parts) or "0.0")
        lines = [*writer.lines, f"return [{', '.join(results)}]"]
        source = "def rates(v, c):\n" + "\n".join(f"    {line}" for line in lines)
        space: dict[str, Any] = dict(writer.functions)
        exec(compile(source, "<discovered equations>", "exec"), space)
        return space["rates"]


def inner(term: Term) -> list[float]:
    """Return a term's own free constants in preorder; whole numbers are taken as given."""
    if not term.args:
        return []
    return [n.value for n in term.walk() if n.is_constant and not n.value.is_integer()]


def _with(term: Term, values: Any) -> Term:
    if term.is_constant:
        return term if term.value.is_integer() else Term.constant(next(values))
    if not term.args:
        return term
    return Term.apply(term.op, *[_with(arg, values) for arg in term.args])


class _Writer:
    """Write terms as assignments, equal subtrees without free constants once."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.functions: dict[str, Any] = {}
        self._known: dict[Term, str] = {}

    def write(self, term: Term, places: Any) -> str:
        if term.is_constant:
            if places is None or term.value.is_integer():
                return repr(term.value)
            return f"c[{next(places)}]"
        if term.is_variable:
            return self._assign(term, f"v[{term.name!r}]", True)
        if term.op == BOOLEAN:
            return repr(bool(term.value))
        fixed = places is None or not any(
            n.is_constant and not n.value.is_integer() for n in term.walk()
        )
        if fixed and term in self._known:
            return self._known[term]
        args = [self.write(arg, places) for arg in term.args]
        return self._assign(term, self._call(term, args), fixed)

    def _call(self, term: Term, args: list[str]) -> str:
        if term.op in _INFIX:
            return f"{args[0]} {_INFIX[term.op]} {args[1]}"
        if term.op == "pow" and term.args[1].is_constant:
            power = term.args[1].value
            if power.is_integer() and 1 <= power <= _MOST_MULTIPLIED:
                return " * ".join([args[0]] * int(power))
        name = f"f_{term.op}"
        self.functions[name] = np.power if term.op == "pow" else PRIMITIVES[term.op].numpy
        return f"{name}({', '.join(args)})"

    def _assign(self, term: Term, text: str, fixed: bool) -> str:
        if fixed and term in self._known:
            return self._known[term]
        name = f"n{len(self.lines)}"
        self.lines.append(f"{name} = {text}")
        if fixed:
            self._known[term] = name
        return name
