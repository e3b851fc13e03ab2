"""Poles of a law: where a motion reaches, no force is infinite."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from jaxsr.expressions import Term, evaluate
from jaxsr.models import Model
from jaxsr.models.segments import Prepared

BEYOND = 0.1
"""Share of a signal's range, on either side of it, that a simulation may reach as well."""
PLACES = 21
"""Values of each signal at which the sign of a denominator is looked at."""

Ranges = Mapping[str, tuple[float, float]]
"""Lowest and highest value of every signal that a law may hang on."""


def ranges_of(model: Model, prepared: Sequence[Prepared]) -> Ranges:
    """Return the ranges of states and inputs, a little beyond what was recorded."""
    found = {}
    states = np.concatenate([p.states.values for p in prepared])
    inputs = np.concatenate([p.inputs for p in prepared])
    columns = [*zip(model.states, states.T, strict=True), *zip(model.inputs, inputs.T, strict=True)]
    for name, values in columns:
        values = values[np.isfinite(values)]
        if values.size:
            low, high = float(values.min()), float(values.max())
            found[name] = (low - BEYOND * (high - low), high + BEYOND * (high - low))
    return found


def without_poles(
    terms: Sequence[Term], ranges: Ranges
) -> Callable[[Mapping[str, float]], bool] | None:
    """Return what tells from a law's constants whether it is finite; None where it always is.

    Every denominator that hangs on a signal must keep its sign over the ranges.

    Parameters
    ----------
    terms : sequence of Term
        Over signals and constants, these in braces as a candidate's templates have them.
    ranges : mapping
    """
    below = [part for term in terms for part in _denominators(term)]
    if not below:
        return None

    def finite(own: Mapping[str, float]) -> bool:
        constants = {f"{{{name}}}": value for name, value in own.items()}
        return all(_keeps_its_sign(part, constants, ranges) for part in below)

    return finite


def _denominators(term: Term) -> Iterator[Term]:
    for node in term.walk():
        if node.op == "div":
            part = node.args[1]
        elif node.op == "pow" and node.args[1].is_constant and node.args[1].value < 0.0:
            part = node.args[0]
        else:
            continue
        if any(not name.startswith("{") for name in part.variables):
            yield part


def _keeps_its_sign(part: Term, constants: Mapping[str, float], ranges: Ranges) -> bool:
    signals = sorted(part.variables - constants.keys())
    if not set(signals) <= ranges.keys():
        return True
    axes = [np.linspace(*ranges[name], PLACES) for name in signals]
    points = np.array(list(product(*axes))).T
    values = evaluate(part, {**constants, **dict(zip(signals, points, strict=True))})
    return bool(np.isfinite(values).all() and ((values > 0.0).all() or (values < 0.0).all()))


__all__ = ["ranges_of", "without_poles"]
