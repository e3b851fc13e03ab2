"""One equation of motion: recognise it, or search, choose and re-estimate."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from jaxsr._progress import Budget
from jaxsr._result import StoppedBy
from jaxsr.discovery.choose import Candidate, choose, predict
from jaxsr.discovery.samples import Samples, thinned
from jaxsr.evolution import SearchConfig, SearchInfo, search
from jaxsr.expressions import to_text
from jaxsr.expressions.editing import ONE, edit, split
from jaxsr.expressions.term import Term
from jaxsr.recordings import noise_level
from jaxsr.regression import RegressionProblem, coefficient_ci95, constant_slopes

MOST_ROWS = 2000  # rows the search looks at,
MOST_JUDGED = 8000  # rows on which the front is weighed; the final estimate uses all of them


@dataclass(frozen=True, slots=True)
class FittedTerm:
    """A term of outer coefficient one, its coefficient and 95 % interval."""

    term: Term
    coefficient: float
    ci95: tuple[float, float]

    @property
    def expression(self) -> str:
        """Return the term in the model grammar."""
        return to_text(self.term)


@dataclass(frozen=True, slots=True)
class Equation:
    """d(state)/dt = sum of coefficient times term.

    Attributes
    ----------
    train_mse, validation_mse : float
        Mean squares of the coefficients estimated on the training rows alone.
    held_out_mse : float or None
    front : tuple of Candidate
        What was chosen from, smallest first; empty for a recognised equation.
    pick : int
    stopped_by : StoppedBy
    """

    state: str
    terms: tuple[FittedTerm, ...]
    train_mse: float
    validation_mse: float
    held_out_mse: float | None = None
    front: tuple[Candidate, ...] = field(default=(), repr=False)
    pick: int = 0
    stopped_by: StoppedBy = StoppedBy.CONVERGED

    @property
    def term(self) -> Term:
        """Return the right-hand side."""
        return weighted_sum([t.term for t in self.terms], [t.coefficient for t in self.terms])

    @property
    def expression(self) -> str:
        """Return the right-hand side in the model grammar."""
        return to_text(self.term)

    @property
    def complexity(self) -> int:
        """Return the number of terms."""
        return len(self.terms)

    @property
    def operators(self) -> int:
        """Return the number of operators over all terms."""
        return sum(t.term.operators for t in self.terms)

    def predict(self, samples: Samples) -> np.ndarray:
        """Return the right-hand side on samples (rows,)."""
        terms = [t.term for t in self.terms]
        return predict(terms, np.array([t.coefficient for t in self.terms]), samples.variables)


def weighted_sum(terms: Sequence[Term], coefficients: Sequence[float]) -> Term:
    """Return coefficient times term, summed, written with as few signs as can be."""

    def part(c: float, term: Term) -> Term:
        if term == ONE:
            return Term.constant(c)
        return term if c == 1.0 else Term.apply("mul", Term.constant(c), term)

    pairs = [(float(c), term) for c, term in zip(coefficients, terms, strict=True)]
    if not pairs:
        return Term.constant(0.0)
    total = part(*pairs[0])
    for c, term in pairs[1:]:
        total = Term.apply("sub" if c < 0.0 else "add", total, part(abs(c), term))
    return total


def recognised(samples: Samples, state: str, states: Sequence[str]) -> str | None:
    """Return the state whose integral over time is ``state``, if there is one.

    The integral is compared and not the derivative: it needs no differentiation and averages
    noise. The slope must be 1 within 1 %, and what is left over at most 2 % of the motion, or
    twice the sensor's noise.
    """
    time = samples.variables[next(iter(samples.variables))]
    x = samples.variables[state]
    for other in states:
        if other == state:
            continue
        columns, parts, noise = [], [], []
        for number in np.unique(samples.group):
            rows = samples.group == number
            integral = cumulative_trapezoid(samples.variables[other][rows], time[rows], initial=0.0)
            columns.append(integral - np.mean(integral))
            parts.append(x[rows] - np.mean(x[rows]))
            noise.append(noise_level(time[rows], x[rows]) ** 2 * np.count_nonzero(rows))
        area, motion = np.concatenate(columns), np.concatenate(parts)
        if not area @ area > 0.0 or not motion @ motion > 0.0:
            continue
        slope = float(area @ motion / (area @ area))
        left = motion - slope * area
        allowed = max(4e-4 * float(motion @ motion), 4.0 * float(np.sum(noise)))
        if abs(slope - 1.0) < 0.01 and left @ left < min(allowed, 0.04 * (motion @ motion)):
            return other
    return None


def find_equation(
    rng: np.random.Generator,
    state: str,
    train: Samples,
    validation: Samples,
    every: Samples,
    *,
    time: str,
    config: SearchConfig,
    budget: Budget,
    known: Term | None = None,
    progress: Callable[[SearchInfo], None] | None = None,
) -> Equation:
    """Search the right-hand side of one state's equation.

    Parameters
    ----------
    train, validation : Samples
        Rows to regress on, and rows to choose by.
    every : Samples
        Rows of the final estimate: both, where both come from DATA.
    known : Term, optional
        Part of the right-hand side that is given; only the remainder is searched.
    """
    shift = functools.partial(_remainder, state=state, known=known)
    rows = thinned(np.arange(len(train)), MOST_ROWS)
    few = train.take(rows)
    problem = RegressionProblem(shift(few), few.variables, time=time)
    scale = float(np.mean(train.targets[state] ** 2))
    if problem.total <= 1e-24 * scale * len(few):
        return _final(state, (), every, known, time, shift)
    found, reason = search(rng, problem, config, budget=budget, progress=progress)
    judged = train.take(thinned(np.arange(len(train)), MOST_JUDGED))
    whole = RegressionProblem(shift(judged), judged.variables, time=time)
    sets = [(), *(member.terms for member in found.front.members)]
    usable = [s for s in sets if -1 not in whole.index(s)]
    candidates, pick = choose(whole, usable, validation.variables, shift(validation))
    chosen = candidates[pick]
    final = _final(state, chosen.fit.terms, every, known, time, shift)
    return replace(
        final,
        train_mse=chosen.train_mse,
        validation_mse=chosen.validation_mse,
        front=tuple(candidates),
        pick=pick,
        stopped_by=reason,
    )


def _remainder(samples: Samples, *, state: str, known: Term | None) -> np.ndarray:
    y = samples.targets[state]
    return y if known is None else y - predict([known], np.ones(1), samples.variables)


def _final(
    state: str,
    terms: Sequence[Term],
    samples: Samples,
    known: Term | None,
    time: str,
    shift: Callable[[Samples], np.ndarray],
) -> Equation:
    """Estimate the chosen terms on all rows, with intervals."""
    problem = RegressionProblem(shift(samples), samples.variables, time=time)
    terms = edit(problem.refine(terms)[0]) if terms else ()
    fit = problem.fit(terms)
    theta = problem.projected(terms)
    residual = problem.y - theta @ fit.coefficients
    slopes = constant_slopes(problem, terms, fit.coefficients)
    both = np.hstack([theta, slopes])
    padded = np.concatenate([fit.coefficients, np.zeros(slopes.shape[1])])
    ends = coefficient_ci95(both, residual, padded) if terms else np.zeros((0, 2))
    given = split(known) if known is not None else []
    fitted = [FittedTerm(term, c, (c, c)) for c, term in given]
    fitted += [
        FittedTerm(term, float(c), (float(low), float(high)))
        for term, c, (low, high) in zip(terms, fit.coefficients, ends, strict=False)
    ]
    return Equation(state, tuple(fitted), fit.loss, fit.loss)
