"""From a set of mechanisms to its mode and evidence: linearise, weigh, smooth, and again."""

from __future__ import annotations

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
PRESENT = 1.0 / 7.0
"""Prior odds of one size of the latent force against none: as many sizes share even odds."""
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
    """

    mean: np.ndarray
    deviation: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def about(self, theta: np.ndarray) -> Prior:
        """Return the priors of changes from these values."""
        return Prior(self.mean - theta, self.deviation, self.low - theta, self.high - theta)


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
    noise : Noise
    start : ndarray, shape (states,)
        Variances of the states at the start of a piece.
    """

    forces: tuple[int, ...]
    size: np.ndarray
    shares: np.ndarray
    decay: float
    noise: Noise
    start: np.ndarray

    def latent(self, local: LocalModel, share: float) -> Latent:
        """Return the latent force of one size about a linearisation."""
        at = list(self.forces)
        entering, read = local.by_constant[..., at], local.reading_by_constant[..., at]
        return Latent(entering, share * self.size, self.decay, read)


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
        Linearised about the path, at the mode, no constant left to change.
    latent : Latent
        Force of that size.
    """

    theta: np.ndarray
    path: np.ndarray
    share: float
    mode: Mode
    settled: bool
    local: LocalModel
    latent: Latent

    @property
    def log_evidence(self) -> float:
        """Of the mode, with the prior odds of its latent force."""
        return self.mode.log_evidence + np.log(PRESENT) * (self.share > 0.0)


def grams(local: LocalModel, scales: Scales, shares: np.ndarray) -> list[Gram]:
    """Return the Gram matrix of innovations for every size of the latent force."""
    pieces, results = local.defect.shape[1], []
    together = max(int(ROOM / (local.innovation.size * (1 + local.by_constant.shape[3]))), 1)
    for first in range(0, len(shares), together):
        latent = [scales.latent(local, share) for share in shares[first : first + together]]
        found = whitened(System.of(local, latent, [scales.noise] * len(latent), scales.start))
        lanes = range(len(latent))
        results += [Gram.of(found, slice(k * pieces, (k + 1) * pieces)) for k in lanes]
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
    """
    size = len(chosen)
    active = list(dict.fromkeys([*map(int, chosen), *map(int, helpers)]))
    scales = replace(scales, forces=tuple(active.index(int(j)) for j in helpers))

    def weighed(theta: np.ndarray, path: np.ndarray, shares: np.ndarray) -> _Point | None:
        args = problem.simulator, problem.stepping, problem.segments, theta, path
        local = linearised(*args, active)
        if not np.isfinite(local.defect).all():
            return None
        prior = belief.about(theta[chosen])
        try:
            modes = [g.evidence(range(size), prior) for g in grams(local, scales, shares)]
        except np.linalg.LinAlgError:  # derivatives that are no numbers
            return None
        logs = np.array([m.log_evidence for m in modes])
        if not np.isfinite(logs).any():
            return None
        logs = np.where(np.isfinite(logs), logs, -np.inf)
        logs += np.log(PRESENT) * (shares > 0.0)
        return _Point(theta, path, local, shares, modes, logs)

    point = weighed(theta, path, scales.shares)
    if point is None:
        return None
    settled, calm = False, False
    for number in range(MOST):
        change = np.clip(theta[chosen] + point.mode.change, belief.low, belief.high) - theta[chosen]
        little = SETTLED * point.mode.deviation + 1e-12 * np.abs(theta[chosen])
        local = point.local.moved(np.concatenate([change, np.zeros(len(active) - size)]))
        latent = scales.latent(point.local, point.share)
        noise = scales.noise.scaled(point.mode.noise)
        moved = smoothed(System.of(local, [latent], [noise], scales.start), len(path))
        settled = bool(np.all(np.abs(change) <= little))
        after = None
        for share in HALVED:
            nearer = theta.copy()
            nearer[chosen] += share * change
            found = weighed(nearer, path + share * moved, _about(point.share, scales.shares))
            if found is not None and (number < FIRM or found.log > point.log - WORSE):
                after = found
                break
        if after is None:
            settled = False
            break
        gain = after.log - point.log
        point, theta, path = after, after.theta, after.path
        settled &= abs(gain) < CALM
        if (
            settled
            or (calm and abs(gain) < CALM)
            or (number >= FIRM and left(point.log, gain, best))
        ):
            break
        calm = abs(gain) < CALM
    at_mode = point.local.moved(np.concatenate([point.mode.change, np.zeros(len(active) - size)]))
    latent = scales.latent(point.local, point.share)
    return Estimate(point.theta, point.path, point.share, point.mode, settled, at_mode, latent)


def left(log: float, gain: float, best: float) -> bool:
    """Whether a set is so far behind the best, by log evidence, that its last gain is no hope."""
    return best - log > BEHIND and gain < CATCHING * (best - log)


def _about(share: float, shares: np.ndarray) -> np.ndarray:
    """Return sizes of the latent force around one, and none."""
    least = float(shares[shares > 0.0].min()) / 4.0
    return np.array(
        [0.0, *(share * np.array(NEARBY) if share > least else least * np.array(BARELY))]
    )


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
