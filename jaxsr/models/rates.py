"""Rates of states as formulas, and the readings of accelerometers, ``d(v)``.

In [readings], ``d(v)`` stands for dv/dt, whatever the equation of v says: a force that is added to
the equation is then in the reading as well, and does not come back as a fault of the sensor.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from jaxsr.expressions import Term, to_text
from jaxsr.expressions.expansion import Monomial, contracted, expanded, factor_inside, without
from jaxsr.models.stepping import factorised, nothing

if TYPE_CHECKING:
    from jaxsr.models.model import Model

_RATE = re.compile(r"\bd\(\s*([A-Za-z_]\w*)\s*\)", re.ASCII)
_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
_PREFIX = "rate__"  # of the symbol that stands for a rate while a reading is parsed


def rate_symbols(text: str, states: tuple[str, ...]) -> tuple[str, dict[str, str]]:
    """Return a reading with a symbol in the place of every d(STATE), and the states by symbol."""
    found: dict[str, str] = {}

    def symbol(match: re.Match[str]) -> str:
        state = match.group(1)
        if state not in states:
            return match.group(0)  # the parser says what is wrong
        found[_PREFIX + state] = state
        return _PREFIX + state

    return _RATE.sub(symbol, text), found


def rate_terms(model: Model) -> dict[str, Term]:
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


def with_named_rates(model: Model) -> Model:
    """Return a model whose readings say d(v) where they repeat the right-hand side of v's equation.

    Repeated is what stands there as it is written, in whatever function, or, multiplied out, every
    product of it with one common factor: ``g*(u/m - k*q/m) + 9.81`` repeats ``(u - k*q)/m``. The
    factor is a number, or has parameters that are not in the equation: a force that is measured,
    m*d(v), is another thing. An equation that says no more than a number or another symbol is not
    looked for, nor one of a single product inside others: 2*q is no -2*d(q) where q' = -q.
    """
    if all(term.is_variable for term in model.reading_terms.values()):
        return model
    dynamic = set(model.dynamic_states)
    rates = {t: s for s, t in model.rate_terms.items() if s in dynamic and t.args}
    readings, defined = dict(model.readings), set(model.definitions)
    symbols = {rate: Term.variable(_PREFIX + state) for rate, state in rates.items()}
    for output, term in model.reading_terms.items():
        text = readings[output]
        if rate_symbols(text, model.states)[1] or not term.args:
            continue
        named = None
        if term in rates:
            readings[output] = f"d({rates[term]})"
            continue
        # definitions written out may be beyond all measure
        if rates and not defined & set(_NAME.findall(text)):
            named = _replaced(term, symbols)
        if named is None or named is term:
            named = _with_repeated_sums(model, term, symbols)
        if named is not None and named is not term:
            readings[output] = re.sub(rf"\b{_PREFIX}(\w+)", r"d(\1)", to_text(named))
    return replace(model, readings=readings) if readings != model.readings else model


def _with_repeated_sums(model: Model, term: Term, symbols: Mapping[Term, Term]) -> Term | None:
    """Return a reading with rates in the place of the sums that repeat them; None without any."""
    inside = term.variables
    repeated = [r for r in symbols if r.variables <= inside]
    whole, found = expanded(term) if repeated else None, dict[Monomial, float]()
    if whole is None:
        return None
    for rate in repeated:
        part = expanded(rate)
        if part is None or not 1 < len(part) <= len(whole):
            continue
        factor = factor_inside(whole, part, frozenset(model.parameters) - rate.variables)
        if factor is not None:
            whole = without(whole, part, factor)
            found[factor[0] | {(symbols[rate], 1.0)}] = factor[1]
    return contracted({**found, **whole}) if found else None


def _replaced(term: Term, symbols: Mapping[Term, Term]) -> Term:
    """Return a term with whole subtrees replaced; the same object where none occurs."""
    done: dict[Term, Term] = {}
    for node in term.upward():
        if node in symbols:
            done[node] = symbols[node]
            continue
        args = tuple(done.get(arg, arg) for arg in node.args)
        done[node] = node if args == node.args else Term(node.op, args)
    return done.get(term, term)


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
