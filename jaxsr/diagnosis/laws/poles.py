"""Poles and gaps of a law: where a motion reaches, no force is infinite, and each is a number."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from jaxsr.expressions import Term, evaluate
from jaxsr.models import Model
from jaxsr.models.segments import Prepared

BEYOND = 0.1
"""Share of a signal's range, on either side of it, that a simulation may reach as well."""
CLOSE = 0.025
"""The same for roots and logarithms: a level that falls to nothing must not be asked below it."""
PLACES = 21
"""Values of each signal at which the sign of a part is looked at."""

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value of every signal that a law may hang on."""


def ranges_of(model: Model, prepared: Sequence[Prepared]) -> Ranges:
    """Return the ranges of states and inputs that were recorded."""
    found = {}
    states = np.concatenate([p.states.values for p in prepared])
    inputs = np.concatenate([p.inputs for p in prepared])
    columns = [*zip(model.states, states.T, strict=True), *zip(model.inputs, inputs.T, strict=True)]
    for name, values in columns:
        values = values[np.isfinite(values)]
        if values.size:
            found[name] = float(values.min()), float(values.max())
    return found


def _wider(ranges: Ranges, share: float) -> Ranges:
    """Return ranges that go beyond their ends by a share."""
    return {n: (a - share * (b - a), b + share * (b - a)) for n, (a, b) in ranges.items()}


def without_poles(
    terms: Sequence[Term], ranges: Ranges
) -> Callable[[Mapping[str, float]], bool] | None:
    """Return what tells from a law's constants whether it is finite; None where it always is.

    Every denominator that hangs on a signal must keep its sign over the ranges and beyond, and what
    roots, logarithms and powers that are no whole numbers are taken of must not be negative.

    Parameters
    ----------
    terms : sequence of Term
        Over signals and constants, these in braces as a candidate's templates have them.
    ranges : mapping
        As they were recorded.
    """
    below = [part for term in terms for part in _denominators(term)]
    within = [part for term in terms for part in _radicands(term)]
    if not (below or within):
        return None
    far, close = _wider(ranges, BEYOND), _wider(ranges, CLOSE)

    def finite(own: Mapping[str, float]) -> bool:
        constants = {f"{{{name}}}": value for name, value in own.items()}
        signs = (_values(part, constants, far) for part in below)
        if not all((x > 0.0).all() or (x < 0.0).all() for x in signs):
            return False
        return all((_values(part, constants, close) >= 0.0).all() for part in within)

    return finite


def _denominators(term: Term) -> Iterator[Term]:
    for node in term.walk():
        if node.op == "div":
            part = node.args[1]
        elif node.op == "pow" and node.args[1].is_constant and node.args[1].value < 0.0:
            part = node.args[0]
        else:
            continue
        if _hangs_on_signals(part):
            yield part


def _radicands(term: Term) -> Iterator[Term]:
    for node in term.walk():
        if node.op == "pow":
            power = node.args[1]
            root = not (power.is_constant and power.value.is_integer())
        else:
            root = node.op in ("sqrt", "log")
        if root and _hangs_on_signals(node.args[0]):
            yield node.args[0]


def _hangs_on_signals(part: Term) -> bool:
    return any(not name.startswith("{") for name in part.variables)


def _values(part: Term, constants: Mapping[str, float], ranges: Ranges) -> np.ndarray:
    """Return the values of a part of a law over the ranges; 1 where a signal has none."""
    signals = sorted(part.variables - constants.keys())
    if not set(signals) <= ranges.keys():
        return np.ones(1)
    axes = [np.linspace(*ranges[name], PLACES) for name in signals]
    points = np.array(list(product(*axes))).T
    with np.errstate(all="ignore"):
        values = evaluate(part, {**constants, **dict(zip(signals, points, strict=True))})
    return np.where(np.isfinite(values), values, np.nan)  # of no sign


__all__ = ["ranges_of", "without_poles"]
