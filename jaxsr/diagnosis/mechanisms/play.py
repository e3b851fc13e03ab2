"""Play in a spring that the model has: between its ends the spring does not pull."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.mechanisms.site import Site, Threshold
from jaxsr.expressions import to_numpy, to_text
from jaxsr.expressions.term import Term
from jaxsr.models import Model
from jaxsr.models.force_factor import as_force

SHARES = (0.05, 0.25)
"""Half of the play that estimation starts from, in units of the deflection's 95 % quantile."""


@dataclass(frozen=True)
class Spring:
    """A force -stiffness*deflection in an equation.

    Attributes
    ----------
    state : str
        The rate whose equation it is.
    deflection : Term
        A position, or a sum or difference of positions, each divided or multiplied by parameters
        where gears or levers stand between them.
    stiffness : Term
        Of parameters, with its sign.
    """

    state: str
    deflection: Term
    stiffness: Term


def play(site: Site) -> Iterator[Candidate]:
    r"""Yield play in the springs of an equation of motion.

    A spring -k u with the deflection u becomes

    .. math:: -k\,(\max(u - b, 0) + \min(u + b, 0)) = -k\,u + k \max(\min(u, b), -b),

    in every equation in which u pulls. A spring between two bodies is play at the last of their
    equations.
    """
    springs = springs_of(site.model)
    for deflection in dict.fromkeys(s.deflection for s in springs):
        mine = [s for s in springs if s.deflection == deflection]
        reach = _reach(site, deflection)
        if mine[-1].state != site.state or not reach > 0.0:
            continue
        u = to_text(deflection)
        unit = _unit(site.model, deflection)
        forces = [_force(site.model, s) for s in mine]
        if None in forces:
            continue
        terms = tuple(
            (s.state, f"+ ({force})*Max(Min({u}, {{b}}), -{{b}})")
            for s, force in zip(mine, forces, strict=True)
        )
        for share in SHARES:
            yield Candidate(
                "backlash",
                "elastic",
                site.name,
                (Threshold("b", unit, low=0.0, high=2.0 * reach, seed=share * reach),),
                f"The spring on {u} in {{site}} has play before it engages.",
                terms=terms,
                borrowed=(("kb", str(forces[0]).removeprefix("-")),),
                source="Nordin & Gutman, Automatica 38 (2002)",
            )


def springs_of(model: Model) -> list[Spring]:
    """Return the linear springs of a model, by equation."""
    positions = {model.kinematic_parent(s) for s in model.dynamic_states} - {None}
    found = []
    for state in model.dynamic_states:
        for sign, summand in summands(model.equation_terms[state], 1.0):
            factors = list(_factors(summand))
            moving = [f for f, _ in factors if f.variables & positions]
            if len(moving) != 1 or not _is_deflection(moving[0], model, positions):
                continue
            others = [(f, above) for f, above in factors if f != moving[0]]
            linear = (moving[0], True) in factors
            if linear and all(_constant(f, model) for f, _ in others):
                u, way = _oriented(moving[0])
                found.append(Spring(state, u, _product(others, -sign * way)))
    return found


def _force(model: Model, spring: Spring) -> str | None:
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


def _is_deflection(term: Term, model: Model, positions: set[str | None]) -> bool:
    """Whether a term is a position, or a sum of positions with constant factors."""
    if term.is_variable:
        return term.name in positions
    if term.op in ("add", "sub"):
        return all(_is_deflection(a, model, positions) for a in term.args)
    if term.op not in ("mul", "div"):
        return False
    first, second = term.args
    if term.op == "mul" and _constant(first, model):
        first, second = second, first
    return _constant(second, model) and _is_deflection(first, model, positions)


def _unit(model: Model, deflection: Term) -> str | None:
    """Return the unit of a deflection: that of a position in it that has no factor."""
    if deflection.is_variable:
        return model.units.get(deflection.name)
    if deflection.op not in ("add", "sub"):
        return None
    known = (_unit(model, a) for a in deflection.args)
    return next((unit for unit in known if unit is not None), None)


def _oriented(deflection: Term) -> tuple[Term, float]:
    """Return a difference with its names in order, and the sign that this takes."""
    if deflection.op == "sub" and to_text(deflection.args[1]) < to_text(deflection.args[0]):
        return Term.apply("sub", deflection.args[1], deflection.args[0]), -1.0
    return deflection, 1.0


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


def _reach(site: Site, deflection: Term) -> float:
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
    if deflection.is_variable:
        return float(max(min(known[0][-1], -known[0][0]), 0.0))
    still = dict.fromkeys(positions, 0.0)
    factors = [abs(float(deflected({**still, n: 1.0, **parameters}))) for n in positions]
    return float(min(f * 0.5 * (r[-1] - r[0]) for f, r in zip(factors, known, strict=True)))
