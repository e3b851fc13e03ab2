"""Candidates of one equation, ranked by how they simulate for what they cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.discovery.equation import Equation
from jaxsr.discovery.rollout import RolloutFit
from jaxsr.discovery.trial import Trial
from jaxsr.expressions.term import Term

_WORTH = 1.02  # an error within this factor of the best is as good
_RIVALS = 12  # candidates of an equation that are tried together with the others
NODE = 2.0
"""Price of a node, in twice the logarithm of a likelihood."""
_ROWS = 60.0  # rows that overlapping test functions are worth
_PATIENCE = 30  # candidates that may follow the best one
_FEW, _HOPELESS = 4, 100.0  # what fits worse than noise, or few terms, by so much is left out
_BELOW_NOISE = 0.5  # mean square over the noise's below which fits differ by numerics alone
_NOISE_LIMITED = 1.5  # mean square over the noise's up to which noise is all that is left


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
        return told + NODE * self.size


def ranked_places(
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


def _as_good(error: np.ndarray, best: np.ndarray) -> bool:
    """Tell whether an error is within one standard error, over stretches, of the best."""
    apart = error - best
    if np.sum(error) <= _WORTH * np.sum(best):
        return True
    if len(apart) < 2:
        return False
    return float(np.mean(apart)) <= float(np.std(apart, ddof=1)) / np.sqrt(len(apart))


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
        return _ROWS * float(told) + NODE * front[k].size

    return sorted(near, key=length)
