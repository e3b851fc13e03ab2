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
from jaxsr.discovery.choose import Candidate
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
_PATIENCE = 12  # candidates that may follow the best one
_FEW, _HOPELESS = 4, 10.0  # a candidate that fits so much worse than one of few terms is left out
_NOISE_LIMITED = 1.5  # mean square over the noise's up to which noise is all that is left


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
    """Return the equation with the candidate that simulates best for what it costs."""
    judged: list[Judged] = []
    since = 0
    hopeful = _hopeful(equation.front)
    for k in hopeful:
        if trial.budget.exhausted or since >= _PATIENCE:
            break
        candidate = equation.front[k]
        terms = {s: () for s in companions} | {equation.state: candidate.fit.terms}
        weights = {s: () for s in companions} | {equation.state: candidate.fit.coefficients}
        result = trial.fit(terms, weights)
        since += 1
        if result is not None:
            judged.append(Judged(k, result[1], candidate.size))
            since = 0 if judged[-1].length <= min(j.length for j in judged) else since
    return replace(equation, pick=_best(judged)) if judged else equation


@dataclass(frozen=True)
class Judged:
    """A candidate's place on the front, its roll-outs, and its complexity."""

    place: int
    fit: RolloutFit
    size: int

    @property
    def length(self) -> float:
        """Return the description length of the samples: N log(loss) + k log N + complexity."""
        count = self.fit.count
        free = len(self.fit.constants)
        return count * float(np.log(self.fit.loss)) + free * float(np.log(count)) + self.size


def _best(judged: Sequence[Judged]) -> int:
    """Choose by description length where noise limits the fit, else by held-back stretches.

    Where something of the motion is left unexplained, its residuals are no noise and a
    likelihood would pay for any term that bends towards them. Where only noise is left,
    stretches are the blunter tool: a motion that dies out is told by its beginning alone.
    """
    if min(j.fit.loss for j in judged) <= _NOISE_LIMITED:
        return min(judged, key=lambda j: j.length).place
    best = min(judged, key=lambda j: float(np.sum(j.fit.held_back)))
    return next(j.place for j in judged if _as_good(j.fit.held_back, best.fit.held_back))


def _hopeful(front: Sequence[Candidate]) -> list[int]:
    """Return the places of candidates, smallest first, that fit derivatives not much worse."""
    small = [c.train_mse for c in front if 0 < len(c.fit.terms) <= _FEW and c.train_mse > 0.0]
    limit = _HOPELESS * min(small, default=np.inf)
    good = [k for k, c in enumerate(front) if np.isfinite(c.validation_mse) and c.fit.terms]
    return [k for k in good if front[k].train_mse <= limit] or good


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
