r"""How forces enter the rates of a vector field: by the columns of \partial f/\partial u.

A force beside an input enters as the input does, in the input's unit; one along a state that no
input drives, by the factor common to the terms of its rate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from jaxsr.expressions import PRIMITIVES, Term, evaluate, to_text
from jaxsr.expressions.derivative import ONE, NoDerivativeError, built, derivative
from jaxsr.models.opaque import OpaquePrimitive
from jaxsr.models.structure import Structure

Array = Any
VOID = 1e-10
"""Size of a gain, relative to the largest of its input, below which it is rounding."""
LEAST = 1e-3
"""Smallest size of a gain, relative to its largest, by which a balance of forces divides."""
SHORT = 5
"""Nodes up to which a gain is written out where it stands."""
LONG = 1000
"""Nodes from which its text would be of no use to a reader."""


Rows = tuple[tuple[str, str], ...]
"""States, and the text of what is multiplied before it is added to their rates; empty for 1."""


@dataclass(frozen=True)
class Entry:
    """Where a force enters.

    Attributes
    ----------
    rows : tuple of (state, factor)
        The rates that it adds to.
    beside : str or None
        The input beside which it enters.
    """

    rows: Rows
    beside: str | None = None


def force_columns(
    model: Structure, rates: Mapping[str, Term], points: Mapping[str, Array]
) -> tuple[dict[str, Term], dict[str, Rows], dict[str, Entry]]:
    """Return gains by their symbols, where inputs enter, and where a force along a state does.

    Parameters
    ----------
    model : Structure
    rates : mapping
        State to its rate.
    points : mapping
        Symbol to random values, at which gains are compared.
    """
    gains: dict[str, Term] = {}
    columns: dict[str, Entry] = {}
    found = {u: gain_column(rates, u, points) for u in model.inputs}
    affine = {u: column for u, column in found.items() if column}
    inputs = {
        u: tuple((s, _factor(model, gains, b, s, u)) for s, b in column.items())
        for u, column in affine.items()
    }
    if model.inertia:  # the function returns forces, and additions are forces
        return gains, inputs, columns
    for u, state in paired(affine, points).items():
        if _invertible(affine[u][state], points):
            columns[state] = Entry(inputs[u], u)
    for state, rate in rates.items():
        factor = common_factor(model, rate)
        if state not in columns and factor is not None:
            columns[state] = Entry(((state, to_text(factor)),))
    return gains, inputs, columns


def paired(
    columns: Mapping[str, Mapping[str, Term]], points: Mapping[str, Array]
) -> dict[str, str]:
    """Return the state along which each input acts.

    The pairs whose gains have the largest product. With forces u along the rates and
    M a = u + ..., the gains are those of a positive definite inverse, B_ij^2 < B_ii B_jj, and no
    other pairs come near.
    """
    states = list(dict.fromkeys(s for column in columns.values() for s in column))
    sizes = np.full((len(columns), len(states)), np.log(1e-300))
    for k, column in enumerate(columns.values()):
        for state, gain in column.items():
            size = np.mean(np.log(np.abs(_at(gain, points)) + 1e-300))
            sizes[k, states.index(state)] = size
    pairs = zip(*linear_sum_assignment(sizes, maximize=True), strict=True)
    named = [(u, states[j]) for u, j in ((list(columns)[k], j) for k, j in pairs)]
    return {u: s for u, s in named if s in columns[u]}


def _invertible(gain: Term, points: Mapping[str, Array]) -> bool:
    """Whether a gain keeps its sign, far from zero."""
    values = _at(gain, points)
    return bool(
        np.abs(values).min() > LEAST * np.abs(values).max() and abs(np.ptp(np.sign(values))) == 0
    )


def gain_column(
    rates: Mapping[str, Term], u: str, points: Mapping[str, Array]
) -> dict[str, Term] | None:
    """Return the derivatives of the rates by an input; None where one of them depends on it."""
    column = {}
    for state, rate in rates.items():
        if u not in rate.variables:
            continue
        gain = _gain(rate, u, points)
        if gain is None:
            return None
        column[state] = gain
    sizes = {s: float(np.max(np.abs(_at(b, points)))) for s, b in column.items()}
    largest = max(sizes.values(), default=0.0)
    return {s: b for s, b in column.items() if sizes[s] > VOID * largest}


def _gain(rate: Term, u: str, points: Mapping[str, Array]) -> Term | None:
    primitive = PRIMITIVES.get(rate.op)
    if isinstance(primitive, OpaquePrimitive):
        return _opaque_gain(rate, primitive, u, points)
    try:
        gain = derivative(rate, u)
    except NoDerivativeError:
        return None
    return None if u in gain.variables else gain


def _opaque_gain(
    rate: Term, primitive: OpaquePrimitive, u: str, points: Mapping[str, Array]
) -> Term | None:
    """Return the derivative of a call by an input, where it is the same for every value of it."""
    names = [a.name for a in rate.args]
    place, called = names.index(u), primitive.called
    assert called is not None
    found = called.gain(place, names)
    if found.is_constant:
        return found
    size = np.shape(points[u])
    own = called.slopes([points[n] for n in names])[place]
    still = np.broadcast_to(np.asarray(evaluate(found, points)), size)
    if not np.allclose(own, still, rtol=1e-8, atol=1e-12 * (1.0 + np.abs(own).max())):
        return None
    return Term.constant(float(own[0])) if np.ptp(own) <= 1e-12 * np.abs(own).max() else found


def common_factor(model: Structure, rate: Term) -> Term | None:
    """Return what all terms of a rate are divided or multiplied by, None where there is none."""
    if rate.op == "neg":
        return common_factor(model, rate.args[0])
    if rate.op == "div" and _constant(model, rate.args[1]):
        inner = common_factor(model, rate.args[0]) or ONE
        return built("div", inner, rate.args[1])
    if rate.op == "mul":
        for own, other in (rate.args, rate.args[::-1]):
            if _constant(model, own) and other.op in ("add", "sub"):
                return own
    return None


def _constant(model: Structure, term: Term) -> bool:
    return term.variables <= model.parameters.keys()


def _at(gain: Term, points: Mapping[str, Array]) -> Array:
    with np.errstate(all="ignore"):
        return np.nan_to_num(np.asarray(evaluate(gain, points), dtype=float))


def _factor(model: Structure, gains: dict[str, Term], gain: Term, state: str, u: str) -> str:
    """Return the text that stands for a gain: itself where it is short, else a symbol."""
    if gain == ONE:
        return ""
    if gain.size <= SHORT and (text := written(gain)) is not None:
        return text
    name = gain_symbol(state, u)
    if name in (*model.symbols, *model.outputs):
        return to_text(gain)
    gains[name] = gain
    return name


def written(gain: Term) -> str | None:
    """Return a gain as text; None where it is a call of the function, or too long to be read."""
    if gain.size > LONG:
        return None
    called = any(isinstance(PRIMITIVES.get(n.op), OpaquePrimitive) for n in gain.distinct())
    return None if called else to_text(gain)


def gain_symbol(state: str, u: str) -> str:
    """Return the symbol of the derivative of a state's rate by an input."""
    return f"{state}_per_{u}"
