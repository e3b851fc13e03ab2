"""Choose among the fronts by simulation on held-back stretches, and estimate by simulation.

An equation can fit derivatives well and simulate badly, and where states are noisy the constants
of a regression are biased by it. So the last word is had by roll-outs: each candidate's constants
are fitted to the recorded states, and it is judged by how it simulates stretches that had no part
in them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr._progress import Budget
from jaxsr._result import StoppedBy
from jaxsr.discovery.equation import Equation, FittedTerm, cut_short, weighted_sum
from jaxsr.discovery.find import Task
from jaxsr.discovery.rollout import RolloutFit, Segments, System, cut, fine_enough, fit_rollout
from jaxsr.discovery.samples import Trace
from jaxsr.expressions.term import Term

_SEGMENTS = 8  # stretches that a single recording is cut into
_SHORTEST, _LONGEST = 12, 257  # samples of a stretch
_MOST = 32  # stretches in all
_WORTH = 1.02  # an error within this factor of the best is as good
_WHOLE = 2000  # samples of a recording that counts as whole
_FOLLOWED = 1.3  # rise of the error at which a longer stretch is no longer followed
_QUICK, _THOROUGH = 8, 20  # iterations of a candidate's fit, and of the last one
_PICKING = 0.6  # share of the time for equations one by one; the rest is for all together
_RIVALS = 12  # candidates of an equation that are tried together with the others
_NODE = 2.0  # price of a node, in twice the logarithm of a likelihood
_ROWS = 60.0  # rows that overlapping test functions are worth
_LONG = 4  # picks that are fitted to whole recordings
_PATIENCE = 30  # candidates that may follow the best one
_FEW, _HOPELESS = 4, 100.0  # what fits worse than noise, or few terms, by so much is left out
_BELOW_NOISE = 0.5  # mean square over the noise's below which fits differ by numerics alone
_NOISE_LIMITED = 1.5  # mean square over the noise's up to which noise is all that is left

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
        iterations: int = _QUICK,
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
            expired=lambda: self.budget.exhausted,
        )
        return None if fitted is None else (system, fitted)

    def judged(self, result: Result) -> RolloutFit | None:
        """Return the roll-outs of the stretches to choose by: constants as fitted, starts free."""
        if self.judge is None:
            return result[1]
        terms, weights = _moved(result)
        known = {s: weighted_sum(terms[s], weights[s]) for s in terms if terms[s]}
        known |= {
            s: Term.apply("add", self.known[s], known[s]) if s in known else self.known[s]
            for s in terms
            if s in self.known
        }
        fixed = System({s: () for s in terms}, known)
        none = np.zeros(0)
        steps = self.substeps
        return fit_rollout(fixed, self.judge, none, time=self.time, substeps=steps)


def settle(
    equations: Sequence[Equation],
    tasks: Mapping[str, Task],
    traces: Sequence[Trace],
    budget: Budget,
    validation: Sequence[Trace] = (),
    given: Collection[str] = (),
) -> list[Equation]:
    """Return the equations with picks and constants that simulate best.

    Equations that leave no more than the error of clean derivatives stay as they are: simulation
    could tell nothing more. So does everything where no candidate can be simulated. Candidates are
    judged on ``validation``, where there is any, else by leaving stretches out. Of states in
    ``given``, whose derivatives are columns, the regression has seen more than a simulation can:
    roll-outs may take a simpler candidate than its pick, or another one, but none of more terms.
    Where the budget, or an equation's share of it, ends them early, ``stopped_by`` says so.
    """
    open_ = [e.state for e in equations if _is_open(e)]
    if not open_:
        return list(equations)
    found = {e.state: e for e in equations}
    longest = max(len(trace["time"]["t"]) for trace in traces)
    pieces = max(1, _SEGMENTS // len(traces))
    length = int(np.clip(longest // pieces + 1, _SHORTEST, _LONGEST))
    time = next(iter(tasks.values())).time
    known = {s: task.known for s, task in tasks.items() if task.known is not None}
    known |= {e.state: e.term for e in equations if not _is_open(e)}
    judge = cut(validation, length, _MOST) if validation else None
    trial = Trial(cut(traces, length, _MOST), time, known, budget, judge=judge)
    rankings: dict[str, list[int]] = {}
    reasons: list[StoppedBy] = []
    for place, state in enumerate(open_):
        share = replace(trial, budget=budget.share(_PICKING / (len(open_) - place * _PICKING)))
        companions = _companions(state, trial, equations)
        ranked = _ranked(found[state], share, companions, state in given)
        rankings[state] = ranked or [found[state].pick]
        reasons.append(share.budget.stopped_by)
    whole = replace(trial, segments=cut(traces, min(longest, _WHOLE), len(traces)))
    found, result = _together(found, rankings, trial, whole)
    estimated = _estimated(found, result, trial, traces, length)
    reasons.append(budget.stopped_by)
    return [
        replace(e, stopped_by=cut_short([e.stopped_by, *reasons]) or e.stopped_by)
        if _is_open(e)
        else e
        for e in estimated
    ]


def _is_open(equation: Equation) -> bool:
    """Tell whether roll-outs may choose and estimate an equation: searched, and not exact."""
    return bool(equation.front) and not equation.exact


def _companions(state: str, trial: Trial, equations: Sequence[Equation]) -> list[str]:
    """Return states without search that must be simulated too, for ``state`` has no sensor."""
    if state in trial.segments.measured:
        return []
    return [
        e.state
        for e in equations
        if not e.front and state in e.term.variables and e.state in trial.segments.measured
    ]


def _ranked(
    equation: Equation, trial: Trial, companions: Sequence[str], no_more: bool
) -> list[int]:
    """Return the places on the front that simulate best for what they cost, best first."""
    judged: list[Judged] = []
    since = 0
    most = len(equation.front[equation.pick].fit.terms) if no_more else np.inf
    for k in _hopeful(equation):
        if len(equation.front[k].fit.terms) > most:
            continue
        if trial.budget.exhausted or since >= _PATIENCE:
            break
        candidate = equation.front[k]
        terms: dict[str, Sequence[Term]] = {s: () for s in companions}
        terms[equation.state] = candidate.fit.terms
        weights = {s: [] for s in companions}
        weights[equation.state] = candidate.fit.coefficients.tolist()
        result = trial.fit(terms, weights)
        since += 1
        told = None if result is None else trial.judged(result)
        if told is not None:
            judged.append(Judged(k, told, candidate.size))
            since = 0 if judged[-1].length <= min(j.length for j in judged) else since
    return _order(_distinct(judged))[:_RIVALS]


@dataclass(frozen=True)
class Judged:
    """A candidate's place on the front, its roll-outs, and its complexity."""

    place: int
    fit: RolloutFit
    size: int

    @property
    def length(self) -> float:
        """Return the description length: N log(loss) + k log N + 2 complexity."""
        count = self.fit.count
        free = len(self.fit.constants)
        loss = max(self.fit.loss, _BELOW_NOISE)
        told = count * float(np.log(loss)) + free * float(np.log(count))
        return told + _NODE * self.size


def _distinct(judged: Sequence[Judged]) -> list[Judged]:
    """Leave out what simulates the same as something plainer: sign(x) for 1 where x > 0."""
    out: dict[tuple[int, float], Judged] = {}
    for j in sorted(judged, key=lambda j: j.size):
        out.setdefault((len(j.fit.constants), float(f"{j.fit.loss:.6g}")), j)
    return list(out.values())


def _order(judged: Sequence[Judged]) -> list[int]:
    """Order by description length where noise limits the fit, else by held-back stretches.

    Where something of the motion is left unexplained, its residuals are no noise and a
    likelihood would pay for any term that bends towards them. Where only noise is left,
    stretches are the blunter tool: a motion that dies out is told by its beginning alone.
    """
    if not judged:
        return []
    if min(j.fit.loss for j in judged) <= _NOISE_LIMITED:
        return [j.place for j in sorted(judged, key=lambda j: j.length)]
    ranked = sorted(judged, key=lambda j: float(np.sum(j.fit.held_back)))
    best = ranked[0].fit.held_back
    first = next(j for j in judged if _as_good(j.fit.held_back, best))
    return [first.place, *(j.place for j in ranked if j is not first)]


def _hopeful(equation: Equation) -> list[int]:
    """Return the places of candidates whose rows are not fitted much worse, best first.

    Best by a description length of the rows, in which gains below the noise count for nothing.
    """
    front = equation.front
    small = [c.train_mse for c in front if 0 < len(c.fit.terms) <= _FEW and c.train_mse > 0.0]
    limit = _HOPELESS * max(min(small, default=np.inf), equation.noise_mse)
    good = [k for k, c in enumerate(front) if np.isfinite(c.validation_mse) and c.fit.terms]
    near = [k for k in good if front[k].train_mse <= limit] or good

    def length(k: int) -> float:
        told = np.log(front[k].train_mse + equation.noise_mse + 1e-300)
        return _ROWS * float(told) + _NODE * front[k].size

    return sorted(near, key=length)


def _together(
    found: Mapping[str, Equation], rankings: Mapping[str, Sequence[int]], trial: Trial, whole: Trial
) -> tuple[dict[str, Equation], Result | None]:
    """Choose the picks whose equations simulate together, the whole recordings if they can.

    An equation may follow recorded neighbours well and still, once they are simulated too, lead
    the whole system astray; and a neighbour that changed fast was smoothed. So the picks are
    improved one equation at a time, all of them simulated, until nothing is gained. The best few
    are then fitted to whole recordings, which alone tell slow motions apart: the shortest
    description of these is taken or, where none can be followed so far, as in chaos, the
    shortest of the stretches.
    """
    tried: dict[tuple[int, ...], tuple[float, dict[str, int], Result | None]] = {}

    def length(picks: dict[str, int]) -> float:
        key = tuple(picks.values())
        if key not in tried:
            chosen = _with_picks(found, picks)
            terms = {s: _terms(e) for s, e in chosen.items()}
            result = trial.fit(terms, {s: _coefficients(e) for s, e in chosen.items()}, _QUICK)
            tried[key] = _described(chosen, result, trial), picks, result
        return tried[key][0]

    best = {state: order[0] for state, order in rankings.items()}
    shortest, before = length(best), np.inf
    while len(rankings) > 1 and shortest < before and not trial.budget.exhausted:
        before = shortest
        for state, order in rankings.items():
            for place in order:
                if trial.budget.exhausted:
                    break
                if (after := length(best | {state: place})) < shortest:
                    best, shortest = best | {state: place}, after
    if len(rankings) == 1:
        for place in next(iter(rankings.values()))[:_LONG]:
            length({state: place for state in rankings})
    picks, result = _longest_followed(found, list(tried.values()), whole)
    return _with_picks(found, picks or best), result


def _longest_followed(
    found: Mapping[str, Equation],
    tried: Sequence[tuple[float, dict[str, int], Result | None]],
    whole: Trial,
) -> tuple[dict[str, int] | None, Result | None]:
    """Return the picks that describe whole recordings best, of those few that stretches prefer."""
    few = sorted((t for t in tried if t[2] is not None), key=lambda t: t[0])[:_LONG]
    followed: list[tuple[float, dict[str, int], Result]] = []
    for _, picks, result in few:
        if result is None or (whole.budget.exhausted and followed):
            break
        longer = whole.fit(*_moved(result), iterations=_QUICK)
        if longer is not None and longer[1].loss <= _FOLLOWED * result[1].loss:
            told = _described(_with_picks(found, picks), longer, whole)
            followed.append((told, picks, result))
    if followed:
        _, picks, result = min(followed, key=lambda item: item[0])
        return picks, result
    return (few[0][1], few[0][2]) if few else (None, None)


def _described(chosen: Mapping[str, Equation], result: Result | None, trial: Trial) -> float:
    told = None if result is None else trial.judged(result)
    if told is None:
        return np.inf
    return Judged(0, told, sum(e.front[e.pick].size for e in chosen.values() if _is_open(e))).length


def _with_picks(found: Mapping[str, Equation], picks: Mapping[str, int]) -> dict[str, Equation]:
    return {s: replace(e, pick=picks.get(s, e.pick)) for s, e in found.items()}


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
    result: Result | None,
    trial: Trial,
    traces: Sequence[Trace],
    length: int,
) -> list[Equation]:
    """Fit all equations together, over stretches as long as they can be followed."""
    if result is None:
        return list(found.values())
    longest = max(len(trace["time"]["t"]) for trace in traces)
    while not trial.budget.exhausted:
        steps = fine_enough(result[0], trial.segments, result[1], time=trial.time)
        if steps > trial.substeps:  # the misfit must not be the method's
            trial = replace(trial, substeps=steps)
        elif length < min(longest, 2 * _LONGEST):
            length = min(2 * length, longest, 2 * _LONGEST)
            trial = replace(trial, segments=cut(traces, length, _MOST))
        else:
            break
        after = trial.fit(*_moved(result), iterations=_THOROUGH)
        if after is None or after[1].loss > _FOLLOWED * result[1].loss:
            break
        result = after
    system, fitted = result
    ends = fitted.ci95()
    parts = system.unpacked(fitted.constants)
    return [_with_constants(e, parts[s], ends) if _is_open(e) else e for s, e in found.items()]


def _moved(result: Result) -> tuple[dict[str, tuple[Term, ...]], dict[str, list[float]]]:
    """Return the terms and coefficients of a fit, to start the next one from."""
    parts = result[0].unpacked(result[1].constants)
    terms = {s: tuple(t for t, _, _ in rows) for s, rows in parts.items()}
    return terms, {s: [c for _, c, _ in rows] for s, rows in parts.items()}


def _terms(equation: Equation) -> tuple[Term, ...]:
    return equation.front[equation.pick].fit.terms if _is_open(equation) else ()


def _coefficients(equation: Equation) -> list[float]:
    return equation.front[equation.pick].fit.coefficients.tolist() if _is_open(equation) else []


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
