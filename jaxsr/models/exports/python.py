"""A model as a Python file of its own, for NumPy, JAX or SymPy."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from jaxsr.expressions import Term
from jaxsr.models.exports.printers import Jax, Numpy, Plain
from jaxsr.models.exports.routine import renamed, routine
from jaxsr.models.exports.system import System, legend, one_line

_WORDS = frozenset("t x u p numpy jax sympy parameters rates readings states inputs".split())
_GRAMMAR = (
    *("Abs", "And", "Eq", "Heaviside", "Max", "Min", "Ne", "Not", "Or", "Piecewise", "acos"),
    *("asin", "atan", "atan2", "cos", "cosh", "exp", "floor", "log", "nan", "pi", "sign", "sin"),
    *("sinh", "sqrt", "symbols", "tan", "tanh"),
)


def numpy_text(system: System, name: str) -> str:
    """Return a file with ``rates`` and ``readings`` on NumPy arrays."""
    return _array_text(system, "numpy", Numpy())


def jax_text(system: System, name: str) -> str:
    """Return a file with ``rates`` and ``readings`` in JAX."""
    return _array_text(system, "jax.numpy", Jax({"fully_qualified_modules": True}))


def sympy_text(system: System, name: str) -> str:
    """Return a file with ``rates`` and ``readings`` as SymPy expressions by symbol or name."""
    model, printer = system.model, Plain()
    names = renamed(model.symbols, {"parameters", "rates", "readings", *_GRAMMAR})
    both = {f"rates {s}": term for s, term in system.rates.items()}
    both |= {f"readings {y}": term for y, term in system.readings.items()}
    made = routine(both, names)
    symbols = [names[s] for s in model.symbols]
    lines = [
        f'{", ".join(symbols)} = symbols("{" ".join(symbols)}", real=True)',
        f"parameters = {{{', '.join(f'{names[n]}: {v!r}' for n, v in system.values.items())}}}",
        *(f"{n} = {printer.doprint(e)}" for n, e in made.parts),
    ]
    for table in ("rates", "readings"):
        lines.append(f"{table} = {{")
        for label, expression in made.results:
            kind, _, key = label.partition(" ")
            if kind == table:
                shown = names[key] if table == "rates" else repr(key)
                lines.append(f"    {shown}: {printer.doprint(expression)},")
        lines.append("}")
    called = set(re.findall(r"[A-Za-z]\w*", "\n".join(lines)))
    imported = ", ".join(name for name in _GRAMMAR if name in called)
    return "\n".join([*_head(system), f"from sympy import {imported}", "", *lines, ""])


def _head(system: System) -> list[str]:
    model = system.model
    return [f'"""{one_line(model.name)}, written by jaxsr."""'] + [
        f"# {one_line(line, 98)}" for line in system.remarks
    ]


def _array_text(system: System, module: str, printer: Any) -> str:
    model = system.model
    tables = {name: tuple(getattr(model, name)) for name in ("states", "inputs", "outputs")}
    lines = [
        *_head(system),
        f"import {module}",
        "",
        *(f"{name} = {names!r}" for name, names in tables.items()),
        f"parameters = {system.values!r}",
    ]
    for name, terms, about in (
        ("rates", system.rates, f"dx/dt, shape of x: {legend(model, model.states)}"),
        ("readings", system.readings, f"What the sensors read: {legend(model, model.outputs)}"),
    ):
        lines += ["", "", *_function(system, (name, about, module), terms, printer)]
    return "\n".join([*lines, ""])


def _function(
    system: System, head: tuple[str, str, str], terms: Mapping[str, Term], printer: Any
) -> list[str]:
    model, (name, about, module) = system.model, head
    names = renamed(model.symbols, _WORDS)
    made = routine(terms, names)
    places = {names[model.time]: "t"}
    for array, symbols in (("x", model.states), ("u", model.inputs)):
        places |= {names[symbol]: f"{array}[{k}]" for k, symbol in enumerate(symbols)}
    places |= {names[symbol]: f"p[{symbol!r}]" for symbol in model.parameters}
    body = [f'"""{one_line(about, 90)}."""']
    body += [f"{n} = {place}" for n, place in places.items() if n in made.used and n != place]
    body += [f"{n} = {printer.doprint(e)}" for n, e in made.parts]
    printed = ", ".join(f"({printer.doprint(e)}) + like" for _, e in made.results)
    body += [f"like = 0.0 * {module}.asarray(x)[0]", f"return {module}.stack([{printed}])"]
    return [f"def {name}(t, x, u=(), p=parameters):", *(f"    {line}" for line in body)]
