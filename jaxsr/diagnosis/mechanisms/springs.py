"""Linear springs of a model: what stretches them, and where they pull."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.mechanisms.site import Site
from jaxsr.expressions import to_numpy, to_text
from jaxsr.expressions.term import Term
from jaxsr.models import Model
from jaxsr.models.force_factor import as_force


@dataclass(frozen=True)
class Spring:
    """A force -stiffness*deflection in an equation.

    Attributes
    ----------
    state : str
        The rate whose equation it is.
    deflection : Term
        A position, or a sum or difference of positions, each divided or multiplied by parameters
        where gears or levers stand between them, less the length at which the spring is at rest
        or what moves its other end.
    stiffness : Term
        Of parameters, with its sign.
    """

    state: str
    deflection: Term
    stiffness: Term


def springs_of(model: Model) -> list[Spring]:
    """Return the linear springs of a model, by equation."""
    parents = (model.kinematic_parent(s) for s in model.dynamic_states)
    positions = {q for q in parents if q is not None}
    return [s for state in model.dynamic_states for s in springs_in(model, state, positions)]


def springs_in(model: Model, state: str, positions: Collection[str]) -> list[Spring]:
    """Return what pulls in one equation in proportion to positions, or to rates as if they were.

    Parameters
    ----------
    state : str
        The rate whose equation it is.
    positions : collection of str
    """
    found = []
    for sign, summand in summands(model.equation_terms[state], 1.0):
        factors = list(_factors(summand))
        moving = [f for f, _ in factors if f.variables.intersection(positions)]
        if len(moving) != 1 or not _is_deflection(moving[0], model, positions):
            continue
        others = [(f, above) for f, above in factors if f != moving[0]]
        linear = (moving[0], True) in factors
        if linear and all(_constant(f, model) for f, _ in others):
            u, way = _oriented(moving[0], model)
            found.append(Spring(state, u, _product(others, -sign * way)))
    return found


def compared_to(model: Model, state: str) -> list[Term]:
    """Return what an equation takes from its state: T - 20, v - belt.

    Numbers, parameters or inputs.
    """
    gaps = (s.deflection for s in springs_in(model, state, {state}))
    ends = (g.args[1] for g in gaps if g.op == "sub" and g.args[0].is_variable)
    return list(dict.fromkeys(ends))


def force_of(model: Model, spring: Spring) -> str | None:
    """Return the stiffness of a spring as a force's, where it was read off a rate."""
    if model.base is None:
        force = as_force(model.force_factors, spring.state, spring.stiffness)
        return None if force is None else to_text(force)
    rows = model.entries(spring.state)
    if [state for state, _ in rows] != [spring.state]:
        return None
    text, ((_, factor),) = to_text(spring.stiffness), rows
    return f"({text})/({factor})" if factor else text


def summands(term: Term, sign: float) -> Iterator[tuple[float, Term]]:
    """Yield summands and their signs; a fraction of a sum is a sum of fractions."""
    if term.op in ("add", "sub"):
        yield from summands(term.args[0], sign)
        yield from summands(term.args[1], -sign if term.op == "sub" else sign)
    elif term.op == "neg":
        yield from summands(term.args[0], -sign)
    elif term.op == "div" and term.args[0].op in ("add", "sub", "neg"):
        for own, summand in summands(term.args[0], sign):
            yield own, Term.apply("div", summand, term.args[1])
    else:
        yield sign, term


def _factors(term: Term, above: bool = True) -> Iterator[tuple[Term, bool]]:
    """Yield factors and whether each stands above the fraction bar."""
    if term.op in ("mul", "div"):
        yield from _factors(term.args[0], above)
        yield from _factors(term.args[1], above == (term.op == "mul"))
    elif term.op == "neg":
        yield Term.constant(-1.0), True
        yield from _factors(term.args[0], above)
    else:
        yield term, above


def _constant(term: Term, model: Model) -> bool:
    return term.variables <= model.parameters.keys()


def _length(term: Term, model: Model) -> bool:
    """Whether a term may be the length of a spring, or what drives its other end."""
    return term.variables <= model.parameters.keys() | {*model.inputs}


def _is_deflection(term: Term, model: Model, positions: Collection[str]) -> bool:
    """Whether a term is a position, or a sum of positions with constant factors and lengths."""
    if term.is_variable:
        return term.name in positions
    if term.op in ("add", "sub"):
        moving = [a for a in term.args if not _length(a, model)]
        return bool(moving) and all(_is_deflection(a, model, positions) for a in moving)
    if term.op not in ("mul", "div"):
        return False
    first, second = term.args
    if term.op == "mul" and _constant(first, model):
        first, second = second, first
    return _constant(second, model) and _is_deflection(first, model, positions)


def unit_of(model: Model, deflection: Term) -> str | None:
    """Return the unit of a deflection: that of a position in it that has no factor."""
    if deflection.is_variable:
        return model.units.get(deflection.name)
    if deflection.op not in ("add", "sub"):
        return None
    known = (unit_of(model, a) for a in deflection.args)
    return next((unit for unit in known if unit is not None), None)


def _oriented(deflection: Term, model: Model) -> tuple[Term, float]:
    """Return a difference with its names in order, a length last, and the sign that this takes."""
    if deflection.op == "sub":
        first, second = deflection.args
        lengths = _length(first, model), _length(second, model)
        ordered = to_text(first) <= to_text(second) if lengths[0] == lengths[1] else lengths[1]
        if not ordered:
            return _less(second, first), -1.0
        return _less(first, second), 1.0
    return deflection, 1.0


def _less(first: Term, second: Term) -> Term:
    none = second.is_constant and second.value == 0.0
    return first if none else Term.apply("sub", first, second)


def _product(factors: Sequence[tuple[Term, bool]], sign: float) -> Term:
    units = [f.value for f, _ in factors if f.is_constant and abs(f.value) == 1.0]
    out = Term.constant(sign * float(np.prod(units)))
    for factor, above in factors:
        if factor.is_constant and abs(factor.value) == 1.0:
            continue
        if out.is_constant and abs(out.value) == 1.0 and above:
            out = factor if out.value > 0.0 else Term.apply("neg", factor)
        else:
            out = Term.apply("mul" if above else "div", out, factor)
    return out


def reach_of(site: Site, deflection: Term) -> float:
    """Return how far the spring is deflected to either side; 0 where it never changes sign."""
    every = site.model.parameters
    parameters = {n: every[n].value for n in deflection.variables & every.keys()}
    positions = sorted(deflection.variables - every.keys())
    deflected = to_numpy(deflection)
    signals = {n: site.signal(n) for n in positions}
    if all(v is not None for v in signals.values()):
        u = deflected({**signals, **parameters})
        low, high = np.quantile(u, [0.02, 0.98])
        return float(np.quantile(np.abs(u), 0.95)) if low < 0.0 < high else 0.0
    ranges = [site.scale.get(n) for n in positions]
    known = [r for r in ranges if r is not None and np.all(np.isfinite(r))]
    if len(known) < len(ranges):
        return 0.0
    if len(positions) == 1:
        ends = [float(deflected({positions[0]: known[0][k], **parameters})) for k in (0, -1)]
        return max(min(max(ends), -min(ends)), 0.0)
    still = {**dict.fromkeys(positions, 0.0), **parameters}
    rest = float(deflected(still))
    factors = [abs(float(deflected({**still, n: 1.0})) - rest) for n in positions]
    return float(min(f * 0.5 * (r[-1] - r[0]) for f, r in zip(factors, known, strict=True)))
