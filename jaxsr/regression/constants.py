"""The search over constants inside terms: its limits, and the one call to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxsr._result import InputError
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array
from jaxsr.regression.marquardt import levenberg_marquardt
from jaxsr.regression.projection import batches
from jaxsr.regression.slopes import Form, constants_of, with_constants

if TYPE_CHECKING:
    from jaxsr.regression.problem import RegressionProblem


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
    gain : float
        A step that lowers the loss by less than this share of it, or promises no more, is the
        last.
    reach : float
        Longest step of a constant relative to its size (or to one, for smaller constants).
    """

    iterations: int = 15
    floor: float = 1e-22
    most_constants: int = 10
    gain: float = 1e-6
    reach: float = 10.0

    def __post_init__(self) -> None:
        if self.iterations < 0 or self.most_constants < 0:
            raise InputError("iterations and most_constants must not be negative", "Refinement")
        if not self.reach > 0.0:
            raise InputError(f"reach must be positive, got {self.reach}", "Refinement")


def refine_many(
    problem: RegressionProblem, sets: Sequence[Sequence[Term]], limits: Refinement | None = None
) -> list[tuple[tuple[Term, ...], float]]:
    """Move the inner constants of every set of terms to a local minimum of its loss.

    Returns
    -------
    list of (terms, loss)
        In the order of ``sets``: the given terms where nothing better was found, and the residual
        sum of squares relative to the target's; inf where a term is not finite.
    """
    limits = limits or Refinement()
    total = problem.total or 1.0
    out: list[tuple[tuple[Term, ...], float]] = [(tuple(terms), np.inf) for terms in sets]
    for places, batch in batches(problem, sets, limits.most_constants):
        constants, loss = levenberg_marquardt(batch, limits, total)
        for row, place in enumerate(places):
            terms = sets[place]
            if np.any(batch.used[row]):
                moved = iter(constants[row].tolist())
                terms = [with_constants(term, moved) for term in terms]
            out[place] = (tuple(terms), float(loss[row] / total))
    return out


def refine(
    problem: RegressionProblem, terms: Sequence[Term], limits: Refinement | None = None
) -> tuple[tuple[Term, ...], float]:
    """Move the inner constants of one set of terms; see :func:`refine_many`."""
    return refine_many(problem, [terms], limits)[0]


def constant_slopes(problem: RegressionProblem, terms: Sequence[Term], xi: Array) -> Array:
    """Return d(theta xi)/dc (rows, constants), exact, in preorder of constants."""
    slopes = []
    for term, weight in zip(terms, xi, strict=True):
        values = constants_of(term)
        if not values:
            continue
        _, tangents = Form.of(term).columns(np.array([values]), problem.cache.column)
        for place in range(len(values)):
            slope = np.broadcast_to(tangents.get(place, 0.0), (1, problem.samples))[0]
            slopes.append(weight * slope)
    if not slopes:
        return np.zeros((problem.rows, 0))
    return np.nan_to_num(problem.seen(np.column_stack(slopes)), nan=0.0, posinf=0.0, neginf=0.0)
