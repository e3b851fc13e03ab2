"""A model as equations in LaTeX."""

from __future__ import annotations

from typing import Any

import sympy

from jaxsr.expressions import to_sympy
from jaxsr.models.exports.system import System, one_line

DIGITS = 4
"""Significant digits of the numbers that stand in equations."""


def latex_text(system: System, name: str) -> str:
    """Return the file of a model in LaTeX."""
    return model_latex(system)


def model_latex(system: System, digits: int = DIGITS) -> str:
    """Return an ``align*`` of the equations of motion, mass matrix on the left, and readings."""
    lines = [*_equations(system, digits), *_readings(system, digits)]
    rows = " \\\\\n".join(f"  {left} &= {right}" for left, right in lines)
    remarks = [one_line(system.model.name), *(one_line(line, 98) for line in system.remarks)]
    comments = "".join(f"% {line}\n" for line in remarks)
    return f"{comments}\\begin{{align*}}\n{rows}\n\\end{{align*}}\n"


def rounded_latex(expression: Any, digits: int = DIGITS) -> str:
    """Return a SymPy expression in LaTeX, its numbers to so many significant digits."""
    numbers = {n: sympy.Float(n, digits) for n in expression.atoms(sympy.Float)}
    return sympy.latex(expression.xreplace(numbers))


def _equations(system: System, digits: int) -> list[tuple[str, str]]:
    model = system.model
    rates = {s: sympy.Symbol(rf"\dot{{{_name(s)}}}") for s in model.states}
    rows = []
    for state in model.states:
        left: Any = rates[state]
        if state in model.inertia_terms:
            row = model.inertia_terms[state].items()
            left = sum((to_sympy(entry) * rates[j] for j, entry in row), sympy.Integer(0))
        right = to_sympy(model.equation_terms[state])
        rows.append((rounded_latex(left, digits), rounded_latex(right, digits)))
    return rows


def _readings(system: System, digits: int) -> list[tuple[str, str]]:
    readings = system.readings.items()
    return [(_name(y), rounded_latex(to_sympy(term), digits)) for y, term in readings]


def _name(symbol: str) -> str:
    return sympy.latex(sympy.Symbol(symbol))
