"""Equations in SymPy as a model: symbols, functions of time and their derivatives become names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from jaxsr._result import InputError
from jaxsr.expressions import from_sympy, to_text
from jaxsr.models.model import Model, Parameter
from jaxsr.models.reading import build_model

_HEAD = ("name", "time", "input_hold", "sample_time")


def model_of(
    equations: Mapping[Any, Any], parameters: Mapping[Any, Any], document: Mapping[str, Any]
) -> Model:
    """Return the model of SymPy equations, see `Simulator.from_sympy`.

    Parameters
    ----------
    equations, parameters : mapping
    document : mapping
        The tables of a model file, with symbols and expressions where it has text.

    Raises
    ------
    InputError
        An expression is outside the grammar, or a table breaks a rule of model files.
    """
    rest = {key: value for key, value in document.items() if value is not None}
    states = [_name(state) for state in equations]
    head = {"states": states, "inputs": [_name(u) for u in rest.pop("inputs", ())]}
    head |= {key: rest.pop(key) for key in _HEAD if key in rest}
    readings = {_name(y): e for y, e in rest.pop("readings", {s: s for s in states}).items()}
    tables = {
        "model": {**head, "outputs": list(readings)},
        "equations": {_name(s): _text(e, f"equation of {s}") for s, e in equations.items()},
        "readings": {y: _text(e, f"reading {y}") for y, e in readings.items()},
        "parameters": {_name(p): _parameter(value) for p, value in parameters.items()},
        **{key: _named(value) for key, value in rest.items()},
    }
    if "inertia" in rest:
        tables["inertia"] = _inertia(rest["inertia"], states)
    return build_model({key: table for key, table in tables.items() if table}, "from_sympy")


def _name(symbol: Any) -> str:
    """Return the name of a symbol, of a function of time, or of what a derivative is of."""
    if isinstance(symbol, sympy.Derivative):
        symbol = symbol.expr
    if isinstance(symbol, AppliedUndef):
        return str(symbol.func)
    return str(symbol)


def _text(expression: Any, where: str) -> str:
    if isinstance(expression, str):
        return expression
    plain = sympy.sympify(expression)
    functions = {f: sympy.Symbol(str(f.func)) for f in plain.atoms(AppliedUndef)}
    derivatives = plain.atoms(sympy.Derivative)
    if derivatives:
        shown = next(iter(derivatives))
        remedy = "Put the state that is this rate in its place, as the kinematic equations do"
        raise InputError(f"{str(shown)[:80]} is a derivative", where, remedy)
    try:
        return to_text(from_sympy(plain.xreplace(functions)))
    except ValueError as error:
        raise InputError(str(error)[:120], where, "Use functions of model files") from None


def _parameter(value: Any) -> Any:
    """Return a row of [parameters].

    Raises
    ------
    InputError
        It is no value.
    """
    if isinstance(value, Parameter):
        row = {"value": value.value, "unit": value.unit, "bounds": value.bounds and [*value.bounds]}
        return {key: entry for key, entry in row.items() if entry is not None}
    triple: Any = value
    if isinstance(value, tuple | list) and len(triple) == 3:
        middle, low, high = (float(v) for v in triple)
        return {"value": middle, "bounds": [low, high]}
    if isinstance(value, Mapping):
        return dict(value)
    try:
        return float(value)
    except TypeError:
        remedy = "Give a number, (value, low, high), or a row of [parameters]"
        raise InputError(f"{value!r:.80} is no value", "parameters", remedy) from None


def _inertia(given: Any, states: list[str]) -> dict[str, dict[str, str]]:
    """Return the rows of [inertia], those of the identity left out.

    Raises
    ------
    InputError
        The matrix is not square in the states.
    """
    if isinstance(given, Mapping):
        return {
            _name(i): {_name(j): _text(e, f"inertia {i}") for j, e in row.items()}
            for i, row in given.items()
        }
    matrix = sympy.Matrix(given)
    if matrix.shape != (len(states), len(states)):
        what = f"a mass matrix of shape {matrix.shape} for {len(states)} states"
        raise InputError(what, "inertia", "Give a row and a column for each state, in their order")
    rows: dict[str, dict[str, str]] = {}
    for i, state in enumerate(states):
        row = {j: matrix[i, k] for k, j in enumerate(states) if matrix[i, k] != 0}
        if row != {state: sympy.Integer(1)}:
            rows[state] = {j: _text(entry, f"inertia {state}") for j, entry in row.items()}
    return rows


def _named(table: Any) -> Any:
    """Return a table whose keys are names."""
    return (
        {_name(key): value for key, value in table.items()} if isinstance(table, Mapping) else table
    )
