"""What float32 can know of a term: float64 values with running bounds on the float32 error.

A random term may subtract nearly equal numbers, or take the sine of exp(x): there no two float32
machines agree, and none is wrong. The bound e of every node follows from those of its arguments
through the function itself (not its derivative), e.g. for a quotient

    |a'/b' - a/b| <= (e_a + |a/b| e_b) / (|b| - e_b),

plus the operation's own rounding: half a unit in the last place for arithmetic, a whole one for a
quotient (a machine may multiply by a constant's reciprocal), `ULPS` units for functions (Higham,
Accuracy and Stability of Numerical Algorithms, section 3.3). Where a bound exceeds
`tolerance * |value|`, equality to that tolerance is not asked; where a value lies beyond its
bound, a machine is less accurate than this.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxsr.expressions import PRIMITIVES, Term

UNIT = 2.0**-24  # half the distance of neighbouring float32 numbers, relative
ULPS = 4.0  # error granted to each function, in units in the last place
ROUNDINGS = {"add": 1, "sub": 1, "mul": 1, "abs": 1, "div": 2}  # in `UNIT`; functions: from ULPS
SMALLEST, LARGEST = 2.0**-126, float(np.finfo(np.float32).max)
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reference:
    """Values of terms with bounds on their float32 error; a bound may be infinite.

    Attributes
    ----------
    theta, bound : ndarray, (terms, samples)
    """

    theta: Array
    bound: Array

    def compare(self, theta: NDArray[Any], tolerance: float = 1e-5) -> dict[str, Any]:
        """Return how far float32 values (terms, samples) lie from the reference."""
        return _compare(theta, self.theta, self.bound, tolerance)

    def compare_two(
        self, ours: NDArray[Any], theirs: NDArray[Any], tolerance: float = 1e-5
    ) -> dict[str, Any]:
        """Return how far two machines lie apart; each may be off by its bound."""
        return _compare(ours, theirs.astype(float), 2.0 * self.bound, tolerance)


def reference(
    terms: Sequence[Term], variables: Sequence[str], data: NDArray[np.float32]
) -> Reference:
    """Evaluate terms on float32 data (samples, variables) in float64."""
    columns = dict(zip(variables, data.T.astype(float), strict=True))
    known: dict[Term, tuple[Array, Array]] = {}
    theta, bound = (np.empty((len(terms), len(data))) for _ in range(2))
    with np.errstate(all="ignore"):
        for row, term in enumerate(terms):
            theta[row], bound[row] = _with_bound(term, columns, known)
    return Reference(theta, bound)


def _with_bound(
    term: Term, columns: Mapping[str, Array], known: dict[Term, tuple[Array, Array]]
) -> tuple[Array, Array]:
    if term.is_variable:
        return columns[term.name], np.zeros(())
    if term.is_constant:  # the populations' constants are float32 numbers
        return np.asarray(term.value), np.zeros(())
    if term not in known:
        args = [_with_bound(arg, columns, known) for arg in term.args]
        value = PRIMITIVES[term.op].numpy(*(v for v, _ in args))
        error = _BOUNDS[term.op](*(part for arg in args for part in arg), value)
        own = ROUNDINGS.get(term.op, 2.0 * ULPS) * UNIT
        error = error + own * np.abs(value) + SMALLEST  # below it a machine may flush to zero
        # what is lost once stays lost: tanh bounds an overflow, but not an invalid value
        lost = ~(np.abs(value) + error < LARGEST) | _any_infinite([e for _, e in args])
        known[term] = value, np.where(lost, np.inf, error)
    return known[term]


def _any_infinite(errors: Sequence[Array]) -> NDArray[np.bool_]:
    return np.logical_or.reduce(np.broadcast_arrays(*(np.isinf(e) for e in errors)))


def _product(a: Array, ea: Array, b: Array, eb: Array, value: Array) -> Array:
    return np.abs(a) * eb + np.abs(b) * ea + ea * eb


def _quotient(a: Array, ea: Array, b: Array, eb: Array, value: Array) -> Array:
    room = np.abs(b) - eb
    return np.where(room > 0, (ea + np.abs(value) * eb) / room, np.inf)


def _logarithm(a: Array, ea: Array, value: Array) -> Array:
    return np.where(ea < a, -np.log1p(-ea / a), np.inf)


def _root(a: Array, ea: Array, value: Array) -> Array:
    return np.where(ea <= a, value - np.sqrt(np.maximum(a - ea, 0.0)), np.inf)


def _wave(a: Array, ea: Array, value: Array) -> Array:
    return np.minimum(ea, 2.0)


_BOUNDS: dict[str, Callable[..., Array]] = {
    "add": lambda a, ea, b, eb, value: ea + eb,
    "sub": lambda a, ea, b, eb, value: ea + eb,
    "mul": _product,
    "div": _quotient,
    "sin": _wave,
    "cos": _wave,
    "exp": lambda a, ea, value: value * np.expm1(ea),
    "log": _logarithm,
    "sqrt": _root,
    "tanh": lambda a, ea, value: np.tanh(a + ea) - np.tanh(a - ea),
    "abs": lambda a, ea, value: ea,
}


def _compare(
    theta: NDArray[Any], other: NDArray[Any], bound: Array, tolerance: float
) -> dict[str, Any]:
    """Return counts and the largest deviations of theta from other."""
    here, there = np.isfinite(theta), np.isfinite(other)
    sure = np.isfinite(bound)
    with np.errstate(all="ignore"):
        deviation = np.abs(theta.astype(float) - other)
        relative = deviation / np.abs(other)
    relative[deviation == 0.0] = 0.0
    both = here & there
    asked = both & sure & (bound <= tolerance * np.abs(other))
    return {
        "values": int(theta.size),
        "finite_in_both": int(both.sum()),
        "finite_in_one_only": int((here != there).sum()),
        "finite_in_one_only_where_float32_decides": int(((here != there) & sure).sum()),
        "share_within_tolerance": float((relative[both] <= tolerance).sum() / max(1, both.sum())),
        "tolerance": tolerance,
        "share_where_float32_can": float(asked.sum() / max(1, both.sum())),
        "largest_relative_where_float32_can": float(relative[asked].max(initial=0.0)),
        "relative_99.9_percent": float(np.percentile(relative[both], 99.9)) if both.any() else 0.0,
        "beyond_the_rounding_bound": int((both & sure & (deviation > bound)).sum()),
    }
