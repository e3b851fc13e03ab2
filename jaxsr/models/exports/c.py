"""A model as two C99 functions."""

from __future__ import annotations

from collections.abc import Mapping

from jaxsr.expressions import Term
from jaxsr.models.exports.printers import C
from jaxsr.models.exports.routine import renamed, routine
from jaxsr.models.exports.system import System, legend, one_line

_WORDS = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while "
    "t x u p dx y fabs fmax fmin pow exp log sqrt sin cos tan asin acos atan atan2 sinh cosh tanh "
    "floor NAN INFINITY M_PI M_E".split()
)


def c_text(system: System, name: str) -> str:
    """Return C99 source: the parameters' values, ``NAME_rates`` and ``NAME_readings``.

    Expressions are printed by SymPy's C99 printer.
    """
    model = system.model
    values = [repr(value) for value in system.values.values()] or ["0.0"]
    head = [
        f"/* {one_line(model.name)}, written by jaxsr. C99; link with -lm.",
        " *",
        f" * t: {legend(model, (model.time,))}",
        *(
            f" * {array}[{len(names)}]: {legend(model, tuple(names))}"
            for array, names in (
                ("x", model.states),
                ("u", model.inputs),
                ("p", model.parameters),
                ("y", model.outputs),
            )
        ),
        *(f" * {one_line(line, 100)}" for line in system.remarks),
        " */",
        "#include <math.h>",
        "",
        f"const double {name}_parameters[{len(values)}] = {{{', '.join(values)}}};",
    ]
    rates = _function(system, f"{name}_rates", "dx", "dx/dt", system.rates)
    readings = _function(system, f"{name}_readings", "y", "What the sensors read", system.readings)
    return "\n".join([*head, "", *rates, "", *readings, ""])


def _function(
    system: System, name: str, result: str, about: str, terms: Mapping[str, Term]
) -> list[str]:
    model, printer = system.model, C()
    names = renamed(model.symbols, _WORDS)
    made = routine(terms, names)
    places = {names[model.time]: "t"}
    for array, symbols in (("x", model.states), ("u", model.inputs), ("p", model.parameters)):
        places |= {names[symbol]: f"{array}[{k}]" for k, symbol in enumerate(symbols)}
    body = ["(void)t; (void)x; (void)u; (void)p;"]
    body += [f"const double {n} = {place};" for n, place in places.items() if n in made.used]
    body += [f"const double {n} = {printer.doprint(e)};" for n, e in made.parts]
    body += [f"{result}[{k}] = {printer.doprint(e)};" for k, (_, e) in enumerate(made.results)]
    arguments = f"double t, const double *x, const double *u, const double *p, double *{result}"
    lines = [f"    {line}" for text in body for line in text.split("\n")]
    return [f"/* {about}. */", f"void {name}({arguments})", "{", *lines, "}"]
