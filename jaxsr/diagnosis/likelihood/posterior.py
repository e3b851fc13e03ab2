"""Probabilities of mechanisms, from the evidences of sets of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.likelihood.hypotheses import Hypothesis
from jaxsr.diagnosis.likelihood.loop import State, search
from jaxsr.diagnosis.likelihood.workspace import Workspace
from jaxsr.diagnosis.mechanisms.candidate import Candidate
from jaxsr.diagnosis.setup import Screened
from jaxsr.models.segments import Prepared

FROM_SCREEN = 3
"""Candidates whose effect is no column, taken from the leading sets of the weak view."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Hypotheses with their probabilities, the most probable first.

    Attributes
    ----------
    candidates : tuple of Candidate
        What the members of hypotheses count.
    hypotheses : tuple of Hypothesis
    probabilities : ndarray, shape (hypotheses,)
        Over what was estimated.
    """

    candidates: tuple[Candidate, ...]
    hypotheses: tuple[Hypothesis, ...]
    probabilities: np.ndarray

    @staticmethod
    def of(state: State) -> Posterior:
        """Weigh everything that was estimated."""
        found = [h for h in state.known.values() if h is not None]
        found.sort(key=state.log_posterior, reverse=True)
        logs = np.array([state.log_posterior(h) for h in found])
        weights = np.exp(logs - logs.max(initial=-np.inf))
        return Posterior(
            state.work.super_model.candidates, tuple(found), weights / max(weights.sum(), 1e-300)
        )

    @property
    def leader(self) -> Hypothesis:
        """The most probable hypothesis."""
        return self.hypotheses[0]

    def of_labels(self) -> dict[str, float]:
        """Mechanism and site to the probability that it is part of the truth."""
        mass: dict[str, float] = {}
        for found, probability in zip(self.hypotheses, self.probabilities, strict=True):
            for label in {self.candidates[i].label for i in found.members}:
                mass[label] = mass.get(label, 0.0) + float(probability)
        return dict(sorted(mass.items(), key=lambda item: -item[1]))


def posterior(
    screened: Screened,
    prepared: tuple[Prepared, ...],
    stop: Callable[[], bool] = lambda: False,
) -> Posterior | None:
    """Search by evidence; None where not even re-calibration can be followed.

    Parameters
    ----------
    screened : Screened
        Of the weak view, which offers the candidates.
    """
    work = Workspace.build(screened.super_model, prepared, 0.5 * screened.half_width)
    asked = (i for found in screened.screening.sets for i in found.members)
    others = [i for i in dict.fromkeys(asked) if i not in work.place][:FROM_SCREEN]
    state = search(work, others, stop)
    if not any(h is not None for h in state.known.values()):
        return None
    return Posterior.of(state)
