r"""Inner constants by variable projection.

Coefficients enter linearly, so only the constants inside terms are searched:
:math:`\min_c \| P^\perp_{\Theta(c)}\, y \|`, with Kaufman's Jacobian
:math:`J = -P^\perp_\Theta\, (\partial\Theta/\partial c)\,\xi` and Levenberg-Marquardt steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array

if TYPE_CHECKING:
    from jaxsr.regression.problem import RegressionProblem

# Central differences at the cube root of the float64 rounding: error about 1e-11.
_STEP = 6e-6


@dataclass(frozen=True, slots=True)
class Refinement:
    """Limits of the search over inner constants.

    Attributes
    ----------
    iterations : int
        Levenberg-Marquardt steps tried.
    floor : float
        Loss relative to the target's at which a fit is exact to rounding.
    most_constants : int
        Individuals with more inner constants are left alone: they are not identifiable.
    """

    iterations: int = 15
    floor: float = 1e-22
    most_constants: int = 10


def constants_of(term: Term) -> list[float]:
    """Return the inner constants that may move, in preorder; whole exponents stay whole.

    A term that is itself a constant has none: its coefficient says it all.
    """
    return [leaf.value for leaf in _free(term)] if term.args else []


def with_constants(term: Term, values: Iterator[float]) -> Term:
    """Return the term with its movable constants taken from ``values``, in preorder."""
    if not term.args:
        return term
    args = []
    for place, arg in enumerate(term.args):
        if arg.is_constant and not _is_whole_exponent(term, place):
            args.append(Term.constant(next(values)))
        else:
            args.append(with_constants(arg, values))
    return Term.apply(term.op, *args)


def _free(term: Term) -> Iterator[Term]:
    if term.op == "constant":
        yield term
    for place, arg in enumerate(term.args):
        if not _is_whole_exponent(term, place):
            yield from _free(arg)


def _is_whole_exponent(term: Term, place: int) -> bool:
    arg = term.args[place]
    return (
        term.op == "pow" and place == 1 and arg.op == "constant" and float(arg.value).is_integer()
    )


@dataclass(frozen=True, slots=True)
class _Point:
    terms: tuple[Term, ...]
    basis: Array
    xi: Array
    residual: Array
    loss: float


def refine(
    problem: RegressionProblem, terms: Sequence[Term], limits: Refinement | None = None
) -> tuple[tuple[Term, ...], float]:
    """Move the inner constants of ``terms`` to a local minimum of the loss.

    Returns
    -------
    terms : tuple of Term
        The given ones where nothing better was found.
    loss : float
        Residual sum of squares relative to the target's; inf where a term is not finite.

    References
    ----------
    Golub and Pereyra (1973); Kaufman (1975), BIT 15, 49-57.
    """
    limits = limits or Refinement()
    point = _point(problem, tuple(terms))
    start = np.array([c for term in terms for c in constants_of(term)])
    total = problem.total or 1.0
    if point is None:
        return tuple(terms), np.inf
    if not 0 < len(start) <= limits.most_constants:
        return tuple(terms), point.loss / total
    damping, c, gradient = 1e-3, start, None
    for _ in range(limits.iterations):
        if point.loss <= limits.floor * total:
            break
        if gradient is None:
            gradient = _jacobian(problem, point)
        moved = _step(problem, point, gradient, c, damping)
        if moved is None:
            damping *= 8.0
            if damping > 1e6:
                break
            continue
        fall = 1.0 - moved[0].loss / point.loss
        point, c = moved
        gradient, damping = None, damping / 6.0
        if fall < 1e-6:
            break
    return point.terms, point.loss / total


def _point(problem: RegressionProblem, terms: tuple[Term, ...]) -> _Point | None:
    theta = problem.projected(terms)
    if not np.all(np.abs(theta) < 1e100):  # also where not finite
        return None
    norms = np.linalg.norm(theta, axis=0)
    if not np.all(norms > 1e-100):
        return None
    basis, upper = np.linalg.qr(theta / norms)
    diagonal = np.abs(np.diag(upper))
    if len(diagonal) and diagonal.min() < 1e-10:
        return None
    shares = basis.T @ problem.target
    residual = problem.target - basis @ shares
    # a second pass restores what cancellation took from an almost exact fit
    residual -= basis @ (basis.T @ residual)
    xi = np.linalg.solve(upper, shares) / norms
    return _Point(terms, basis, xi, residual, float(residual @ residual))


def constant_slopes(problem: RegressionProblem, terms: Sequence[Term], xi: Array) -> Array:
    """Return d(theta xi)/dc (rows, constants) by central differences, in preorder of constants."""
    owner = [j for j, term in enumerate(terms) for _ in constants_of(term)]
    if not owner:
        return np.zeros((problem.rows, 0))
    shifted: list[Term] = []
    steps: list[float] = []
    for term in terms:
        own = constants_of(term)
        for k, value in enumerate(own):
            steps.append(_STEP * max(abs(value), 1e-2))
            for sign in (1.0, -1.0):
                values = list(own)
                values[k] += sign * steps[-1]
                shifted.append(with_constants(term, iter(values)))
    columns = problem.projected(shifted)
    with np.errstate(invalid="ignore", over="ignore"):
        slope = (columns[:, 0::2] - columns[:, 1::2]) / (2.0 * np.array(steps)) * xi[owner]
    return np.nan_to_num(slope, nan=0.0, posinf=0.0, neginf=0.0)


def _jacobian(problem: RegressionProblem, point: _Point) -> Array:
    """Return dresidual/dc, Kaufman's form."""
    slope = constant_slopes(problem, point.terms, point.xi)
    return -(slope - point.basis @ (point.basis.T @ slope))


def _step(
    problem: RegressionProblem, point: _Point, jacobian: Array, c: Array, damping: float
) -> tuple[_Point, Array] | None:
    """Return the point after one damped step, or None if it is no better."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    unit = jacobian / scale
    normal = unit.T @ unit + damping * np.eye(len(c))
    moved = c - np.linalg.solve(normal, unit.T @ point.residual) / scale
    if not np.all(np.isfinite(moved)):
        return None
    values = iter(moved)
    after = _point(problem, tuple(with_constants(term, values) for term in point.terms))
    return (after, moved) if after is not None and after.loss < point.loss else None
