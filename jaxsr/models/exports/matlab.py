"""A model as a MATLAB function file."""

from __future__ import annotations

from collections.abc import Mapping

from jaxsr.expressions import Term
from jaxsr.models.exports.printers import Matlab
from jaxsr.models.exports.routine import renamed, routine
from jaxsr.models.exports.system import System, legend, one_line

_WORDS = frozenset(
    "break case catch classdef continue else elseif end for function global if otherwise parfor "
    "persistent return spmd switch try while "
    "t x u p dx y abs max min exp log sqrt sin cos tan asin acos atan atan2 sinh cosh tanh floor "
    "sign pi NaN Inf i j eps".split()
)
_STATEMENTS = ("piecewise",)  # branches are statements in MATLAB, and stand alone


def matlab_text(system: System, name: str) -> str:
    """Return ``NAME.m``: ``[dx, y] = NAME(t, x, u, p)``, for ``ode45`` and for Octave.

    Expressions are printed by SymPy's printer for Octave and MATLAB. A leading underscore, which
    MATLAB refuses, becomes ``v_``.
    """
    model = system.model
    names = {s: f"v{n}" if n.startswith("_") else n for s, n in _names(system).items()}
    values = "; ".join(repr(value) for value in system.values.values())
    head = [
        f"function [dx, y] = {name}(t, x, u, p)",
        f"%{name.upper()}  {one_line(model.name)}, written by jaxsr.",
        f"%   [dx, y] = {name}(t, x, u, p); u and p may be left out, p is then as below.",
        f"%   t: {legend(model, (model.time,))}",
        *(
            f"%   {array}: {legend(model, tuple(symbols))}"
            for array, symbols in (
                ("x", model.states),
                ("u", model.inputs),
                ("p", model.parameters),
                ("y", model.outputs),
            )
        ),
        *(f"%   {one_line(line, 100)}" for line in system.remarks),
        f"if nargin < 3, u = zeros({len(model.inputs)}, 1); end",
        f"if nargin < 4, p = [{values}]; end",
    ]
    both: dict[str, Term] = {f"dx {s}": term for s, term in system.rates.items()}
    both |= {f"y {s}": term for s, term in system.readings.items()}
    sizes = (f"dx = zeros({len(model.states)}, 1);", f"y = zeros({len(model.outputs)}, 1);")
    return "\n".join([*head, *sizes, *_body(system, names, both), "end", ""])


def _names(system: System) -> dict[str, str]:
    return renamed(system.model.symbols, _WORDS)


def _body(system: System, names: Mapping[str, str], terms: Mapping[str, Term]) -> list[str]:
    model, printer = system.model, Matlab()
    made = routine(terms, names, _STATEMENTS)
    places = {names[model.time]: "t"}
    for array, symbols in (("x", model.states), ("u", model.inputs), ("p", model.parameters)):
        places |= {names[symbol]: f"{array}({k + 1})" for k, symbol in enumerate(symbols)}
    lines = [f"{n} = {place};" for n, place in places.items() if n in made.used]
    lines += [printer.doprint(e, assign_to=n) for n, e in made.parts]
    counts = {"dx": 0, "y": 0}
    for label, expression in made.results:
        array = label.split(" ")[0]
        counts[array] += 1
        lines.append(f"{array}({counts[array]}) = {printer.doprint(expression)};")
    return lines
