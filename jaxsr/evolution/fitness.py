"""What individuals are ranked by: Eq. 9 with its schedule, or an information criterion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.evolution.config import FitnessRule
from jaxsr.evolution.individual import Individual, Problem
from jaxsr.regression.criteria import aic, bic

_JUMP = 2.0  # a rise of the best loss by this factor counts as abrupt
_EXACT = 1e-20  # a loss below this is rounding, not a merit


@dataclass(frozen=True, slots=True)
class FitnessState:
    """The power alpha, how fast it grows, the best loss last seen and the best set's maxima."""

    alpha: float = 0.0
    increment: float = 0.1
    best_loss: float = np.inf
    max_loss: float = 1.0
    max_terms: float = 1.0
    max_operators: float = 1.0


def fitness(
    individuals: Sequence[Individual], state: FitnessState, rule: FitnessRule, problem: Problem
) -> np.ndarray:
    r"""Return the measure of ``rule`` for each individual, lower being better.

    .. math::
        \Upsilon = \frac{RSS}{\max RSS_b}
          \left(\frac{\Gamma}{\max\Gamma_b}\right)^{\alpha}
          \left(\frac{\Im}{\max\Im_b}\right)^{\tau}, \quad
        N \log\frac{RSS}{N} + 2\,\Gamma, \quad N \log\frac{RSS}{N} + \Gamma \log N.

    :math:`\Gamma` counts terms, :math:`\Im` is operators per term (at least a half, so that bare
    variables do not make a fitness of zero), the maxima are those of the last best set, and
    :math:`RSS` is relative to the target's, on the rows that the rule names.

    References
    ----------
    Askari and Crevecoeur, section 4.2.2, Eqs. 9, 10 and 11.
    """
    loss = np.maximum(losses(individuals, rule, problem), _EXACT)
    terms = np.array([max(len(ind.terms), 1) for ind in individuals], dtype=float)
    if rule.measure != "adaptive":
        criterion = aic if rule.measure == "aic" else bic
        rows = problem.rows if rule.data == "training" else problem.judged_rows
        pairs = zip(loss, terms, strict=True)
        return np.array([criterion(float(rss), rows, int(count)) for rss, count in pairs])
    operators = np.array([ind.operators for ind in individuals]) / terms
    with np.errstate(invalid="ignore"):
        return (
            loss
            / state.max_loss
            * (terms / state.max_terms) ** state.alpha
            * (np.maximum(operators, 0.5) / state.max_operators) ** rule.tau
        )


def losses(individuals: Sequence[Individual], rule: FitnessRule, problem: Problem) -> np.ndarray:
    """Return relative losses on the rows that ``rule`` names, coefficients from training."""
    if rule.data == "validation":
        return problem.judge([ind.terms for ind in individuals])
    return np.array([ind.loss for ind in individuals], dtype=float)


def next_state(
    state: FitnessState,
    rule: FitnessRule,
    best: Sequence[Individual],
    generation: int,
    problem: Problem,
) -> FitnessState:
    """Update alpha and the maxima from the best set of a generation.

    Alpha is 0 before generation ``rule.generations``, then at least 1; once the best loss is
    below ``rule.error`` it grows in every generation. An abrupt rise of the best loss then halves
    the growth.
    """
    found = losses(best, rule, problem)
    finite = [ind for ind, loss in zip(best, found, strict=True) if np.isfinite(loss)]
    if not finite:
        return state
    found = found[np.isfinite(found)]
    loss = float(np.min(found))
    increment, alpha = state.increment, state.alpha
    if state.alpha >= 1.0 and loss > _JUMP * max(state.best_loss, _EXACT):
        increment /= 2.0
    if generation >= rule.generations:
        alpha = max(alpha, 1.0)
        if loss < rule.error:
            alpha = min(alpha + increment, rule.highest)
    return replace(
        state,
        alpha=alpha,
        increment=increment,
        best_loss=loss,
        max_loss=max(float(np.max(found)), _EXACT),
        max_terms=max(len(ind.terms) for ind in finite),
        max_operators=max(max(ind.operators / len(ind.terms) for ind in finite), 0.5),
    )
