"""Unit checks of a model file, in dimensions."""

from __future__ import annotations

from typing import Any

from jaxsr._result import InputError
from jaxsr.expressions import Term
from jaxsr.expressions.printing import excerpt
from jaxsr.expressions.term import BOOLEAN
from jaxsr.expressions.unit_text import dimensionality as dimension
from jaxsr.models.structure import Structure

# Functions whose argument must have no dimension, or loses it.
_SCALE_FREE = frozenset(
    "sin cos tan asin acos atan atan2 sinh cosh tanh exp log sign heaviside".split()
)
# A whole signature of dimensions; None stands for "not known" and silences the check.
Dimension = Any
Met = dict[tuple[Term, bool], Dimension]
"""Units of terms, literals read inside a function or not."""


def check_units(model: Structure, source: str) -> None:
    """Check every expression whose symbols all have units.

    An equation of state x must have the unit of x per second; with a row in [inertia], the
    unit of that row's entries times their states per second.

    Raises
    ------
    InputError
        A unit cannot be read, or two sides of an equation disagree.
    """
    known: dict[str, Dimension] = {}
    for name, text in model.units.items():
        known[name] = dimension(text, f"{source} [units] {name}")
    for name, parameter in model.parameters.items():
        if parameter.unit is not None:
            known[name] = dimension(parameter.unit, f"{source} [parameters] {name}")
    second = dimension("s")
    met: Met = {}
    for state, term in model.equation_terms.items():
        where = f"{source} [equations] {state}"
        found = unit_of(term, known, where, met=met)
        for column, entry in model.inertia_terms.get(state, {state: None}).items():
            inertia = (
                unit_of(entry, known, f"{source} [inertia] {state}", met=met)
                if entry
                else dimension("")
            )
            rate = known.get(column)
            if found is None or inertia is None or rate is None:
                continue
            if found != inertia * rate / second:
                raise InputError(
                    f"the right-hand side has dimension {found}, "
                    f"but the left-hand side {inertia * rate / second}",
                    where,
                    "Check [units] and the parameters' units",
                )
    for output, term in model.reading_terms.items():
        found = unit_of(term, known, f"{source} [readings] {output}")
        if found is not None and output in known and known[output] != found:
            raise InputError(
                f"the reading has dimension {found}, but {output} is declared {known[output]}",
                f"{source} [readings] {output}",
                "Check [units] and the parameters' units",
            )


def known_dimensions(model: Structure) -> dict[str, Dimension]:
    """Return the dimensions of the symbols that have a unit, time among them."""
    known = {name: dimension(text) for name, text in model.units.items()}
    known |= {n: dimension(p.unit) for n, p in model.parameters.items() if p.unit is not None}
    known.setdefault(model.time, dimension("s"))
    return known


def unit_of(
    term: Term,
    known: dict[str, Dimension],
    where: str = "",
    argument: bool = False,
    met: Met | None = None,
) -> Dimension:
    """Return the dimension of a term, or None where a symbol has none declared.

    Literal numbers are dimensionless as factors and fit anything as summands. In the argument
    of a function (`argument` true) a literal factor carries a unit that nobody wrote down, as
    the 2.0 of sin(2.0*t) does: the product is not known. `met` holds subtrees met before with
    the same `known`, and is filled on the way.
    """
    met = {} if met is None else met
    # Arguments first, without recursion: a formula may be deeper than Python's stack.
    stack = [(term, argument)]
    while stack:
        node, within = stack[-1]
        if (node, within) in met:
            stack.pop()
            continue
        inside = within or node.op in _SCALE_FREE
        waiting = [(arg, inside) for arg in node.args if (arg, inside) not in met]
        if waiting:
            stack.extend(reversed(waiting))
            continue
        stack.pop()
        parts = [met[arg, inside] for arg in node.args]
        met[node, within] = _unit_of(node, parts, known, where, within)
    return met[term, argument]


def _unit_of(
    term: Term, parts: list[Dimension], known: dict[str, Dimension], where: str, argument: bool
) -> Dimension:
    if term.is_constant:
        return None if argument else dimension("")
    if term.is_variable:
        return known.get(term.name)
    if term.op == BOOLEAN:
        return dimension("")
    if term.op in ("add", "sub", "max", "min", "lt", "le", "gt", "ge", "eq", "ne"):
        return _same(term, list(zip(term.args, parts, strict=True)), where)
    if term.op == "piecewise":
        return _same(term, list(zip(term.args[::2], parts[::2], strict=True)), where)
    if term.op == "atan2":
        _same(term, list(zip(term.args, parts, strict=True)), where)
        return dimension("")
    if term.op in ("neg", "abs", "floor"):
        return parts[0]
    if term.op in ("sign", "heaviside", "and", "or", "not"):
        return dimension("")
    if term.op == "pow" and parts[0] is not None:
        return _power(term, parts, where)
    if None in parts:
        return None
    if term.op == "mul":
        return parts[0] * parts[1]
    if term.op == "div":
        return parts[0] / parts[1]
    if term.op == "sqrt":
        root = parts[0]
        return None if root is None else root**0.5
    if parts[0] != dimension(""):
        raise InputError(
            f"{excerpt(term)}: {term.op} of dimension {parts[0]}", where, "Make it dimensionless"
        )
    return dimension("")


def _power(term: Term, parts: list[Dimension], where: str) -> Dimension:
    exponent, base = term.args[1], parts[0]
    assert base is not None
    if exponent.is_constant:
        return base**exponent.value
    if parts[1] is not None and parts[1] != dimension(""):
        what = f"{excerpt(term)}: the power has a unit"
        raise InputError(what, where, "Make the power dimensionless")
    return dimension("") if parts[0] == parts[1] == dimension("") else None


def _same(term: Term, pairs: list[tuple[Term, Dimension]], where: str) -> Dimension:
    # The first variable met tells a quantity from a number; a model's terms share large parts.
    quantities = [
        (arg, unit) for arg, unit in pairs if any(node.is_variable for node in arg.distinct())
    ]
    if any(unit is None for _, unit in quantities):
        return None
    for arg, unit in quantities[1:]:
        if unit != quantities[0][1]:
            raise InputError(
                f"{excerpt(quantities[0][0])!r} has dimension {quantities[0][1]} but "
                f"{excerpt(arg)!r} has {unit}",
                where,
                "Check [units] and the parameters' units",
            )
    return quantities[0][1] if quantities else dimension("")
