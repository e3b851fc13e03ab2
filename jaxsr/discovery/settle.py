"""Choose among the fronts by simulation on held-back stretches, and estimate by simulation.

An equation can fit derivatives well and simulate badly, and where states are noisy the constants
of a regression are biased by it. So the last word is had by roll-outs: each candidate's constants
are fitted to the recorded states, and it is judged by how it simulates stretches that had no part
in them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._progress import Budget
from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.find import Task
from jaxsr.discovery.rollout import RolloutFit, Segments, System, cut, fit_rollout
from jaxsr.expressions.term import Term

_SEGMENTS = 8  # stretches that a single recording is cut into
_SHORTEST, _LONGEST = 12, 257  # samples of a stretch
_MOST = 32  # stretches in all
_WORTH = 1.02  # an error within this factor of the best is as good
_FOLLOWED = 1.3  # rise of the error at which a longer stretch is no longer followed
_QUICK = 8  # iterations of a candidate's fit


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
    """

    segments: Segments
    time: str
    known: Mapping[str, Term]
    budget: Budget

    def fit(
        self,
        terms: Mapping[str, Sequence[Term]],
        coefficients: Mapping[str, Sequence[float]],
        iterations: int = _QUICK,
    ) -> tuple[System, RolloutFit] | None:
        """Fit the constants of some states' equations, the other states driving them."""
        system = System(terms, {s: self.known[s] for s in terms if s in self.known})
        fitted = fit_rollout(
            system,
            self.segments,
            system.constants(coefficients),
            time=self.time,
            iterations=iterations,
            expired=lambda: self.budget.exhausted,
        )
        return None if fitted is None else (system, fitted)


def settle(
    equations: Sequence[Equation],
    tasks: Mapping[str, Task],
    traces: Sequence[Mapping[str, Mapping[str, np.ndarray]]],
    budget: Budget,
) -> list[Equation]:
    """Return the equations with picks and constants that simulate best.

    Equations that leave no more than the error of clean derivatives stay as they are: simulation
    could tell nothing more. So does everything where no candidate can be simulated.
    """
    open_ = [e.state for e in equations if e.front and not e.exact]
    if not open_:
        return list(equations)
    found = {e.state: e for e in equations}
    longest = max(len(trace["time"]["t"]) for trace in traces)
    pieces = max(1, _SEGMENTS // len(traces))
    length = int(np.clip(longest // pieces + 1, _SHORTEST, _LONGEST))
    time = next(iter(tasks.values())).time
    known = {s: task.known for s, task in tasks.items() if task.known is not None}
    known |= {e.state: e.term for e in equations if not e.front and e.state not in known}
    trial = Trial(cut(traces, length, _MOST), time, known, budget)
    for state in open_:
        found[state] = _picked(found[state], trial, _companions(state, trial, equations))
    return _estimated(found, trial, traces, length)


def _companions(state: str, trial: Trial, equations: Sequence[Equation]) -> list[str]:
    """Return states without search that must be simulated too, for ``state`` has no sensor."""
    if state in trial.segments.measured:
        return []
    return [
        e.state
        for e in equations
        if not e.front and state in e.term.variables and e.state in trial.segments.measured
    ]


def _picked(equation: Equation, trial: Trial, companions: Sequence[str]) -> Equation:
    """Return the equation with the simplest candidate that simulates as well as the best."""
    errors: list[np.ndarray | None] = []
    for candidate in equation.front:
        if trial.budget.exhausted:
            break
        terms = {s: () for s in companions} | {equation.state: candidate.fit.terms}
        weights = {s: () for s in companions} | {equation.state: candidate.fit.coefficients}
        result = trial.fit(terms, weights) if np.isfinite(candidate.validation_mse) else None
        errors.append(None if result is None else result[1].held_back)
    totals = np.array([np.inf if e is None else float(np.sum(e)) for e in errors])
    if not np.any(np.isfinite(totals)):
        return equation
    best = errors[int(np.argmin(totals))]
    assert best is not None
    for k, error in enumerate(errors):
        if error is not None and _as_good(error, best):
            return replace(equation, pick=k)
    return equation


def _as_good(error: np.ndarray, best: np.ndarray) -> bool:
    """Tell whether an error is within one standard error, over stretches, of the best."""
    apart = error - best
    if np.sum(error) <= _WORTH * np.sum(best):
        return True
    if len(apart) < 2:
        return False
    return float(np.mean(apart)) <= float(np.std(apart, ddof=1)) / np.sqrt(len(apart))


def _estimated(
    found: Mapping[str, Equation],
    trial: Trial,
    traces: Sequence[Mapping[str, Mapping[str, np.ndarray]]],
    length: int,
) -> list[Equation]:
    """Fit all equations together, over stretches as long as they can be followed."""
    terms = {s: _terms(e) for s, e in found.items()}
    weights = {s: _coefficients(e) for s, e in found.items()}
    result = trial.fit(terms, weights, iterations=20)
    if result is None:
        return list(found.values())
    longest = max(len(trace["time"]["t"]) for trace in traces)
    while length < min(longest, _LONGEST) and not trial.budget.exhausted:
        length = min(2 * length, longest, _LONGEST * 2)
        system, fitted = result
        moved = system.unpacked(fitted.constants)
        longer = replace(trial, segments=cut(traces, length, _MOST))
        after = longer.fit(
            {s: tuple(t for t, _, _ in parts) for s, parts in moved.items()},
            {s: [c for _, c, _ in parts] for s, parts in moved.items()},
            iterations=20,
        )
        if after is None or after[1].loss > _FOLLOWED * fitted.loss:
            break
        result = after
    system, fitted = result
    ends = fitted.ci95()
    parts = system.unpacked(fitted.constants)
    return [_with_constants(e, parts[s], ends) if e.front else e for s, e in found.items()]


def _terms(equation: Equation) -> tuple[Term, ...]:
    return equation.front[equation.pick].fit.terms if equation.front else ()


def _coefficients(equation: Equation) -> np.ndarray:
    return equation.front[equation.pick].fit.coefficients if equation.front else np.zeros(0)


def _with_constants(
    equation: Equation, parts: Sequence[tuple[Term, float, slice]], ends: np.ndarray
) -> Equation:
    given = tuple(t for t in equation.terms if t.ci95[0] == t.ci95[1])
    fitted = tuple(
        FittedTerm(term, weight, (float(ends[place.start, 0]), float(ends[place.start, 1])))
        for term, weight, place in parts
    )
    chosen = equation.front[equation.pick]
    return replace(
        equation,
        terms=(*given, *fitted),
        train_mse=chosen.train_mse,
        validation_mse=chosen.validation_mse,
    )
