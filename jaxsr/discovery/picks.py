"""One pick from every front, such that all equations simulate together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jaxsr.discovery.equation import Equation
from jaxsr.discovery.ranking import Judged
from jaxsr.discovery.trial import QUICK, Result, Trial, is_open, moved
from jaxsr.expressions.term import Term

_LONG = 4  # picks that are fitted to whole recordings
FOLLOWED = 1.3  # rise of the error at which a longer stretch is no longer followed


def together(
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
            result = trial.fit(terms, {s: _coefficients(e) for s, e in chosen.items()}, QUICK)
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
        longer = whole.fit(*moved(result), iterations=QUICK)
        if longer is not None and longer[1].loss <= FOLLOWED * result[1].loss:
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
    return Judged(0, told, sum(e.front[e.pick].size for e in chosen.values() if is_open(e))).length


def _with_picks(found: Mapping[str, Equation], picks: Mapping[str, int]) -> dict[str, Equation]:
    return {s: replace(e, pick=picks.get(s, e.pick)) for s, e in found.items()}


def _terms(equation: Equation) -> tuple[Term, ...]:
    return equation.front[equation.pick].fit.terms if is_open(equation) else ()


def _coefficients(equation: Equation) -> list[float]:
    return equation.front[equation.pick].fit.coefficients.tolist() if is_open(equation) else []
