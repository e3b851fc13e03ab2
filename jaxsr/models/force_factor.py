r"""How a force enters a rate that is written as a formula: what it is multiplied by.

In ``(tau - b*w)/J`` a force stands in the bracket, and the rate takes 1/J of it. The factor is
read, in this order of belief, from

- *inputs that a mass matrix couples*: two joints solved for their accelerations, whose columns
  \partial f/\partial u are those of its inverse; a force beside an input enters as the input does;
- *a bracket* that the whole rate is divided or multiplied by;
- *the input* that drives the rate, \partial f/\partial u, or what divides it alone: what multiplies
  an input, such as a pump's gain, is its own affair;
- *the divisor* common to its terms, as in ``tau/J - b*w/J``.

Where units are known, the first of the last three that leaves N or N*m is taken. A rate without
any of them is a balance of rates: a force there has the unit of the rate.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from jaxsr.expressions import Term, evaluate
from jaxsr.expressions.canonical import simplify
from jaxsr.expressions.derivative import ONE, built
from jaxsr.models.force_columns import LEAST, gain_column, paired
from jaxsr.models.structure import Structure
from jaxsr.models.units import dimension, known_dimensions, unit_of

Array = Any
Why = Literal["mass matrix", "bracket", "inputs", "terms"]
POINTS = 32
"""Random points at which factors are compared."""
SAME = 1e-8
"""Relative difference of two values that are the same but for rounding."""
_TOO_MANY = 400
"""States from which columns of inputs are not compared with each other."""


@dataclass(frozen=True, eq=False)
class Factor:
    """What a force along a state is multiplied by.

    Attributes
    ----------
    rows : tuple of (state, Term)
        The rates that the force adds to, and its factor in each.
    why : str
        What it was read from.
    beside : str or None
        Input that enters by the very same factors.
    """

    rows: tuple[tuple[str, Term], ...]
    why: Why
    beside: str | None = None


def force_factors(model: Structure, rates: Mapping[str, Term]) -> dict[str, Factor]:
    """Return the factors of the forces along states, those that are 1 left out.

    Parameters
    ----------
    model : Structure
    rates : mapping
        State to its right-hand side, definitions substituted. Rows of [inertia] say forces, and
        are passed over.
    """
    rates = {s: r for s, r in rates.items() if s not in model.inertia}
    moving = {s: r for s, r in rates.items() if not (r.is_variable and r.name in model.states)}
    points = random_points(model)
    fed: dict[str, dict[str, Term]] = {u: {} for u in model.inputs}
    for state, rate in rates.items():
        for u in rate.variables & fed.keys():
            fed[u][state] = rate
    columns = {u: gain_column(fed[u], u, points) for u in model.inputs}
    affine = {u: column for u, column in columns.items() if column}
    own = paired(affine, points) if affine else {}
    found = _coupled(model, affine, own, points, {u for u in columns if columns[u] is None})
    beside = {state: u for u, state in own.items()}
    reader = _Reader(model, points, known_dimensions(model), _parents(rates))
    for state, rate in moving.items():
        if state in found:
            continue
        gain = affine[beside[state]][state] if state in beside else None
        factor = reader.factor(state, rate, gain)
        if factor is None:
            continue
        term, why = factor
        values = _at(term, points)
        if np.all(values < 0.0):  # a force is positive where it speeds up
            term, values = built("neg", term), -values
        if not np.allclose(values, 1.0, rtol=SAME):
            same = gain is not None and np.allclose(values, _at(gain, points), rtol=SAME)
            found[state] = Factor(((state, term),), why, beside[state] if same else None)
    return found


def as_force(factors: Mapping[str, Factor], state: str, part: Term) -> Term | None:
    """Return a part of a rate as a force in its own row; None where forces enter several rates."""
    factor = factors.get(state)
    if factor is None:
        return part
    if len(factor.rows) > 1:
        return None
    return simplify(built("div", part, dict(factor.rows)[state]))


def random_points(model: Structure) -> dict[str, Array]:
    """Return random values of all symbols, shape (points,), parameters near those of the model."""
    rng = np.random.default_rng(0)
    names = (model.time, *model.states, *model.inputs)
    values = {name: rng.uniform(-2.0, 2.0, POINTS) for name in names}
    for name, parameter in model.parameters.items():
        size = parameter.value if parameter.value else 1.0
        values[name] = size * rng.uniform(0.9, 1.1, POINTS)
    return values


def _coupled(
    model: Structure,
    affine: Mapping[str, Mapping[str, Term]],
    own: Mapping[str, str],
    points: Mapping[str, Array],
    others: Iterable[str],
) -> dict[str, Factor]:
    """Return the factors of forces that a mass matrix carries into several rates.

    A mass matrix is symmetric: what an input does to the rate of another, that one does to its
    own. Towards a rate without an input the share depends on where the bodies are. An actuator
    between two bodies pushes both in constant proportion, and the motors of an aircraft act on
    its motion by no symmetric matrix.
    """
    wide = {u: column for u, column in affine.items() if len(column) > 1 and u in own}
    if not wide or len(model.states) > _TOO_MANY:
        return {}
    fixed = dict(points) | {n: np.full(POINTS, p.value) for n, p in model.parameters.items()}
    values = {u: {s: _at(b, fixed) for s, b in column.items()} for u, column in wide.items()}
    chosen = [u for u in wide if _by_mass(u, values, own)]
    touched = {s for u in chosen for s in wide[u]}
    # An input that acts on these rates in a way of its own leaves the matrix untold.
    if any(touched & affine[u].keys() for u in affine if u not in own) or any(others):
        return {}
    return {
        own[u]: Factor(tuple(wide[u].items()), "mass matrix", u)
        for u in chosen
        if sound(values[u][own[u]]) and (values[u][own[u]] > 0.0).all()
    }


def _by_mass(u: str, values: Mapping[str, Mapping[str, Array]], own: Mapping[str, str]) -> bool:
    """Whether a mass matrix can have carried an input into the rates that it adds to."""
    column, mine = values[u], own[u]
    driven = {state: w for w, state in own.items() if w != u}
    for state in column.keys() & driven.keys():
        back = values.get(driven[state], {}).get(mine)
        if back is None or not np.allclose(column[state], back, rtol=1e-6, atol=0.0):
            return False
    free = column.keys() - driven.keys() - {mine}
    with np.errstate(all="ignore"):
        shares = [np.nan_to_num(column[state] / column[mine]) for state in free]
    varying = [np.ptp(s) > 1e-6 * np.abs(s).max(initial=1e-300) for s in shares]
    return all(varying)


def _parents(rates: Mapping[str, Term]) -> dict[str, str]:
    """Return the state that each state is the rate of, where it is one's and nothing more."""
    return {r.name: s for s, r in rates.items() if r.is_variable}


@dataclass(frozen=True, eq=False)
class _Reader:
    """Factors of forces in their own rates alone."""

    model: Structure
    points: Mapping[str, Array]
    known: Mapping[str, Any]
    parents: Mapping[str, str]

    def factor(self, state: str, rate: Term, gain: Term | None) -> tuple[Term, Why] | None:
        """Return the factor of a force in a rate; None where nothing tells one."""
        inputs = frozenset(self.model.inputs)
        whole, below = _bracket(rate, self.model)
        common, sure = _divisor(rate)
        options: list[tuple[Term | None, Why, bool]] = [
            (whole, "bracket", True),
            (below, "bracket", False),
            (gain, "inputs", False),
            (_divisor_of(gain), "inputs", True),
            (common, "terms", sure),
        ]
        good: list[tuple[Term, Why, bool]] = [
            (term, why, plain)
            for term, why, plain in options
            if term is not None
            and not _multiplied_by(term, inputs)
            and sound(_at(term, self.points))
        ]
        if not good:
            return None
        known = dict(self.known)
        own = rate_dimension(self.model, state, rate, known)
        units = [_over(own, unit_of(term, known)) for term, _, _ in good]
        forces = (dimension("N"), dimension("N*m"))
        for (term, why, _), unit in zip(good, units, strict=True):
            if unit in forces:
                return term, why
        motions = {known.get(s) for s in (state, self.parents.get(state, ""))} - {None}
        for (term, why, plain), unit in zip(good, units, strict=True):
            if plain and not (state in self.parents and unit in motions):
                return term, why
        return None


def rate_dimension(model: Structure, state: str, rate: Term, known: dict[str, Any]) -> Any:
    """Return the dimension of a right-hand side; None where it is not known.

    By the unit of its state where that has one and no row of [inertia], else by its symbols,
    whose dimensions are `known`.
    """
    if state in known and state not in model.inertia:
        return known[state] / dimension("s")
    return unit_of(rate, known)


def _over(unit: Any, factor: Any) -> Any:
    return None if unit is None or factor is None else unit / factor


def sound(values: Array) -> bool:
    """Whether a factor keeps its sign, far from zero."""
    size = np.abs(values)
    return bool(
        np.isfinite(values).all()
        and size.min() > LEAST * size.max()
        and np.ptp(np.sign(values)) == 0.0
    )


def _bracket(rate: Term, model: Structure) -> tuple[Term | None, Term | None]:
    """Return what a bracket is multiplied and divided by, and what it is divided by alone."""
    above, below = _parts(rate)
    sums = [t for t in above if t.op in ("add", "sub") and not _constant(t, model)]
    if not sums:
        return None, None
    outer = [t for t in above if _constant(t, model)]
    alone = _quotient((), below) if below else None
    if not outer and not below:
        return None, None
    return _quotient(outer, below), alone


def _divisor(rate: Term) -> tuple[Term | None, bool]:
    """Return what the terms of a sum are divided by, and whether two or a bracket say so."""
    if rate.op == "neg":
        return _divisor(rate.args[0])
    if rate.op not in ("add", "sub"):
        return None, False
    told, brackets = [], 0
    for summand in _summands(rate):
        above, below = _parts(summand)
        if below:
            told.append(Counter(below))
            brackets += any(t.op in ("add", "sub") for t in above)
    if not told:
        return None, False
    common = told[0]
    for other in told[1:]:
        common = common & other
    if not common:
        return None, False
    sure = all(d == told[0] for d in told) and (len(told) > 1 or brackets > 0)
    return _quotient((), list(common.elements())), sure


def _divisor_of(gain: Term | None) -> Term | None:
    """Return what an input's gain is divided by alone."""
    below = [] if gain is None else _parts(gain)[1]
    return _quotient((), below) if below else None


def _summands(term: Term) -> Iterator[Term]:
    stack = [term]
    while stack:
        node = stack.pop()
        if node.op in ("add", "sub", "neg"):
            stack.extend(node.args)
        else:
            yield node


def _parts(term: Term) -> tuple[list[Term], list[Term]]:
    """Return the factors of a product above and below the fraction bar, signs and ones dropped.

    Whole powers are written out, so that ``m*l**2`` and ``m*l*l`` are one.
    """
    above: list[Term] = []
    below: list[Term] = []
    stack = [(term, True)]
    while stack:
        node, up = stack.pop()
        if node.op == "neg":
            stack.append((node.args[0], up))
        elif node.op in ("mul", "div"):
            stack.append((node.args[1], up == (node.op == "mul")))
            stack.append((node.args[0], up))
        elif node.op == "pow" and _whole(node.args[1]):
            count = int(node.args[1].value)
            stack.extend([(node.args[0], up == (count > 0))] * abs(count))
        elif not (node.is_constant and abs(node.value) == 1.0):
            (above if up else below).append(node)
    return above, below


def _multiplied_by(term: Term, names: frozenset[str]) -> bool:
    """Whether any of these stands above the fraction bar.

    An inertia may hang on where other joints are; a valve beside a force is no part of it.
    """
    return any(t.variables & names for t in _parts(term)[0])


def _whole(power: Term) -> bool:
    return power.is_constant and power.value == round(power.value) and 1 <= abs(power.value) <= 4


def _quotient(above: Iterable[Term], below: Iterable[Term]) -> Term:
    """Return a product over a product."""
    over, under = _product(above), _product(below)
    return over if under == ONE else built("div", over, under) if over != ONE else _inverse(under)


def _inverse(term: Term) -> Term:
    return Term.apply("div", ONE, term)


def _product(factors: Iterable[Term]) -> Term:
    found = ONE
    for factor in factors:
        found = built("mul", found, factor)
    return found


def _constant(term: Term, model: Structure) -> bool:
    return term.variables <= model.parameters.keys()


def _at(term: Term, points: Mapping[str, Array]) -> Array:
    with np.errstate(all="ignore"):
        values = np.asarray(evaluate(term, points), dtype=float)
    return np.broadcast_to(values, (POINTS,))
