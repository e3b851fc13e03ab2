"""A model as a Modelica class."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import sympy

from jaxsr.expressions import Term
from jaxsr.models.exports.printers import Modelica
from jaxsr.models.exports.routine import Routine, renamed, routine
from jaxsr.models.exports.system import System, one_line
from jaxsr.models.model import Event, Model

_WORDS = frozenset(
    "algorithm and annotation block break class connect connector constant constrainedby der "
    "discrete each else elseif elsewhen encapsulated end enumeration equation expandable extends "
    "external false final flow for function if import impure in initial inner input loop model "
    "not operator or outer output package parameter partial protected public pure record "
    "redeclare replaceable return stream then true type when while within time pre reinit delay "
    "abs sign sqrt max min floor sin cos tan asin acos atan atan2 sinh cosh tanh exp log "
    "Real".split()
)
_POWER = r"[A-Za-z]+-?[0-9]*"
_PLAIN_UNIT = re.compile(rf"(1|{_POWER}(\.{_POWER})*)(/{_POWER})?")


def modelica_text(system: System, name: str) -> str:
    """Return a Modelica class: equations of motion as they stand, with delays and events.

    A mass matrix stays where it is; the tool that compiles the class solves for the rates.
    """
    model = system.model
    names = renamed((*model.symbols, *model.outputs), _WORDS)
    names[model.time] = "time"
    delayed = {u: f"{names[u]}_delayed" for u in model.inputs if model.delays.get(u, 0.0) != 0.0}
    made = routine(_formulas(system), {**names, **delayed})
    lines = [f'model {name} "{one_line(model.name)}, written by jaxsr"']
    lines += [f"  {line}" for line in _declared(model, names)]
    lines += [f"  Real {part};" for part in (*delayed.values(), *(n for n, _ in made.parts))]
    lines.append("equation")
    lines += [f"  {line}" for line in _equations(system, names, made, delayed)]
    lines += [f"  {line}" for event in model.events for line in _event(model, event, names)]
    lines += [f"  // {one_line(line, 90)}" for line in _left_out(system)]
    return "\n".join([*lines, f"end {name};", ""])


def _declared(model: Model, names: Mapping[str, str]) -> list[str]:
    units = model.units
    lines = [
        f"parameter Real {names[n]}{_unit(p.unit or units.get(n))} = {float(p.value)!r};"
        for n, p in model.parameters.items()
    ]
    lines += [f"input Real {names[u]}{_unit(units.get(u))};" for u in model.inputs]
    lines += [f"output Real {names[y]}{_unit(units.get(y))};" for y in model.outputs]
    for state in model.states:
        start = model.initial.get(state)
        fixed = [f"start = {float(start)!r}", "fixed = true"] if _is_number(start) else []
        lines.append(f"Real {names[state]}{_unit(units.get(state), fixed)};")
    return lines


def _formulas(system: System) -> dict[str, Term]:
    """Return every formula of the class by what it is for."""
    model = system.model
    terms = {f"equation {state}": model.equation_terms[state] for state in model.states}
    terms |= {
        f"inertia {i} {j}": term
        for i, row in model.inertia_terms.items()
        for j, term in row.items()
    }
    return terms | {f"reading {output}": term for output, term in system.readings.items()}


def _equations(
    system: System, names: Mapping[str, str], made: Routine, delayed: Mapping[str, str]
) -> Iterable[str]:
    model, printer = system.model, Modelica()
    printed = {label: printer.doprint(e) for label, e in made.results}
    for symbol, name in delayed.items():
        yield f"{name} = delay({names[symbol]}, {_delay(model, symbol, names)});"
    for name, part in made.parts:
        yield f"{name} = {printer.doprint(part)};"
    for state in model.states:
        left = f"der({names[state]})"
        if state in model.inertia_terms:
            row = model.inertia_terms[state]
            left = " + ".join(f"({printed[f'inertia {state} {j}']})*der({names[j]})" for j in row)
        yield f"{left} = {printed[f'equation {state}']};"
    for output in system.readings:
        reading = printed[f"reading {output}"]
        if model.delays.get(output, 0.0) != 0.0:
            reading = f"delay({reading}, {_delay(model, output, names)})"
        yield f"{names[output]} = {reading};"


def _event(model: Model, event: Event, names: Mapping[str, str]) -> list[str]:
    """Return the clause of a jump: from the left limits, ``pre`` as Modelica says."""
    crossing = _formula(model.term(event.when), names)
    signs = {-1: ("<=",), 1: (">=",), 0: ("<=", ">=")}[event.direction]
    tests = ", ".join(f"{crossing} {sign} 0" for sign in signs)
    before = {**names, **{s: f"pre({names[s]})" for s in model.states}}
    resets = [
        f"  reinit({names[s]}, {_formula(model.term(text), before)});"
        for s, text in event.reset.items()
    ]
    either = f"{{{tests}}}" if len(signs) > 1 else tests
    return [f"when {either} then", *resets, "end when;"]


def _formula(term: Term, names: Mapping[str, str]) -> str:
    """Return one expression by itself: clauses take no variables of their own."""
    made = routine({"": term}, names)
    expression: Any = made.results[0][1]
    for name, part in reversed(made.parts):
        expression = expression.xreplace({sympy.Symbol(name, real=True): part})
    return str(Modelica().doprint(expression))


def _delay(model: Model, symbol: str, names: Mapping[str, str]) -> str:
    value = model.delays[symbol]
    return names[value] if isinstance(value, str) else repr(float(value))


def _unit(unit: str | None, more: Iterable[str] = ()) -> str:
    """Return the modifiers of a declaration; N*s/m is written N.s/m, and m/s**2 as m/s2."""
    text = (unit or "").replace("**", "").replace("^", "").replace("*", ".")
    parts = [f'unit = "{text}"'] if _PLAIN_UNIT.fullmatch(text) else []
    parts += more
    return f"({', '.join(parts)})" if parts else ""


def _is_number(value: object) -> bool:
    return isinstance(value, int | float)


def _left_out(system: System) -> list[str]:
    """Return the remarks on what this language does not hold."""
    model = system.model
    clocks = [f"{name} is read at the time {text}" for name, text in model.clock.items()]
    files = [f"{name} differs by recording" for name in model.per_recording]
    return [f"Not in here: {line}." for line in (*clocks, *files)]
