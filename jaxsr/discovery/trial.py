"""Roll-outs of candidate equations on stretches of recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr._progress import Budget
from jaxsr.discovery.equation import Equation, weighted_sum
from jaxsr.discovery.rollout import RolloutFit, Segments, System, fit_rollout
from jaxsr.expressions.term import Term

QUICK = 8  # iterations of a candidate's fit

Result = tuple[System, RolloutFit]


@dataclass(frozen=True, eq=False)
class Trial:
    """Everything that a roll-out of some states needs.

    Attributes
    ----------
    segments : Segments
    time : str
    known : dict of str to Term
        Given parts of right-hand sides, recognised rates among them.
    budget : Budget
    substeps : int
        Steps of the integration between samples.
    judge : Segments, optional
        Stretches of other recordings, to choose by.
    """

    segments: Segments
    time: str
    known: Mapping[str, Term]
    budget: Budget
    substeps: int = 1
    judge: Segments | None = None

    def fit(
        self,
        terms: Mapping[str, Sequence[Term]],
        coefficients: Mapping[str, Sequence[float]],
        iterations: int = QUICK,
    ) -> tuple[System, RolloutFit] | None:
        """Fit the constants of some states' equations, the other states driving them."""
        system = System(terms, {s: self.known[s] for s in terms if s in self.known})
        fitted = fit_rollout(
            system,
            self.segments,
            system.constants(coefficients),
            time=self.time,
            substeps=self.substeps,
            iterations=iterations,
            expired=self.expired,
        )
        return None if fitted is None else (system, fitted)

    def judged(self, result: Result) -> RolloutFit | None:
        """Return the roll-outs of the stretches to choose by: constants as fitted, starts free."""
        if self.judge is None:
            return result[1]
        terms, weights = moved(result)
        known = {s: weighted_sum(terms[s], weights[s]) for s in terms if terms[s]}
        known |= {
            s: Term.apply("add", self.known[s], known[s]) if s in known else self.known[s]
            for s in terms
            if s in self.known
        }
        fixed = System({s: () for s in terms}, known)
        none = np.zeros(0)
        steps = self.substeps
        return fit_rollout(
            fixed, self.judge, none, time=self.time, substeps=steps, expired=self.expired
        )

    def expired(self) -> bool:
        """Tell whether the time is over."""
        return self.budget.exhausted


def moved(result: Result) -> tuple[dict[str, tuple[Term, ...]], dict[str, list[float]]]:
    """Return the terms and coefficients of a fit, to start the next one from."""
    parts = result[0].unpacked(result[1].constants)
    terms = {s: tuple(t for t, _, _ in rows) for s, rows in parts.items()}
    return terms, {s: [c for _, c, _ in rows] for s, rows in parts.items()}


def is_open(equation: Equation) -> bool:
    """Tell whether roll-outs may choose and estimate an equation: searched, and not exact."""
    return bool(equation.front) and not equation.exact
