"""Values of terms with their partial derivatives, sample by sample.

Forward differentiation in NumPy: a node carries its derivative by every variable it depends on
and no other, so that the cost is that of the formula, whatever stands beside it in a model.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from jaxsr.expressions.primitives import PRIMITIVES
from jaxsr.expressions.tape import Traced
from jaxsr.expressions.term import BOOLEAN, LARGE, Term

Array = Any
Slopes = dict[str, Array]
"""Variable to derivative; a variable that does not occur is absent."""
Valued = tuple[Array, Slopes]


def evaluate_with_slopes(
    term: Term,
    environment: Mapping[str, Array],
    by: Collection[str],
    shared: dict[Term, Valued] | None = None,
) -> Valued:
    """Evaluate a term and its partial derivatives.

    Parameters
    ----------
    term : Term
    environment : mapping
        Variable to array or number.
    by : collection of str
        Variables to differentiate by.
    shared : dict, optional
        Values and slopes of subtrees already known; filled on the way.

    Returns
    -------
    value : array or number
    slopes : dict
        d value / d variable; variables that do not occur are absent.

    Notes
    -----
    At a kink (Abs, Max, Min) the slope is that of one side, at a jump (sign, floor, Heaviside,
    conditions) zero.
    """
    shared = {} if shared is None else shared
    if term.size > LARGE:
        for node in term.upward(shared):
            _with_slopes(node, environment, by, shared)
    return _with_slopes(term, environment, by, shared)


def _with_slopes(
    term: Term,
    environment: Mapping[str, Array],
    by: Collection[str],
    shared: dict[Term, Valued],
) -> Valued:
    known = shared.get(term)
    if known is not None:
        return known
    if term.is_constant:
        return term.value, {}
    if term.is_variable:
        return environment[term.name], {term.name: 1.0} if term.name in by else {}
    if term.op == BOOLEAN:
        return bool(term.value), {}
    pairs = [_with_slopes(arg, environment, by, shared) for arg in term.args]
    args, slopes = [a for a, _ in pairs], [s for _, s in pairs]
    if term.op == "pow" and not slopes[1]:
        value, partial = power_with_slope(args[0], args[1], bool(slopes[0]))
        found = value, _scaled(slopes[0], partial)
    else:
        value = PRIMITIVES[term.op].numpy(*args)
        found = value, _chained(term.op, args, slopes, value) if any(slopes) else {}
    shared[term] = found
    return found


def _scaled(slopes: Slopes, factor: Array) -> Slopes:
    return {name: slope * factor for name, slope in slopes.items()}


def _summed(parts: Sequence[Slopes]) -> Slopes:
    total: Slopes = {}
    for part in parts:
        for name, slope in part.items():
            total[name] = total[name] + slope if name in total else slope
    return total


def _chained(op: str, args: list[Array], slopes: list[Slopes], value: Array) -> Slopes:
    match op:
        case "add":
            return _summed(slopes)
        case "sub":
            return _summed([slopes[0], _scaled(slopes[1], -1.0)])
        case "max" | "min" | "piecewise":
            return _selected(op, args, slopes)
    called = getattr(PRIMITIVES[op], "partials", None)
    if called is not None:  # a call that costs more than arithmetic: asked for no more than needed
        factors = called(args, [bool(s) for s in slopes])
        return _summed([_scaled(s, f) for s, f in zip(slopes, factors, strict=True) if s])
    partials = _PARTIALS.get(op)
    if partials is None:
        if op in _FLAT:
            return {}
        return _foreign(op, args, slopes)
    factors = partials(*args, value)
    return _summed([_scaled(s, f) for s, f in zip(slopes, factors, strict=True) if s])


def _selected(op: str, args: list[Array], slopes: list[Slopes]) -> Slopes:
    """Take the slope of the argument that gives the value."""
    if op == "piecewise":
        pairs = list(zip(args[::2], slopes[::2], args[1::2], strict=True))
        taken, rest = [], np.True_
        for _, own, condition in pairs:
            taken.append(_scaled(own, np.where(rest & condition, 1.0, 0.0)))
            rest = rest & np.logical_not(condition)
        return _summed(taken)
    value, total = args[0], slopes[0]
    for other, own in zip(args[1:], slopes[1:], strict=True):
        first = value >= other if op == "max" else value <= other
        total = _summed(
            [_scaled(total, np.where(first, 1.0, 0.0)), _scaled(own, np.where(first, 0.0, 1.0))]
        )
        value = np.where(first, value, other)
    return total


def power_with_slope(base: Array, exponent: Array, wanted: bool) -> tuple[Array, Array]:
    """Return base**exponent for an exponent that is not differentiated by, and its slope."""
    if isinstance(exponent, Traced):  # whether it is whole is not known yet
        value, slope = exponent.called(power_with_slope, base, exponent, wanted, results=2)
        return value, slope
    whole = np.ndim(exponent) == 0 and float(exponent).is_integer() and 0 < exponent < 10
    if whole:
        lower = base ** (int(exponent) - 1) if exponent > 1 else 1.0
        return lower * base, exponent * lower
    value = np.float_power(base, exponent)
    return value, exponent * np.float_power(base, exponent - 1.0) if wanted else 0.0


def _general_power(a: Array, b: Array, value: Array) -> tuple[Array, Array]:
    safe = np.where(a > 0, a, 1.0)
    return b * np.float_power(a, b - 1.0), value * np.log(safe)


def _foreign(op: str, args: list[Array], slopes: list[Slopes]) -> Slopes:
    """Differentiate a primitive that a user defined through its JAX form."""
    import jax

    with jax.enable_x64(True):
        wide = [np.asarray(a, dtype=float) for a in np.broadcast_arrays(*args)]
        parts = []
        for k, own in enumerate(slopes):
            if own:
                unit = [np.full_like(a, float(j == k)) for j, a in enumerate(wide)]
                factor = jax.jvp(PRIMITIVES[op].jax, tuple(wide), tuple(unit))[1]
                parts.append(_scaled(own, np.asarray(factor)))
    return _summed(parts)


_FLAT = frozenset(
    {"sign", "floor", "heaviside", "lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not"}
)
_PARTIALS: dict[str, Callable[..., tuple[Array, ...]]] = {
    "mul": lambda a, b, y: (b, a),
    "div": lambda a, b, y: (np.divide(1.0, b), np.divide(-y, b)),
    "pow": _general_power,
    "neg": lambda a, y: (-1.0,),
    "sin": lambda a, y: (np.cos(a),),
    "cos": lambda a, y: (-np.sin(a),),
    "tan": lambda a, y: (1.0 + y * y,),
    "sinh": lambda a, y: (np.cosh(a),),
    "cosh": lambda a, y: (np.sinh(a),),
    "tanh": lambda a, y: (1.0 - y * y,),
    "exp": lambda a, y: (y,),
    "log": lambda a, y: (1.0 / a,),
    "sqrt": lambda a, y: (np.where(y > 0, 0.5 / np.where(y > 0, y, 1.0), 0.0),),
    "asin": lambda a, y: (1.0 / np.sqrt(1.0 - a * a),),
    "acos": lambda a, y: (-1.0 / np.sqrt(1.0 - a * a),),
    "atan": lambda a, y: (1.0 / (1.0 + a * a),),
    "atan2": lambda a, b, y: (b / (a * a + b * b), -a / (a * a + b * b)),
    "abs": lambda a, y: (np.sign(a),),
}
