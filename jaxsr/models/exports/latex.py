"""A model as equations in LaTeX."""

from __future__ import annotations

from typing import Any

import sympy

from jaxsr.expressions import Term, to_sympy
from jaxsr.models.exports.system import System, one_line

DIGITS = 4
"""Significant digits of the numbers that stand in equations."""


def latex_text(system: System, name: str) -> str:
    """Return an ``align*`` of the equations of motion, mass matrix on the left, and readings."""
    lines = [*_equations(system), *_readings(system)]
    rows = " \\\\\n".join(f"  {left} &= {right}" for left, right in lines)
    remarks = [one_line(system.model.name), *(one_line(line, 98) for line in system.remarks)]
    comments = "".join(f"% {line}\n" for line in remarks)
    return f"{comments}\\begin{{align*}}\n{rows}\n\\end{{align*}}\n"


def _equations(system: System) -> list[tuple[str, str]]:
    model = system.model
    rates = {s: sympy.Symbol(rf"\dot{{{_name(s)}}}") for s in model.states}
    rows = []
    for state in model.states:
        left: Any = rates[state]
        if state in model.inertia_terms:
            row = model.inertia_terms[state].items()
            left = sum((_rounded(entry) * rates[j] for j, entry in row), sympy.Integer(0))
        rows.append((sympy.latex(left), sympy.latex(_rounded(model.equation_terms[state]))))
    return rows


def _readings(system: System) -> list[tuple[str, str]]:
    return [(_name(y), sympy.latex(_rounded(term))) for y, term in system.readings.items()]


def _name(symbol: str) -> str:
    return sympy.latex(sympy.Symbol(symbol))


def _rounded(term: Term) -> Any:
    expression = to_sympy(term)
    return expression.xreplace({n: sympy.Float(n, DIGITS) for n in expression.atoms(sympy.Float)})
