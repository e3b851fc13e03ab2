"""The adaptive fitness of paper Eq. 9."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.evolution.config import FitnessRule
from jaxsr.evolution.individual import Individual

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


def fitness(individuals: Sequence[Individual], state: FitnessState, tau: float) -> np.ndarray:
    r"""Return Eq. 9 for each individual, lower being better.

    .. math::
        \Upsilon = \frac{RSS}{\max RSS_b}
          \left(\frac{\Gamma}{\max\Gamma_b}\right)^{\alpha}
          \left(\frac{\Im}{\max\Im_b}\right)^{\tau}

    :math:`\Gamma` counts terms, :math:`\Im` is operators per term (at least a half, so that bare
    variables do not make a fitness of zero), the maxima are those of the last best set.
    """
    loss = np.array([max(ind.loss, _EXACT) for ind in individuals])
    terms = np.array([max(len(ind.terms), 1) for ind in individuals], dtype=float)
    operators = np.array([ind.operators for ind in individuals]) / terms
    with np.errstate(invalid="ignore"):
        return (
            loss
            / state.max_loss
            * (terms / state.max_terms) ** state.alpha
            * (np.maximum(operators, 0.5) / state.max_operators) ** tau
        )


def next_state(
    state: FitnessState, rule: FitnessRule, best: Sequence[Individual], generation: int
) -> FitnessState:
    """Update alpha and the maxima from the best set of a generation."""
    finite = [ind for ind in best if np.isfinite(ind.loss)]
    if not finite:
        return state
    loss = min(ind.loss for ind in finite)
    increment, alpha = state.increment, state.alpha
    if loss > _JUMP * max(state.best_loss, _EXACT):
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
        max_loss=max(max(ind.loss for ind in finite), _EXACT),
        max_terms=max(len(ind.terms) for ind in finite),
        max_operators=max(max(ind.operators / len(ind.terms) for ind in finite), 0.5),
    )
