"""Laws that the data cannot tell from the one that was taken, and the experiment that could."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.discovery.choose import Candidate, predict
from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.evidence import ODDS, Evidence
from jaxsr.discovery.samples import Samples
from jaxsr.expressions.term import Term

_NEAR = 1.5  # mean square on rows held back over the pick's, up to which a candidate is run
_MOST = 2  # candidates of an equation that are run
_LISTED = 5  # laws that are listed
_SAME = 0.02  # rms difference of two rates over the rate's own, below which they are one law
_APART = 0.2  # the same beyond the data, above which an experiment could split them
_WIDER = 2.0  # how much further than the data an experiment may lead
_POINTS = 600

Judge = Callable[[Sequence[Equation]], "list[Evidence] | None"]


@dataclass(frozen=True, eq=False)
class Rival:
    """Another law for one state, the others as they are.

    Attributes
    ----------
    equations : tuple of Equation
    evidence : list of Evidence
    state : str
        Whose equation differs.
    apart : float
        Rms difference of the two rates within twice the range of the data, over the rate's own.
    place : dict of str to float
        Where, within twice the range of the data, the two rates differ most.
    difference : float
        By how much.
    """

    equations: tuple[Equation, ...]
    evidence: list[Evidence]
    state: str
    apart: float
    place: dict[str, float]
    difference: float


def rivals(
    equations: Sequence[Equation], taken: Sequence[Evidence], rows: Samples, judge: Judge
) -> list[Rival]:
    """Return laws as likely as the one taken, by the description length of their free runs.

    Of each front those candidates are run whose error on rows held back is near the pick's, that
    do not hold the pick's terms and more, and whose rate differs from the pick's beyond the data
    at least.
    """
    found = []
    best = description_length(taken)
    for place, equation in enumerate(equations):
        for other in _candidates(equation):
            rival = replace(equation, terms=_terms(other), pick=equation.front.index(other))
            apart = _apart(equation, rival, rows)
            if apart is None:
                continue
            every = (*equations[:place], rival, *equations[place + 1 :])
            evidence = judge(every)
            if evidence is None or not description_length(evidence) <= best + ODDS:
                continue
            found.append(
                (description_length(evidence), Rival(every, evidence, equation.state, *apart))
            )
    found.sort(key=lambda item: item[0])
    return [rival for _, rival in found[:_LISTED]]


def description_length(evidence: Sequence[Evidence]) -> float:
    """Return the description length in nats: what choosing the law costs less what it gains."""
    return -sum(e.net for e in evidence)


def _candidates(equation: Equation) -> Iterator[Candidate]:
    front = equation.front
    if not front or equation.exact:
        return
    pick = front[equation.pick]
    own = {t.term for t in equation.terms}
    limit = _NEAR * max(pick.validation_mse, equation.noise_mse)
    near = [c for c in front if c is not pick and c.fit.terms and c.validation_mse <= limit]
    count = 0
    for candidate in sorted(near, key=lambda c: (c.size, c.validation_mse)):
        terms = set(candidate.fit.terms)
        if terms >= own or len(terms) > len(own) + 1 or count == _MOST:
            continue
        count += 1
        yield candidate


def _terms(candidate: Candidate) -> tuple[FittedTerm, ...]:
    pairs = zip(candidate.fit.terms, candidate.fit.coefficients, strict=True)
    return tuple(FittedTerm(term, float(c), (-np.inf, np.inf)) for term, c in pairs)


def _apart(
    taken: Equation, rival: Equation, rows: Samples
) -> tuple[float, dict[str, float], float] | None:
    """Return how far two rates differ beyond the data, and where; None where they are one law."""
    scale = float(np.sqrt(np.mean(rows.targets[taken.state] ** 2))) or 1.0
    points = _points(rows)
    with np.errstate(all="ignore"):
        a, b = (_rate(e, points) for e in (taken, rival))
        difference = np.abs(a - b)
    difference = np.where(np.isfinite(difference), difference, 0.0)
    apart = float(np.sqrt(np.mean(difference**2))) / scale
    if apart <= _SAME:
        return None
    where = int(np.argmax(difference))
    return apart, {n: float(v[where]) for n, v in points.items()}, float(difference[where])


def _rate(equation: Equation, points: dict[str, np.ndarray]) -> np.ndarray:
    terms: list[Term] = [t.term for t in equation.terms]
    weights = np.array([t.coefficient for t in equation.terms])
    return predict(terms, weights, points, time=next(iter(points)))


def _points(rows: Samples) -> dict[str, np.ndarray]:
    """Return recorded rows, drawn apart from their middle to twice their range; time as it is."""
    chosen = np.unique(np.linspace(0, len(rows) - 1, _POINTS).round().astype(int))
    time = next(iter(rows.variables))
    out = {}
    for name, values in rows.variables.items():
        own = values[chosen]
        middle = 0.5 * (np.max(values) + np.min(values))
        out[name] = own if name == time else middle + _WIDER * (own - middle)
        if np.all(values > 0.0):  # what is never negative may have no meaning there
            out[name] = np.maximum(out[name], 0.5 * np.min(values))
    return out


def experiment(found: Sequence[Rival], rows: Samples) -> str:
    """Say which experiment would split the laws."""
    rival = max(found, key=lambda r: r.apart)
    time = next(iter(rows.variables))
    parts = []
    for name, value in rival.place.items():
        if name == time:
            continue
        low, high = (float(f(rows.variables[name])) for f in (np.min, np.max))
        parts.append(f"{name} = {value:.3g} (recorded: {low:.3g} to {high:.3g})")
    if rival.apart < _APART or not parts:
        return (
            "the laws differ little within twice the range of the data: "
            "a longer recording with less noise would split them"
        )
    return (
        f"a recording near {', '.join(parts)} would split them: there the rates of {rival.state} "
        f"differ by {rival.difference:.3g}"
    )
