"""Rates of states as formulas, and the readings of accelerometers, ``d(v)``.

In [readings], ``d(v)`` stands for dv/dt, whatever the equation of v says: a force that is added to
the equation is then in the reading as well, and does not come back as a fault of the sensor.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from jaxsr.expressions import Term
from jaxsr.models.stepping import factorised, nothing
from jaxsr.models.structure import Structure

_RATE = re.compile(r"\bd\(\s*([A-Za-z_]\w*)\s*\)", re.ASCII)
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
PREFIX = "rate__"  # of the symbol that stands for a rate while a reading is parsed


def rate_symbols(text: str, states: tuple[str, ...]) -> tuple[str, dict[str, str]]:
    """Return a reading with a symbol in the place of every d(STATE), and the states by symbol."""
    found: dict[str, str] = {}

    def symbol(match: re.Match[str]) -> str:
        state = match.group(1)
        if state not in states:
            return match.group(0)  # the parser says what is wrong
        found[PREFIX + state] = state
        return PREFIX + state

    return _RATE.sub(symbol, text), found


def rate_terms(model: Structure) -> dict[str, Term]:
    r"""Return dx/dt of every state; with a mass matrix M, the solution of M dx/dt = f.

    .. math:: \sum_j M_{ij} \dot x_j = f_i

    is solved by elimination for the states that have a row, the rates of the others inserted.
    """
    rates = dict(model.equation_terms)
    rows = tuple(s for s in model.states if s in model.inertia)
    if not rows:
        return rates
    matrix: list[list[float | _Formula]] = [[0.0 for _ in rows] for _ in rows]
    forces = []
    for i, row in enumerate(rows):
        force = _Formula(rates[row])
        for column, mass in model.inertia_terms[row].items():
            if column not in rows:
                force = force - _Formula(mass) * _Formula(rates[column])
            elif not (mass.is_constant and mass.value == 0.0):
                matrix[i][rows.index(column)] = _Formula(mass)
        forces.append(force)
    solved = factorised(matrix)(tuple(forces))
    return {**rates, **{s: f.term for s, f in zip(rows, solved, strict=True)}}


@dataclass(frozen=True)
class _Formula:
    """A term that can be calculated with."""

    term: Term

    def __sub__(self, other: _Formula) -> _Formula:
        return _Formula(Term.apply("sub", self.term, other.term))

    def __rsub__(self, other: float) -> _Formula:
        assert nothing(other)
        return _Formula(Term.apply("neg", self.term))

    def __mul__(self, other: _Formula) -> _Formula:
        return _Formula(Term.apply("mul", self.term, other.term))

    def __truediv__(self, other: _Formula | float) -> _Formula:
        if not isinstance(other, _Formula):  # the pivot of a singular matrix
            return _Formula(Term.constant(float(other)))
        if other.term.is_constant and other.term.value == 1.0:
            return self
        return _Formula(Term.apply("div", self.term, other.term))
