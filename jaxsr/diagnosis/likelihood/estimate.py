"""From a set of mechanisms to its mode and evidence: linearise, weigh, smooth, and again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.evidence import Gram, Mode, Prior
from jaxsr.diagnosis.likelihood.kalman import Latent, Noise, System, smoothed, whitened
from jaxsr.diagnosis.likelihood.local import LocalModel, linearised
from jaxsr.models.least_squares import Problem

MOST = 10
"""Linearisations of one estimate."""
SETTLED = 0.3
"""Step of a constant, in its posterior deviation, that ends the iteration."""
HALVED = (1.0, 0.5, 0.2)
"""Shares of a step that are tried."""
NEARBY, BARELY, CALM = (0.5, 0.8, 1.0, 1.25, 2.0), (0.5, 1.0, 2.0), 0.5
"""Sizes of the latent force, in that of the last step, that are tried, and where there was none in
a quarter of the least; change of the log evidence that ends the iteration, once where the constants
rest, else twice in a row."""
BEHIND, CATCHING = 12.0, 0.25
"""Log evidence behind the best known that leaves a set no say (odds of e^-12), and the share of
what is missing that a step has to gain where that much is missing."""
LOUDEST = 4.0
"""Variance of a sensor's noise in that which neighbouring samples tell: more is not its noise."""
PRESENT, BEYOND = 1.0 / 7.0, 0.05
"""Prior odds of a small latent force of one size against none, as seven sizes share even odds, and
what is left of them at the size of the net force: they fall exponentially (Simpson et al. 2017,
Stat. Sci. 32, section 3.3). The times that it may take are not paid for: what is likeliest among
them stands for several."""
ROOM = 2e7
"""Numbers of innovations and their derivatives that are held at once."""
WORSE, FIRM = 1.0, 4
"""Log evidence that a step may lose, and steps that are taken whole: what the first linearisations
promise, about paths that are no motion of the model, is not kept."""


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
class Scales:
    """Sizes that the latent force may have, and how long it keeps its sign.

    Attributes
    ----------
    forces : tuple of int
        Where the constants that stand for a force along each equation are among the columns.
    size : ndarray, shape (forces,)
        Rms of the net force.
    shares : ndarray, shape (choices,)
        Of it, in rising order; the first is 0.
    decay : float
        Correlation from sample to sample.
    decays : tuple of float
        Others that it may have.
    noise : Noise
    told : ndarray, shape (outputs,)
        Variances of the noise that neighbouring samples tell.
    start : ndarray, shape (states,)
        Variances of the states at the start of a piece.
    """

    forces: tuple[int, ...]
    size: np.ndarray
    shares: np.ndarray
    decay: float
    decays: tuple[float, ...]
    noise: Noise
    told: np.ndarray
    start: np.ndarray

    def allows(self, noise: Noise) -> bool:
        """Whether neighbouring samples leave room for some noise."""
        return bool((noise.between_neighbours <= LOUDEST * self.told).all())

    @property
    def loudest(self) -> float:
        """Largest factor on the noise that neighbouring samples leave room for."""
        return LOUDEST * float(np.min(self.told / self.noise.between_neighbours))

    def latent(self, local: LocalModel, share: float, decay: float | None = None) -> Latent:
        """Return the latent force of one size, and one correlation, about a linearisation."""
        at = list(self.forces)
        entering, read = local.by_constant[..., at], local.reading_by_constant[..., at]
        decay = self.decay if decay is None else decay
        return Latent(entering, share * self.size, decay, read)


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


def grams(
    local: LocalModel, scales: Scales, shares: np.ndarray, decays: Sequence[float] | None = None
) -> list[Gram]:
    """Return the Gram matrix of innovations for every size of the latent force.

    Parameters
    ----------
    decays : sequence of float, optional
        Its correlation beside each size; that of `scales` by default.
    """
    pieces, results = local.defect.shape[1], []
    decays = [scales.decay] * len(shares) if decays is None else decays
    choices = list(zip(shares, decays, strict=True))
    together = max(int(ROOM / (local.innovation.size * (1 + local.by_constant.shape[3]))), 1)
    for first in range(0, len(choices), together):
        latent = [scales.latent(local, *c) for c in choices[first : first + together]]
        found = whitened(System.of(local, latent, [scales.noise] * len(latent), scales.start))
        lanes = [slice(k * pieces, (k + 1) * pieces) for k in range(len(latent))]
        every = (Gram.of(found, lane, scales.loudest) for lane in lanes)
        results += [g.beside(local.log_apart) for g in every]
    return results


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
    """
    active = list(dict.fromkeys([*map(int, chosen), *map(int, helpers)]))
    scales = replace(scales, forces=tuple(active.index(int(j)) for j in helpers))
    climb = _Climb(problem, chosen, active, belief, best, stop)
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
        point, scales = other[0], replace(scales, decay=other[1])
        point, settled = climb.to_the_mode(point, scales)
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
    """

    problem: Problem
    chosen: np.ndarray
    active: list[int]
    belief: Belief
    best: float
    stop: Callable[[], bool]

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
            modes = [g.mode(mixing, prior) for g in made()]
        except np.linalg.LinAlgError:  # derivatives that are no numbers
            return None
        logs = np.array([m.log_evidence for m in modes])
        if not np.isfinite(logs).any():
            return None
        logs = np.where(np.isfinite(logs), logs, -np.inf)
        logs += log_odds(shares)
        return _Point(theta, path, local, shares, modes, logs)

    def to_the_mode(self, point: _Point, scales: Scales) -> tuple[_Point, bool]:
        """Linearise, weigh, smooth, and again; return whether the last step was a small one."""
        theta, path, belief = point.theta, point.path, self.belief
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
            moved = smoothed(System.of(local, [latent], [noise], scales.start), len(path))
            settled = bool(np.all(np.abs(change) <= little))
            shares, tried = sizes_about(point.share, scales.shares), []
            for share in HALVED:
                nearer = theta.copy()
                nearer[chosen] += share * change
                found = self.weighed(nearer, path + share * moved, scales, shares)
                tried += [] if found is None else [found]
                if found is not None and (number < FIRM or found.log > point.log - WORSE):
                    break
            else:  # what it promises is not there: less is, at most
                return max([*tried, *([] if tried else [point])], key=lambda p: p.log), False
            after = tried[-1]
            gain = after.log - point.log
            point, theta, path = after, after.theta, after.path
            # Two steps without a gain are at the mode, however short deviations are.
            settled = abs(gain) < CALM and (settled or calm)
            if settled or (number >= FIRM and left(point.log, gain, self.best)):
                break
            calm = abs(gain) < CALM
        return point, settled

    def in_other_time(self, point: _Point, scales: Scales) -> tuple[_Point, float] | None:
        """Weigh latent forces that keep their sign for longer, or less long, about one path."""
        others = [d for d in scales.decays if d != scales.decay]
        sizes = point.share * np.array(NEARBY)
        shares, decays = np.tile(sizes, len(others)), np.repeat(others, len(sizes))
        found = self._judged(
            point.theta,
            point.path,
            point.local,
            shares,
            lambda: grams(point.local, scales, shares, list(decays)),
        )
        return None if found is None else (found, float(decays[found.best]))


def log_odds(share: float | np.ndarray) -> np.ndarray:
    """Return the log prior odds of sizes of the latent force against none."""
    return np.where(np.asarray(share) > 0.0, np.log(PRESENT) + np.log(BEYOND) * share, 0.0)


def left(log: float, gain: float, best: float) -> bool:
    """Whether a set is so far behind the best, by log evidence, that its last gain is no hope."""
    return best - log > BEHIND and gain < CATCHING * (best - log)


def sizes_about(share: float, shares: np.ndarray) -> np.ndarray:
    """Return sizes of the latent force around one, and none; that alone where there is no other."""
    if not shares.any():
        return shares
    least = float(shares[shares > 0.0].min()) / 4.0
    sizes = share * np.array(NEARBY) if share > least else least * np.array(BARELY)
    return np.array([0.0, *sizes])


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
