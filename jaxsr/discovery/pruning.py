"""Terms that tell less than they cost, left out of laws that simulate together.

Candidates are made one equation at a time, from rows on which a smoothed neighbour stands for what
is simulated later, so the best of them may hold a term that explained the smoothing alone. By the
description length that ranks candidates (`jaxsr.discovery.ranking`) a term costs its constants and
its nodes; its Wald statistic says beforehand what it tells, so that only doubtful ones are tried.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from jaxsr.discovery.ranking import NODE, Judged
from jaxsr.discovery.trial import QUICK, Result, Trial, moved
from jaxsr.evolution import complexity
from jaxsr.expressions.term import Term

_DOUBT = 2.0  # what a term tells may be that much more than its Wald statistic says


def pruned(result: Result, trial: Trial) -> Result:
    """Return a fit without the terms whose absence shortens its description.

    Parameters
    ----------
    result : (System, RolloutFit)
        All equations with free constants, simulated together.
    trial : Trial
        Its budget ends the work with what stands by then.
    """
    shortest = _length(result, trial)
    doubtful = list(_doubtful(result))
    while doubtful and np.isfinite(shortest):
        for state, place in doubtful:
            if trial.budget.exhausted:
                return result
            terms, weights = moved(result)
            terms[state] = _without(terms[state], place)
            weights[state] = list(_without(weights[state], place))
            after = trial.fit(terms, weights, QUICK)
            length = np.inf if after is None else _length(after, trial)
            if after is not None and length <= shortest:
                result, shortest = after, length
                break
        else:
            break
        doubtful = list(_doubtful(result))
    return result


def _without(items: Sequence, place: int) -> tuple:
    return (*items[:place], *items[place + 1 :])


def _length(result: Result, trial: Trial) -> float:
    told = trial.judged(result)
    if told is None:
        return np.inf
    terms: Mapping[str, Sequence[Term]] = moved(result)[0]
    return Judged(0, told, sum(complexity(tuple(own)) for own in terms.values())).length


def _doubtful(result: Result) -> Iterator[tuple[str, int]]:
    """Yield (state, place) of terms that may tell less than they cost, the least telling first."""
    system, fit = result
    spread = np.diag(fit.covariance)
    found = []
    for state, parts in system.unpacked(fit.constants).items():
        for place, (term, weight, own) in enumerate(parts):
            free = own.stop - own.start
            price = free * np.log(max(fit.count, 2)) + NODE * complexity((term,))
            told = weight**2 / max(float(spread[own.start]), np.finfo(float).tiny)
            if told < _DOUBT * price:
                found.append((told / price, state, place))
    yield from ((state, place) for _, state, place in sorted(found))
