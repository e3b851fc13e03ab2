"""Search one state's right-hand side, choose among what was found, estimate the choice."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from jaxsr._deadline import OutOfTime, bounded
from jaxsr._progress import Budget
from jaxsr.discovery.choose import choose, predict, resolved
from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.rounding import rounded
from jaxsr.discovery.samples import Samples, thinned
from jaxsr.evaluation import Evaluator
from jaxsr.evolution import Keeper, SearchConfig, SearchInfo, best_subsets, search
from jaxsr.expressions.editing import edit, split
from jaxsr.expressions.term import Term
from jaxsr.regression import (
    Judge,
    RegressionProblem,
    Resources,
    Rules,
    Sampling,
    TargetErrors,
    coefficient_ci95,
    constant_slopes,
)

MOST_ROWS = 2000  # rows the search looks at,
MOST_JUDGED = 8000  # rows on which the front is weighed; the final estimate uses all of them
EXACT = 1e-12  # mean square relative to the target's: nothing is left that a roll-out could tell
# samples of a record too short to search in a part of it, yet enough to tell a law from noise
_TINY, _SHORT = 16, 60
_FEWEST = 30  # test functions to choose by
_ROUNDING = 1e-20  # square of the relative error of a column without noise


@dataclass(frozen=True)
class Checkpoint:
    """A folder with one file for each state's search, and the seconds between writes."""

    directory: Path
    every: float = 60.0


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
    signs : dict of Term to int
        Terms whose coefficients must not be negative (1) or not be positive (-1).
    admits : callable or None
        Whether a term may be used.
    checkpoint : Checkpoint or None
        Where the search is kept.
    limit : Budget
        Of the whole discovery: once it is exhausted, what only betters a law is left out.
    strict : bool
        Whether everything asked of the regressions ends with the limit, by ``OutOfTime``.
    threads : int or None
        That evaluate terms; None: one for each core.
    """

    state: str
    time: str
    autonomous: bool = False
    known: Term | None = None
    config: SearchConfig = field(default_factory=SearchConfig)
    guesses: tuple[tuple[Term, ...], ...] = ()
    signs: Mapping[Term, int] = field(default_factory=dict)
    admits: Callable[[Term], bool] | None = None
    checkpoint: Checkpoint | None = None
    limit: Budget = field(default_factory=Budget)
    strict: bool = False
    threads: int | None = None

    def expired(self) -> bool:
        """Tell whether the time of the whole discovery is over."""
        return self.limit.exhausted

    def keeper(self, problem: RegressionProblem) -> Keeper | None:
        """Return what keeps the search, if it is to be kept."""
        if self.checkpoint is None:
            return None
        path = self.checkpoint.directory / f"{self.state}.json"
        return Keeper(path, problem, self.config, self.checkpoint.every)

    def _given(self, samples: Samples) -> np.ndarray:
        terms = () if self.known is None else (self.known,)
        return self.predicted(terms, np.ones(len(terms)), samples)

    def predicted(
        self, terms: Sequence[Term], coefficients: np.ndarray, samples: Samples
    ) -> np.ndarray:
        """Return the weighted sum of terms on samples (rows,)."""
        variables, group = samples.variables, samples.group
        return predict(terms, coefficients, variables, time=self.time, group=group)

    def remainder(self, samples: Samples) -> np.ndarray:
        """Return the derivative without its known part (rows,)."""
        y = samples.targets[self.state]
        if self.known is None:
            return y
        return y - self._given(samples)

    def problem(self, samples: Samples, judged: Samples | None = None) -> RegressionProblem:
        """Return the regression, every row weighed by what its left-hand side is worth.

        Where the derivative is given or can be computed: the derivative view; where it cannot,
        for noise: the weak view. The rows ``judged`` weigh fits where fitness is by validation.
        """
        rows = self.rows(samples)
        weights = 1.0 / rows.error
        weights /= np.sqrt(np.mean(weights**2))
        scale = float(np.sum((rows.target / rows.error) ** 2)) or 1.0
        problem = RegressionProblem(
            weights * rows.target,
            {n: v for n, v in samples.variables.items() if n != self.time or not self.autonomous},
            view=lambda columns: weights[:, None] * rows.seen(columns),
            rules=Rules(threshold=self.config.threshold, signs=self.signs, admits=self.admits),
            sampling=Sampling(self.time, samples.variables.get(self.time), samples.group),
            errors=TargetErrors(
                floor=len(rows.error) / scale if rows.exact else _ROUNDING,
                noise=len(rows.error) / scale,
            ),
            resources=Resources(partial(Evaluator, threads=self.threads)),
            judge=None if judged is None else self._judge(judged),
        )
        if self.strict:
            problem.expired = self.expired
        return problem

    def _judge(self, samples: Samples) -> Judge:
        problem = self.problem(samples)
        return Judge(
            problem.variables,
            problem.y,
            problem.view,
            group=samples.group,
            instants=samples.variables.get(self.time),
        )

    def rows(self, samples: Samples) -> Rows:
        """Return the left-hand side without its known part, and how far it can be trusted."""
        if self.state in samples.weak:
            weak = samples.weak[self.state]
            known = 0.0
            if self.known is not None:
                known = weak.matrix @ self._given(samples)
            return Rows(
                weak.target - known, _positive(weak.error), lambda c: weak.matrix @ c, False
            )
        y = self.remainder(samples)
        error = samples.errors.get(self.state)
        if error is not None:
            return Rows(y, _positive(error), lambda columns: columns, True)
        noise = samples.noise.get(self.state, 0.0)
        rounding = np.sqrt(_ROUNDING * np.mean(y**2)) or 1.0
        return Rows(y, np.full(len(y), max(noise, rounding)), lambda columns: columns, False)


@dataclass(frozen=True)
class Rows:
    """Rows of one regression.

    Attributes
    ----------
    target, error : ndarray, (rows,)
    seen : callable
        Columns (samples, k) to (rows, k).
    exact : bool
        Whether the errors are those of differences of clean samples, and no noise is left.
    """

    target: np.ndarray
    error: np.ndarray
    seen: Callable[[np.ndarray], np.ndarray]
    exact: bool


def _positive(error: np.ndarray) -> np.ndarray:
    """Return errors of which none is zero: a signal at rest seems to have none."""
    return np.maximum(error, _ROUNDING * float(np.max(error, initial=0.0)) or 1.0)


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
    weak = task.state in every.weak
    parts = (train, validation) if weak else ()
    if any(task.state not in p.weak or len(p.weak[task.state].target) < _FEWEST for p in parts):
        train = validation = every  # blocks shorter than test functions hold none
    few = train if weak else train.take(thinned(np.arange(len(train)), MOST_ROWS))
    by_validation = task.config.fitness.data == "validation"
    if _TINY <= len(every) < _SHORT and not by_validation:
        few = every  # every sample counts for finding a law; coefficients are judged apart
    problem = task.problem(few, validation if by_validation else None)
    scale = float(np.mean(train.targets[task.state] ** 2))
    if problem.total <= 1e-24 * scale * len(few):
        return final_estimate(task, (), every)
    found, reason = search(
        rng,
        problem,
        task.config,
        guesses=task.guesses,
        budget=budget,
        progress=progress,
        keeper=task.keeper(problem),
    )
    judged = train if weak else train.take(thinned(np.arange(len(train)), MOST_JUDGED))
    whole = task.problem(judged)
    sets = [(), *(member.terms for member in found.front.members)]
    if not found.front.best_loss <= 4.0 * problem.floor:
        with contextlib.suppress(OutOfTime), bounded(problem, task.expired):
            sets += best_subsets(problem, task.config)
    if not task.autonomous:  # time must earn its place beside the same law without it
        sets += [tuple(t for t in terms if task.time not in t.variables) for terms in sets]
    sets = list({frozenset(terms): terms for terms in reversed(sets)}.values())
    if task.time:  # else rows have no neighbours
        kept = resolved((t for s in sets for t in s), judged.variables, judged.group, task.time)
        sets = [s for s in sets if kept.issuperset(s)]
    usable = [s for s in sets if -1 not in whole.index(s)]
    return replace(chosen_of(task, usable, whole, validation, every), stopped_by=reason)


def chosen_of(
    task: Task,
    sets: Sequence[Sequence[Term]],
    problem: RegressionProblem,
    judge: Samples,
    every: Samples,
) -> Equation:
    """Return the equation of the set of terms that does best on other rows.

    Parameters
    ----------
    task : Task
    sets : sequence of sequence of Term
    problem : RegressionProblem
        On which the sets are fitted.
    judge : Samples
        Rows to choose by.
    every : Samples
        Rows of the final estimate.
    """
    candidates, pick = choose(problem, sets, task.problem(judge))
    chosen = candidates[pick]
    mean_square = float(np.mean(problem.y**2))
    return replace(
        final_estimate(task, chosen.fit.terms, every),
        train_mse=chosen.train_mse,
        validation_mse=chosen.validation_mse,
        front=tuple(candidates),
        pick=pick,
        exact=chosen.train_mse <= max(4.0 * problem.floor, EXACT) * mean_square,
        noise_mse=problem.noise * mean_square,
    )


def final_estimate(task: Task, terms: Sequence[Term], samples: Samples) -> Equation:
    """Estimate the chosen terms on all rows, with intervals."""
    problem = task.problem(samples)
    with contextlib.suppress(OutOfTime), bounded(problem, task.expired):
        terms = rounded(problem, terms) if terms else ()
    terms = edit(terms)
    fit = problem.fit(terms)
    theta = problem.projected(terms)
    residual = problem.y - theta @ fit.coefficients
    slopes = constant_slopes(problem, terms, fit.coefficients)
    both = np.hstack([theta, slopes])
    padded = np.concatenate([fit.coefficients, np.zeros(slopes.shape[1])])
    ends = coefficient_ci95(both, residual, padded) if terms else np.zeros((0, 2))
    given = split(task.known) if task.known is not None else []
    fitted = [FittedTerm(term, c, (c, c), given=True) for c, term in given]
    fitted += [
        FittedTerm(term, float(c), (float(low), float(high)))
        for term, c, (low, high) in zip(terms, fit.coefficients, ends, strict=False)
    ]
    error = task.remainder(samples) - task.predicted(terms, fit.coefficients, samples)
    mse = float(np.mean(error**2))
    return Equation(task.state, tuple(fitted), mse, mse)
