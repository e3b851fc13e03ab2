"""From a set of mechanisms to its mode and evidence: linearise, weigh, smooth, and again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.evidence import Gram, Mode, Prior, modes
from jaxsr.diagnosis.likelihood.kalman import Latent, System, smoothed
from jaxsr.diagnosis.likelihood.local import LocalModel, linearised
from jaxsr.diagnosis.likelihood.scales import (
    NEARBY,
    Scales,
    grams,
    likeliest_size,
    log_odds,
    sizes_about,
)
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import through_events

MOST = 10
"""Linearisations of one estimate."""
SETTLED = 0.3
"""Step of a constant, in its posterior deviation, that ends the iteration."""
HALVED = (1.0, 0.5, 0.2)
"""Shares of a step that are tried."""
CALM = 0.5
"""Change of the log evidence that ends the iteration, once where the constants rest, else twice in
a row."""
BEHIND, CATCHING = 12.0, 0.25
"""Log evidence behind the best known that leaves a set no say (odds of e^-12), and the share of
what is missing that a step has to gain where that much is missing."""
WORSE, FIRM = 1.0, 4
"""Log evidence that a step may lose, and first steps that may lose what their linearisations, about
paths that are no motion of the model, promised: not what there is where what is added does nothing,
but for what `BEHIND` leaves."""


@dataclass(frozen=True, eq=False)
class Belief:
    """What is believed of constants before the recordings: absolute values, not changes.

    Attributes
    ----------
    mean, deviation, low, high : ndarray, shape (constants,)
    floors : tuple of (int, int)
        Constants that are never below another one, and that one: believed is how far they are above
        it, which is their deviation and at least 0.
    """

    mean: np.ndarray
    deviation: np.ndarray
    low: np.ndarray
    high: np.ndarray
    floors: tuple[tuple[int, int], ...] = ()

    def about(self, theta: np.ndarray) -> Prior:
        """Return the priors of changes from these values; `mixing` says of what."""
        mean, low, high = self.mean - theta, self.low - theta, self.high - theta
        for above, below in self.floors:
            mean[above] = low[above] = theta[below] - theta[above]
            high[above] += theta[below] - self.low[below]
        return Prior(mean, self.deviation, low, high)

    @property
    def mixing(self) -> np.ndarray:
        """Changes of constants by the changes that the priors are of, shape (constants,) * 2."""
        matrix = np.eye(len(self.mean))
        for above, below in self.floors:
            matrix[above, below] = 1.0
        return matrix

    def inside(self, theta: np.ndarray) -> np.ndarray:
        """Return the values nearest to some that bounds leave."""
        found = np.clip(theta, self.low, self.high)
        for above, below in self.floors:
            found[above] = max(found[above], found[below])
        return found


@dataclass(frozen=True, eq=False)
class Estimate:
    """A set of mechanisms at its mode.

    Attributes
    ----------
    theta : ndarray, shape (parameters,)
    path : ndarray, shape (states, samples, pieces)
    share : float
        Size of the latent force that is left, as a share of the net force.
    mode : Mode
    settled : bool
        Whether the last step was a small one.
    local : LocalModel
        Linearised about the path and `theta`, by the constants that were estimated.
    latent : Latent
        Force of that size.
    decay : float
        Its correlation from sample to sample.
    """

    theta: np.ndarray
    path: np.ndarray
    share: float
    mode: Mode
    settled: bool
    local: LocalModel
    latent: Latent
    decay: float

    @property
    def log_evidence(self) -> float:
        """Of the mode, with the prior odds of its latent force."""
        return self.mode.log_evidence + float(log_odds(self.share))


def estimated(
    problem: Problem,
    theta: np.ndarray,
    path: np.ndarray,
    chosen: np.ndarray,
    helpers: np.ndarray,
    belief: Belief,
    scales: Scales,
    best: float = -np.inf,
    stop: Callable[[], bool] = lambda: False,
    inside: float = -np.inf,
) -> Estimate | None:
    """Iterate to the mode of a set; None where its steps are not finite.

    Parameters
    ----------
    theta : ndarray, shape (parameters,)
        Where it starts.
    path : ndarray, shape (states, samples, pieces)
    chosen : ndarray of int
        Parameters that are estimated.
    helpers : ndarray of int
        Parameters that stand for a force along an equation and stay where they are.
    belief : Belief
        Of the chosen parameters.
    best : float
        Log evidence of the best set known: one that cannot catch up is left as it is.
    stop : callable
        Whether time is over: the set is left where it is, not settled.
    inside : float
        Log evidence where what the set adds to another does nothing.
    """
    active = list(dict.fromkeys([*map(int, chosen), *map(int, helpers)]))
    scales = replace(scales, forces=tuple(active.index(int(j)) for j in helpers))
    climb = _Climb(problem, chosen, active, belief, best, stop, inside)
    point = climb.weighed(theta, path, scales, scales.shares)
    if point is None:
        return None
    point, settled = climb.to_the_mode(point, scales)
    for _ in range(len(scales.decays) - 1):
        if point.share == 0.0 or stop() or left(point.log, 0.0, best):
            break
        other = climb.in_other_time(point, scales)
        if other is None or other[0].log < point.log + CALM:
            break
        changed = replace(scales, decay=other[1])
        found, rests = climb.to_the_mode(other[0], changed)
        if found.log < point.log + CALM:  # about its own path it is no likelier
            break
        point, scales, settled = found, changed, rests
    latent = scales.latent(point.local, point.share)
    known = point.theta, point.path, point.share, point.mode, settled
    return Estimate(*known, point.local.by_first(len(chosen)), latent, scales.decay)


@dataclass(frozen=True, eq=False)
class _Climb:
    """The way of a set to its mode.

    Attributes
    ----------
    problem : Problem
    chosen : ndarray of int
        Parameters that are estimated.
    active : list of int
        These, and those that stand for latent forces.
    belief : Belief
        Of the chosen ones.
    best : float
        Log evidence of the best set known.
    stop : callable
        Whether time is over.
    inside : float
        Log evidence where what the set adds to another does nothing.
    """

    problem: Problem
    chosen: np.ndarray
    active: list[int]
    belief: Belief
    best: float
    stop: Callable[[], bool]
    inside: float

    def weighed(
        self, theta: np.ndarray, path: np.ndarray, scales: Scales, shares: np.ndarray
    ) -> _Point | None:
        """Linearise about a path, and weigh sizes of the latent force."""
        problem = self.problem
        args = problem.simulator, problem.stepping, problem.segments, theta, path
        local = linearised(*args, self.active)
        if not local.leads_on:
            return None
        return self._judged(theta, path, local, shares, lambda: grams(local, scales, shares))

    def _judged(
        self,
        theta: np.ndarray,
        path: np.ndarray,
        local: LocalModel,
        shares: np.ndarray,
        made: Callable[[], list[Gram]],
    ) -> _Point | None:
        prior, mixing = self.belief.about(theta[self.chosen]), self.belief.mixing
        try:
            found = modes(made(), range(len(mixing)), prior, mixing)
        except np.linalg.LinAlgError:  # derivatives that are no numbers
            return None
        logs = np.array([m.log_evidence for m in found])
        if not np.isfinite(logs).any():
            return None
        logs = np.where(np.isfinite(logs), logs, -np.inf)
        logs += log_odds(shares)
        return _Point(theta, path, local, shares, found, logs)

    def to_the_mode(self, point: _Point, scales: Scales) -> tuple[_Point, bool]:
        """Linearise, weigh, smooth, and again; return whether the last step was a small one."""
        theta, belief = point.theta, self.belief
        chosen, spare = self.chosen, np.zeros(len(self.active) - len(self.chosen))
        settled, calm = False, False
        for number in range(MOST):
            if self.stop():
                return point, False
            there = belief.inside(theta[chosen] + point.mode.change)
            change = there - theta[chosen]
            little = SETTLED * point.mode.deviation + 1e-12 * np.abs(theta[chosen])
            local = point.local.moved(np.concatenate([change, spare]))
            latent = scales.latent(point.local, point.share)
            noise = scales.noise.scaled(point.mode.noise)
            moved = smoothed(System.of(local, [latent], [noise], scales.start), len(point.path))
            settled = bool(np.all(np.abs(change) <= little))
            least = self.inside - BEHIND if number < FIRM else point.log - WORSE
            tried, kept = self._along(point, (change, moved), scales, least)
            if not tried:
                return point, False
            after = max(tried, key=lambda p: p.log) if not kept else tried[-1]
            if not kept and number >= FIRM:  # what it promises is not there: less is, at most
                return after, False
            gain = after.log - point.log
            point, theta = after, after.theta
            # Two steps without a gain are at the mode, however short deviations are.
            settled = abs(gain) < CALM and (settled or calm)
            if settled or (number >= FIRM and left(point.log, gain, self.best)):
                break
            calm = abs(gain) < CALM
        return point, settled

    def _along(
        self, point: _Point, step: tuple[np.ndarray, np.ndarray], scales: Scales, least: float
    ) -> tuple[list[_Point], bool]:
        """Weigh shares of a step, the whole first, until one has `least`, or less than the last.

        Returned are those that are finite, and whether the last of them has that.

        Parameters
        ----------
        step : tuple of ndarray
            Changes of the chosen constants, and of the path.
        """
        around = likeliest_size(point.shares, point.logs)
        shares, tried = sizes_about(around, scales.shares), list[_Point]()
        for share in HALVED:
            theta = point.theta.copy()
            theta[self.chosen] += share * step[0]
            path = self._motion((point.theta, point.path), (theta, point.path + share * step[1]))
            found = self.weighed(theta, path, scales, shares)
            if found is None:
                continue
            tried.append(found)
            if found.log > least:
                return tried, True
            if len(tried) > 1 and found.log <= tried[-2].log:
                break
        return tried, False

    def _motion(
        self, before: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray]
    ) -> np.ndarray:
        """Return a moved path; about events it is where the model leads."""
        problem = self.problem
        if not problem.simulator.model.events:
            return after[1]
        with np.errstate(all="ignore"):
            args = problem.simulator, problem.stepping, problem.segments
            return through_events(*args, before, after)

    def in_other_time(self, point: _Point, scales: Scales) -> tuple[_Point, float] | None:
        """Weigh latent forces that keep their sign for longer, or less long, about one path."""
        others = [d for d in scales.decays if d != scales.decay]
        sizes = likeliest_size(point.shares, point.logs) * np.array(NEARBY)
        shares, decays = np.tile(sizes, len(others)), np.repeat(others, len(sizes))
        found = self._judged(
            point.theta,
            point.path,
            point.local,
            shares,
            lambda: grams(point.local, scales, shares, list(decays)),
        )
        return None if found is None else (found, float(decays[found.best]))


def left(log: float, gain: float, best: float) -> bool:
    """Whether a set is so far behind the best, by log evidence, that its last gain is no hope."""
    return best - log > BEHIND and gain < CATCHING * (best - log)


@dataclass(frozen=True, eq=False)
class _Point:
    """A linearisation and what it says of the constants, by size of the latent force."""

    theta: np.ndarray
    path: np.ndarray
    local: LocalModel
    shares: np.ndarray
    modes: list[Mode]
    logs: np.ndarray  # log evidence and prior odds

    @property
    def best(self) -> int:
        return int(np.argmax(self.logs))

    @property
    def share(self) -> float:
        return float(self.shares[self.best])

    @property
    def mode(self) -> Mode:
        return self.modes[self.best]

    @property
    def log(self) -> float:
        return float(self.logs[self.best])
