"""Sizes and correlations of the sensors' noise, by the likelihood itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from jaxsr._deadline import never
from jaxsr.diagnosis.likelihood.estimate import Belief, Estimate
from jaxsr.diagnosis.likelihood.evidence import Gram, Mode, Prior, modes
from jaxsr.diagnosis.likelihood.kalman import Latent, System, whitened
from jaxsr.diagnosis.likelihood.local import LocalModel
from jaxsr.diagnosis.likelihood.scales import Scales, log_odds
from jaxsr.diagnosis.likelihood.sensor_noise import Noise

WHITE = {
    0.0: 1.0,
    0.25: 0.02,
    0.5: 0.02,
    0.65: 0.02,
    0.8: 0.02,
    0.9: 0.02,
    0.95: 0.02,
    0.99: 0.8,
    0.998: 0.5,
}
"""Correlations from sample to sample, and the white part of a noise with each: no sensor knows its
next value, and slow wandering (a bias that is not stable) comes beside white noise."""
WANDERING = max(filter(None, WHITE), key=WHITE.__getitem__)
"""Correlation of what wanders beside most white noise: what lies between is like neither."""
SMOOTHED = (0.25, 0.5, 0.65, 0.8, 0.9)
"""Poles of a filter that the coloured part may have gone through: those of sensors that are slower
than they are read. At most as long as what it smooths keeps its sign: the two may change places."""
SIZES = (0.5, 2.0)
"""Of one sensor's noise in that of the others: what fits best scales all of them. Of the force
beside another noise, in that of the estimate."""
PIECES = 4
SWEEPS, GAINING = 3, 1.0
"""Times that each sensor's noise is sought beside the others', and log evidence that one must gain
for another one to begin."""
MANY = 4
"""Sensors up to which each is sought along all samples; of more that is done once at the end, and
before along their first ones: it takes a time that grows as a power of their number."""

Beside = tuple[Noise, float, float]
"""A noise, the correlation of the latent force beside it, and its size in that of the estimate."""


def likeliest(
    found: Estimate,
    scales: Scales,
    chosen: np.ndarray,
    belief: Belief,
    stop: Callable[[], bool] = never,
) -> tuple[Noise, float, float]:
    """Return the noise beside which an estimate has most evidence, and what it gains.

    Correlations of all sensors at once are tried side by side, then variances and correlations of
    one after the other, on some of the pieces; once beside the latent force of the estimate and
    once without any, which slow noise may be taken for. Brief noise may be taken for a brief force:
    correlations of all sensors are tried beside every time for which the force may keep its sign,
    and sizes of it, and once more beside the force as it is, where each of several sensors goes on
    from another noise. Where a sensor reads the force itself (an accelerometer), a brief one is its
    noise: there it stays as it is. Last it is tried whether a filter smooths what was found.
    Constants follow each of them: without a latent force they are told far more sharply, and
    elsewhere.

    Parameters
    ----------
    chosen : ndarray of int
        Parameters that were estimated, the first of those that the estimate is linearised by.
    belief : Belief
        Of them.
    stop : callable
        Whether the noise that is the best until then stands.

    Returns
    -------
    noise : Noise
    decay : float
        Of the latent force beside it, from sample to sample.
    gain : float
        Log evidence.
    """
    scene = _Scene.of(found, scales, chosen, belief)
    unchanged = _scaled((scales.noise, found.decay, 1.0), found.mode.noise)
    start = scene.logs(found.share, [unchanged])[1][0]
    best, most, sensors = unchanged, start, range(len(scales.noise.white))
    read = scene.force.read is not None and bool(np.any(scene.force.read))
    freed = [(found.share, True)] if found.share and not read else []
    held = [] if freed and len(sensors) == 1 else [(found.share, False)]
    beside = (found.share, bool(freed))
    for share, forced in dict.fromkeys([*held, *freed, (0.0, False)]):
        here, there = _swept(scene, unchanged, share, forced, stop)
        if there > most:
            best, most, beside = here, there, (share, forced)
    each = [[k] for k in sensors]
    if len(sensors) > MANY:
        best, most = _tried(scene, (best, most), each, *beside, stop)
        brief = scene.brief()
        begun = best, brief.best(beside[0], [best])[1]
        smoother = _smoothed(brief, begun, *beside, stop)[0]
        log = scene.best(beside[0], [smoother])[1]
        best, most = (smoother, log) if log > most + GAINING else (best, most)
    else:
        best, most = _smoothed(scene, (best, most), *beside, stop)
    return best[0], best[1], most - start


def _swept(
    scene: _Scene, here: Beside, share: float, forced: bool, stop: Callable[[], bool]
) -> tuple[Beside, float]:
    """Try other noises until none gains; return the best and its log evidence.

    Parameters
    ----------
    share : float
        Size of the latent force.
    forced : bool
        Whether its time and size are sought as well.
    """
    sensors = range(len(here[0].white))
    found = _tried(scene, (here, -np.inf), [sensors], share, forced, stop)
    many = len(sensors) > MANY
    along = scene.brief() if many else scene
    after = (found[0], along.best(share, [found[0]])[1]) if many else found
    for _ in range(SWEEPS if len(sensors) > 1 else 0):
        known, after = after, _tried(along, after, [[k] for k in sensors], share, forced, stop)
        if after[1] < known[1] + GAINING:
            break
    if many:
        after = after[0], scene.best(share, [after[0]])[1]
    return max(found, after, key=lambda f: f[1])


def _tried(
    scene: _Scene,
    known: tuple[Beside, float],
    every: Sequence[Sequence[int]],
    share: float,
    forced: bool,
    stop: Callable[[], bool],
) -> tuple[Beside, float]:
    """Try other noises of some sensors, and then of others, each until none gains."""
    here, there = known
    for some in every:
        alone, worth = len(some) < len(here[0].white), True
        while worth and not stop():
            before, forces = there, scene.forces(here, forced and not alone)
            others = [(n, *force) for n in _others(here[0], some) for force in forces]
            (other, factor), log = scene.best(share, others)
            if log > there:
                # Beside another size of the force all noises are due again.
                worth = alone or other[2] != here[2]
                here, there = _scaled(other, factor, forced), log
            worth = worth and there > before + GAINING
    return here, there


def _smoothed(
    scene: _Scene,
    known: tuple[Beside, float],
    share: float,
    forced: bool,
    stop: Callable[[], bool],
) -> tuple[Beside, float]:
    """Try whether a filter smooths the noise of the sensors, of all of them and of each."""
    here, there = known
    sensors = range(len(here[0].white))
    for some in [sensors, *([k] for k in sensors if len(sensors) > 1)]:
        worth = True
        while worth and not stop():
            forces = scene.forces(here, forced and len(some) == len(sensors))
            every = [(n, *force) for n in _smoother(here[0], some) for force in forces]
            (other, factor), log = scene.best(share, every)
            worth = log > there + GAINING
            if worth:
                here, there = _scaled(other, factor, forced), log
    return here, there


def _scaled(beside: Beside, factor: float, whole: bool = True) -> Beside:
    """Return a noise, and the `whole` with its force, with all variances multiplied.

    Beside a force that stays as it is, its size is sought by the noise.
    """
    noise, decay, size = beside
    return noise.scaled(factor), decay, size * float(np.sqrt(factor)) if whole else size


@dataclass(frozen=True, eq=False)
class _Scene:
    """What stays as the noise changes.

    Attributes
    ----------
    part : LocalModel
        Some of the pieces about the path of an estimate.
    force : Latent
        Its latent force there.
    scales : Scales
    prior : Prior
        Of its constants.
    mixing : ndarray, shape (constants, constants)
    """

    part: LocalModel
    force: Latent
    scales: Scales
    prior: Prior
    mixing: np.ndarray

    @staticmethod
    def of(found: Estimate, scales: Scales, chosen: np.ndarray, belief: Belief) -> _Scene:
        """Take some of the pieces of an estimate."""
        count = found.local.defect.shape[1]
        pieces = sorted({int(k) for k in np.linspace(0, count - 1, min(count, PIECES))})
        part, force = found.local.of(pieces), found.latent.of(pieces)
        return _Scene(part, force, scales, belief.about(found.theta[chosen]), belief.mixing)

    def brief(self) -> _Scene:
        """Return the first samples of the pieces: of all sensors as many as of one before."""
        count = self.part.innovation.shape[0] // self.part.innovation.shape[2]
        count = max(count, 2)
        return replace(self, part=self.part.first(count), force=self.force.first(count))

    def forces(self, here: Beside, sought: bool) -> list[tuple[float, float]]:
        """Return times and sizes of the force to try: as it is, or others as well."""
        if not sought:
            return [here[1:]]
        return [*product(self.scales.decays, [here[2], *(here[2] * f for f in SIZES)])]

    def best(self, share: float, every: Sequence[Beside]) -> tuple[tuple[Beside, float], float]:
        """Return the likeliest of noises and forces that the readings leave room for.

        Returns
        -------
        likeliest : (Beside, float)
            And the factor on all variances that fits best.
        log : float
            Its log evidence.
        """
        every = [b for b in every if self.scales.allows(b[0])]
        modes, logs = self.logs(share, every)
        if not len(logs):
            return ((self.scales.noise, 0.0, 1.0), 1.0), -np.inf
        at = int(np.argmax(logs))
        return (every[at], modes[at].noise), float(logs[at])

    def logs(self, share: float, every: Sequence[Beside]) -> tuple[list[Mode], np.ndarray]:
        """Return modes of the constants and log evidences beside each noise and force."""
        if not every:
            return [], np.zeros(0)
        forces = [
            replace(self.force, scale=size * share * self.scales.size, decay=decay)
            for _, decay, size in every
        ]
        noises, count = [noise for noise, *_ in every], self.part.defect.shape[1]
        rows = whitened(System.of(self.part, forces, noises, self.scales.start))
        grams = [
            Gram.of(rows, slice(k * count, (k + 1) * count), replace(self.scales, noise=n).factors)
            for k, n in enumerate(noises)
        ]
        found = self._modes(grams)
        logs = np.array([m.log_evidence for m in found]) + float(log_odds(share))
        return found, np.nan_to_num(logs, nan=-np.inf)

    def _modes(self, grams: Sequence[Gram]) -> list[Mode]:
        """Return the modes beside each noise; no evidence where innovations are no numbers."""
        try:
            return modes(grams, range(len(self.mixing)), self.prior, self.mixing)
        except np.linalg.LinAlgError:
            if len(grams) > 1:
                return [mode for gram in grams for mode in self._modes([gram])]
            return [Mode(-np.inf, self.prior.mean, self.prior.deviation, 1.0)]


def _others(noise: Noise, sensors: Sequence[int]) -> Iterator[Noise]:
    """Yield noises of another correlation of all sensors, or of one next to that which it has.

    Of one, white noise, noise that wanders and those of other sizes as well.
    """
    every = list(WHITE)
    if len(sensors) == len(noise.white):
        yield from (_with(noise, sensors, 1.0, correlation) for correlation in every)
        return
    own = float(noise.correlation[sensors[0]])
    at = int(np.argmin(np.abs(np.array(every) - own)))
    near = {*every[max(at - 1, 0) : at + 2], 0.0, WANDERING} - {every[at]}
    yield from (_with(noise, sensors, 1.0, correlation) for correlation in sorted(near))
    yield from (_with(noise, sensors, size, own) for size in SIZES)


def _smoother(noise: Noise, sensors: Sequence[int]) -> Iterator[Noise]:
    """Yield noises of some sensors that a filter smooths, of correlations near to theirs."""
    every = [rho for rho in WHITE if rho < WANDERING]
    near = {int(np.argmin(np.abs(np.array(every) - noise.correlation[k]))) for k in sensors}
    some = sorted({every[i] for k in near for i in range(k - 2, k + 2) if 0 < i < len(every)})
    for rho, pole in product(some, SMOOTHED):
        if pole <= rho:
            yield _with(noise, sensors, 1.0, rho, pole)


def _with(
    noise: Noise, sensors: Sequence[int], size: float, correlation: float, smoothing: float = 0.0
) -> Noise:
    """Return the noise with that of some sensors of another size and correlation.

    The size is that between neighbouring samples, which is told best; there the white part is as
    much of smoothed noise as of what is not.
    """
    at, share = list(sensors), WHITE[correlation]

    def of(white: float, coloured: float, pole: float) -> Noise:
        return Noise(*(np.array([part]) for part in (white, coloured, correlation, pole)))

    ends = [of(0.0, 1.0, pole).between_neighbours[0] for pole in (smoothing, 0.0)]
    parts = share * ends[0] / ends[1], 1.0 - share
    whole = size / of(*parts, smoothing).between_neighbours * noise.between_neighbours[at]
    white, coloured = noise.white.copy(), noise.coloured.copy()
    rho, poles = noise.correlation.copy(), noise.poles[1].copy()
    white[at], coloured[at], rho[at], poles[at] = (
        *(p * whole for p in parts),
        correlation,
        smoothing,
    )
    return Noise(white, coloured, rho, poles)
