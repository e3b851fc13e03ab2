"""Search one state's right-hand side, choose among what was found, estimate the choice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jaxsr._progress import Budget
from jaxsr.discovery.choose import choose, predict
from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.rounding import rounded
from jaxsr.discovery.samples import Samples, thinned
from jaxsr.evolution import SearchConfig, SearchInfo, search
from jaxsr.expressions.editing import edit, split
from jaxsr.expressions.term import Term
from jaxsr.regression import RegressionProblem, coefficient_ci95, constant_slopes

MOST_ROWS = 2000  # rows the search looks at,
MOST_JUDGED = 8000  # rows on which the front is weighed; the final estimate uses all of them
_GIVEN = 1e-10  # error of a derivative that is given as a column, relative to its rms


@dataclass(frozen=True)
class Task:
    """One state's equation, to be found.

    Attributes
    ----------
    state : str
    time : str
        Symbol of time.
    autonomous : bool
        Whether time is kept out of the terms.
    known : Term or None
        Part of the right-hand side that is given; only the remainder is searched.
    config : SearchConfig
    guesses : tuple of tuple of Term
        Sets of terms to start from.
    """

    state: str
    time: str
    autonomous: bool = False
    known: Term | None = None
    config: SearchConfig = field(default_factory=SearchConfig)
    guesses: tuple[tuple[Term, ...], ...] = ()

    def remainder(self, samples: Samples) -> np.ndarray:
        """Return the derivative without its known part (rows,)."""
        y = samples.targets[self.state]
        if self.known is None:
            return y
        return y - predict([self.known], np.ones(1), samples.variables)

    def problem(self, samples: Samples) -> RegressionProblem:
        """Return the regression, every row weighed by what its derivative is worth."""
        y = self.remainder(samples)
        offered = {
            n: v for n, v in samples.variables.items() if n != self.time or not self.autonomous
        }
        weights = row_weights(samples, self.state)
        floor = expected_loss(y, samples.errors.get(self.state))
        return RegressionProblem(
            weights * y,
            offered,
            view=lambda columns: weights[:, None] * columns,
            time=self.time,
            floor=floor,
            noise=samples.noise.get(self.state, 0.0) ** 2 / max(float(np.mean(y**2)), 1e-300),
        )


def row_weights(samples: Samples, state: str) -> np.ndarray:
    """Return one over the error of the derivative, of mean square one (rows,)."""
    error = samples.errors.get(state)
    if error is None:
        return np.ones(len(samples))
    weights = 1.0 / error
    return weights / np.sqrt(np.mean(weights**2))


def error_floor(samples: Samples, state: str) -> float:
    """Return the mean square that errors of the derivative leave in the weighted rows."""
    error = samples.errors.get(state)
    return 0.0 if error is None else 1.0 / float(np.mean(error**-2.0))


def expected_loss(y: np.ndarray, error: np.ndarray | None) -> float:
    """Return the relative residual that errors of the derivative alone leave."""
    if error is None:
        return _GIVEN**2
    return min(len(y) / float(np.sum((y / error) ** 2)), 1.0) if np.any(y) else 1.0


def find_equation(
    rng: np.random.Generator,
    task: Task,
    train: Samples,
    validation: Samples,
    every: Samples,
    *,
    budget: Budget,
    progress: Callable[[SearchInfo], None] | None = None,
) -> Equation:
    """Search the right-hand side of one state's equation.

    Parameters
    ----------
    train, validation : Samples
        Rows to regress on, and rows to choose by.
    every : Samples
        Rows of the final estimate: both, where both come from DATA.
    """
    few = train.take(thinned(np.arange(len(train)), MOST_ROWS))
    problem = task.problem(few)
    scale = float(np.mean(train.targets[task.state] ** 2))
    if problem.total <= 1e-24 * scale * len(few):
        return final_estimate(task, (), every)
    found, reason = search(
        rng, problem, task.config, guesses=task.guesses, budget=budget, progress=progress
    )
    judged = train.take(thinned(np.arange(len(train)), MOST_JUDGED))
    whole = task.problem(judged)
    sets = [(), *(member.terms for member in found.front.members)]
    usable = [s for s in sets if -1 not in whole.index(s)]
    candidates, pick = choose(
        whole,
        usable,
        validation.variables,
        task.remainder(validation),
        row_weights(validation, task.state),
        error_floor(validation, task.state),
    )
    chosen = candidates[pick]
    final = final_estimate(task, chosen.fit.terms, every)
    return replace(
        final,
        train_mse=chosen.train_mse,
        validation_mse=chosen.validation_mse,
        front=tuple(candidates),
        pick=pick,
        stopped_by=reason,
    )


def final_estimate(task: Task, terms: Sequence[Term], samples: Samples) -> Equation:
    """Estimate the chosen terms on all rows, with intervals."""
    problem = task.problem(samples)
    terms = edit(rounded(problem, terms)) if terms else ()
    fit = problem.fit(terms)
    theta = problem.projected(terms)
    residual = problem.y - theta @ fit.coefficients
    slopes = constant_slopes(problem, terms, fit.coefficients)
    both = np.hstack([theta, slopes])
    padded = np.concatenate([fit.coefficients, np.zeros(slopes.shape[1])])
    ends = coefficient_ci95(both, residual, padded) if terms else np.zeros((0, 2))
    given = split(task.known) if task.known is not None else []
    fitted = [FittedTerm(term, c, (c, c)) for c, term in given]
    fitted += [
        FittedTerm(term, float(c), (float(low), float(high)))
        for term, c, (low, high) in zip(terms, fit.coefficients, ends, strict=False)
    ]
    error = task.remainder(samples) - predict(terms, fit.coefficients, samples.variables)
    mse = float(np.mean(error**2))
    return Equation(task.state, tuple(fitted), mse, mse)
