"""Choose among the fronts by simulation on held-back stretches, and estimate by simulation.

An equation can fit derivatives well and simulate badly, and where states are noisy the constants
of a regression are biased by it. So the last word is had by roll-outs: each candidate's constants
are fitted to the recorded states, and it is judged by how it simulates stretches that had no part
in them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxsr._deadline import OutOfTime
from jaxsr._progress import Budget
from jaxsr._result import StoppedBy
from jaxsr.discovery.equation import Equation, FittedTerm, cut_short
from jaxsr.discovery.find import Task
from jaxsr.discovery.picks import FOLLOWED, together
from jaxsr.discovery.pruning import pruned
from jaxsr.discovery.ranking import ranked_places
from jaxsr.discovery.rollout import cut, fine_enough
from jaxsr.discovery.samples import Trace
from jaxsr.discovery.trial import Result, Trial, is_open, moved
from jaxsr.expressions import to_text
from jaxsr.expressions.term import Term
from jaxsr.regression import constants_of, with_constants

_SEGMENTS = 8  # stretches that a single recording is cut into
_SHORTEST, _LONGEST = 12, 257  # samples of a stretch
_MOST = 32  # stretches in all
_WHOLE = 2000  # samples of a recording that counts as whole
_THOROUGH = 20  # iterations of the last fit
_PICKING = 0.6  # share of the time for equations one by one; the rest is for all together


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
    open_ = [e.state for e in equations if is_open(e)]
    if not open_:
        return list(equations)
    found = {e.state: e for e in equations}
    longest = max(len(trace["time"]["t"]) for trace in traces)
    pieces = max(1, _SEGMENTS // len(traces))
    length = int(np.clip(longest // pieces + 1, _SHORTEST, _LONGEST))
    time = next(iter(tasks.values())).time
    known = {s: task.known for s, task in tasks.items() if task.known is not None}
    known |= {e.state: e.term for e in equations if not is_open(e)}
    judge = cut(validation, length, _MOST) if validation else None
    trial = Trial(cut(traces, length, _MOST), time, known, budget, judge=judge)
    trial = replace(trial, substeps=steps_needed(found, trial))
    rankings: dict[str, list[int]] = {}
    reasons: list[StoppedBy] = []
    for place, state in enumerate(open_):
        share = replace(trial, budget=budget.share(_PICKING / (len(open_) - place * _PICKING)))
        companions = _companions(state, equations)
        ranked = ranked_places(found[state], share, companions, state in given)
        rankings[state] = ranked or [found[state].pick]
        reasons.append(share.budget.stopped_by)
    whole = replace(trial, segments=cut(traces, min(longest, _WHOLE), len(traces)))
    found, result = together(found, rankings, trial, whole)
    result = None if result is None else pruned(result, trial)
    estimated = _estimated(found, result, trial, traces, length)
    reasons.append(budget.stopped_by)
    return [
        replace(e, stopped_by=cut_short([e.stopped_by, *reasons]) or e.stopped_by)
        if is_open(e)
        else e
        for e in estimated
    ]


def steps_needed(found: Mapping[str, Equation], trial: Trial) -> int:
    """Return the steps between samples that the picks of the regression need.

    Where samples are far apart, the method's error of a right law is a wrong term's gain.
    """
    picks = {s: e.front[e.pick].fit for s, e in found.items() if is_open(e)}
    every = [s for state in picks for s in (state, *_companions(state, list(found.values())))]
    terms = {s: picks[s].terms if s in picks else () for s in every}
    weights = {s: picks[s].coefficients.tolist() if s in picks else [] for s in every}
    result = trial.fit(terms, weights)
    if result is None:
        return trial.substeps
    system, fitted = result
    try:
        return fine_enough(system, trial.segments, fitted, time=trial.time, expired=trial.expired)
    except OutOfTime:
        return trial.substeps


def _companions(state: str, equations: Sequence[Equation]) -> list[str]:
    """Return states without search that follow from ``state``, to be simulated along with it.

    They may have no sensor of their own; and where they have one, their samples are noisy, and
    what smoothing leaves of that noise would be explained by whatever term bends to it.
    """
    follow = [state]
    for _ in equations:
        follow += [
            e.state
            for e in equations
            if not e.front and e.state not in follow and e.term.variables & set(follow)
        ]
    return follow[1:]


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
        try:
            steps = fine_enough(
                result[0], trial.segments, result[1], time=trial.time, expired=trial.expired
            )
        except OutOfTime:
            break
        if steps > trial.substeps:  # the misfit must not be the method's
            trial = replace(trial, substeps=steps)
        elif length < min(longest, 2 * _LONGEST):
            length = min(2 * length, longest, 2 * _LONGEST)
            trial = replace(trial, segments=cut(traces, length, _MOST))
        else:
            break
        after = trial.fit(*moved(result), iterations=_THOROUGH)
        if after is None or after[1].loss > FOLLOWED * result[1].loss:
            break
        result = after
    system, fitted = result
    ends = fitted.ci95()
    parts = system.unpacked(fitted.constants)
    return [_with_constants(e, parts[s], ends) if is_open(e) else e for s, e in found.items()]


def _with_constants(
    equation: Equation, parts: Sequence[tuple[Term, float, slice]], ends: np.ndarray
) -> Equation:
    given = tuple(t for t in equation.terms if t.given)
    fitted = tuple(
        FittedTerm(term, weight, (float(ends[place.start, 0]), float(ends[place.start, 1])))
        for term, weight, place in parts
    )
    pick = _place(equation, [term for term, _, _ in parts])
    chosen = equation.front[pick]
    return replace(
        equation,
        terms=(*given, *fitted),
        pick=pick,
        train_mse=chosen.train_mse,
        validation_mse=chosen.validation_mse,
    )


def _place(equation: Equation, terms: Sequence[Term]) -> int:
    """Return the place on the front of terms, whatever their constants; else that of the pick."""
    same = sorted(map(_form, terms))
    places = [equation.pick, *range(len(equation.front))]
    fits = (sorted(map(_form, equation.front[k].fit.terms)) == same for k in places)
    return next((k for k, fit in zip(places, fits, strict=True) if fit), equation.pick)


def _form(term: Term) -> str:
    loose = constants_of(term)
    values = iter([v if float(v).is_integer() else 0.5 for v in loose])
    return to_text(with_constants(term, values))
