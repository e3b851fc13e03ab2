"""The search over constants inside terms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from jaxsr.expressions.postfix import OPERATORS
from jaxsr.expressions.term import Term
from jaxsr.regression.gram import Array
from jaxsr.regression.linear import LinearProblem
from jaxsr.regression.marquardt import Course, ExactFits, levenberg_marquardt
from jaxsr.regression.projection import Sets, batches, evaluate
from jaxsr.regression.refinement import Refinement
from jaxsr.regression.resident_projection import resident_fits
from jaxsr.regression.slopes import Form, constants_of, with_constants
from jaxsr.regression.streamed_projection import fits, opened


def refine_many(
    problem: LinearProblem, sets: Sequence[Sequence[Term]], limits: Refinement | None = None
) -> list[tuple[tuple[Term, ...], float]]:
    """Move the inner constants of every set of terms to a local minimum of its loss.

    Returns
    -------
    list of (terms, loss)
        In the order of ``sets``: the given terms where nothing better was found, and the residual
        sum of squares relative to the target's; inf where a term is not finite.
    """
    limits = limits or Refinement()
    out: list[tuple[tuple[Term, ...], float]] = [(tuple(terms), np.inf) for terms in sets]
    total = problem.total or 1.0
    begun: dict[int, Course] = {}
    done: set[int] = set()
    if limits.method == "levenberg_marquardt" and problem.view is None:
        for k, course in _streamed(problem, sets, limits):
            if course.unsure[0]:
                begun[k] = course
            else:
                out[k] = _moved(sets[k], course.constants[0]), float(course.loss[0] / total)
                done.add(k)
    still = [k for k in range(len(sets)) if k not in done and not _moves(sets[k], limits)]
    for k, loss in zip(still, problem.still_losses([sets[k] for k in still]), strict=True):
        if not np.isnan(loss):
            out[k] = tuple(sets[k]), float(loss)
            done.add(k)
    rest = [k for k in range(len(sets)) if k not in done]
    for places, batch in batches(problem, [sets[k] for k in rest], limits.most_constants):
        numbers = [rest[place] for place in places]
        course = Course.of(batch.start, limits)
        for row, k in enumerate(numbers):
            if k in begun:
                course.follow(row, begun[k])
        constants, loss = _search(problem, batch, [sets[k] for k in numbers], limits, course)
        for row, k in enumerate(numbers):
            terms = _moved(sets[k], constants[row]) if np.any(batch.used[row]) else tuple(sets[k])
            out[k] = terms, float(loss[row] / total)
    return out


def _moves(terms: Sequence[Term], limits: Refinement) -> bool:
    """Tell whether a set holds constants, and not more than may be moved."""
    return 0 < sum(len(constants_of(term)) for term in terms) <= limits.most_constants


def _moved(terms: Sequence[Term], constants: Array) -> tuple[Term, ...]:
    moved = iter(constants.tolist())
    return tuple(with_constants(term, moved) for term in terms)


def _streamed(
    problem: LinearProblem, sets: Sequence[Sequence[Term]], limits: Refinement
) -> Iterator[tuple[int, Course]]:
    """Yield sets that the compiled machine has gone through, and how far their search came."""
    if not problem.evaluator.differentiates(len(sets)):
        return
    opens = [opened(problem, terms, limits.most_constants) for terms in sets]
    numbers = [k for k, own in enumerate(opens) if own is not None]
    made = fits if problem.resident is None else resident_fits
    for places, batch in made(problem, [own for own in opens if own is not None]):
        course = Course.of(batch.start, limits)
        levenberg_marquardt(batch, course, limits, problem.total or 1.0)
        for row, place in enumerate(places):
            yield numbers[place], course.row(row)


def _search(
    problem: LinearProblem,
    batch: Sets,
    sets: Sequence[Sequence[Term]],
    limits: Refinement,
    course: Course,
) -> tuple[Array, Array]:
    """Return constants and losses of a batch, never worse than the start."""
    moving = [[term for term in terms if constants_of(term)] for terms in sets]
    nodes = [node for terms in moving for term in terms for node in term.walk()]
    coded = all(node.op in OPERATORS for node in nodes if node.args)
    if limits.method == "levenberg_marquardt" or not coded or not batch.used.shape[1]:
        levenberg_marquardt(ExactFits(batch), course, limits, problem.total or 1.0)
        return course.constants, course.loss
    from jaxsr.regression.descent import descend  # optax is loaded only when asked for

    every = np.arange(len(sets))
    before = evaluate(batch, batch.start, every).loss
    found = descend(problem, batch, moving, limits)
    after = evaluate(batch, found, every).loss
    better = after < before
    return np.where(better[:, None], found, batch.start), np.where(better, after, before)


def refine(
    problem: LinearProblem, terms: Sequence[Term], limits: Refinement | None = None
) -> tuple[tuple[Term, ...], float]:
    """Move the inner constants of one set of terms; see :func:`refine_many`."""
    return refine_many(problem, [terms], limits)[0]


def constant_slopes(problem: LinearProblem, terms: Sequence[Term], xi: Array) -> Array:
    """Return d(theta xi)/dc (rows, constants), exact, in preorder of constants."""
    slopes = []
    for term, weight in zip(terms, xi, strict=True):
        values = constants_of(term)
        if not values:
            continue
        _, tangents = Form.of(term).columns(np.array([values]), problem.evaluator.column)
        for place in range(len(values)):
            slope = np.broadcast_to(tangents.get(place, 0.0), (1, problem.samples))[0]
            slopes.append(weight * slope)
    if not slopes:
        return np.zeros((problem.rows, 0))
    return np.nan_to_num(problem.seen(np.column_stack(slopes)), nan=0.0, posinf=0.0, neginf=0.0)
