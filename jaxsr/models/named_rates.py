"""Readings of accelerometers that repeat an equation, rewritten as ``d(v)``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

from jaxsr.expressions import Term, to_text
from jaxsr.expressions.expansion import Monomial, contracted, expanded, factor_inside, without
from jaxsr.models.model import Model
from jaxsr.models.rates import PREFIX, rate_symbols

_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


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
    symbols = {rate: Term.variable(PREFIX + state) for rate, state in rates.items()}
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
            readings[output] = re.sub(rf"\b{PREFIX}(\w+)", r"d(\1)", to_text(named))
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
