"""Sizes and correlations of the sensors' noise, by the likelihood itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from jaxsr._deadline import never
from jaxsr.diagnosis.likelihood.estimate import Belief, Estimate
from jaxsr.diagnosis.likelihood.evidence import Gram, Mode
from jaxsr.diagnosis.likelihood.kalman import Noise, System, whitened
from jaxsr.diagnosis.likelihood.scales import Scales, log_odds

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
SIZES = (0.5, 2.0)
"""Of one sensor's noise in that of the others: what fits best scales all of them."""
PIECES = 4
SWEEPS, GAINING = 3, 1.0
"""Times that each sensor's noise is sought beside the others', and log evidence that one must gain
for another one to begin."""


def likeliest(
    found: Estimate,
    scales: Scales,
    chosen: np.ndarray,
    belief: Belief,
    stop: Callable[[], bool] = never,
) -> tuple[Noise, float]:
    """Return the noise beside which an estimate has most evidence, and what it gains.

    Correlations of all sensors at once are tried side by side, then variances and correlations of
    one after the other, on some of the pieces; once beside the latent force of the estimate and
    once without any, which slow noise may be taken for. Constants follow each of them: without a
    latent force they are told far more sharply, and elsewhere.

    Parameters
    ----------
    chosen : ndarray of int
        Parameters that were estimated, the first of those that the estimate is linearised by.
    belief : Belief
        Of them.
    stop : callable
        Whether the noise that is the best until then stands.
    """
    count = found.local.defect.shape[1]
    pieces = sorted({int(k) for k in np.linspace(0, count - 1, min(count, PIECES))})
    part, force = found.local.of(pieces), found.latent.of(pieces)
    before = scales.noise.scaled(found.mode.noise)
    prior, mixing = belief.about(found.theta[chosen]), belief.mixing

    def weighed(share: float, every: list[Noise]) -> list[Mode]:
        latent = replace(force, scale=share * scales.size)
        rows = whitened(System.of(part, [latent] * len(every), every, scales.start))
        lanes = (slice(k, k + len(pieces)) for k in range(0, len(every) * len(pieces), len(pieces)))
        rooms = (replace(scales, noise=noise).loudest for noise in every)
        every_gram = (Gram.of(rows, lane, room) for lane, room in zip(lanes, rooms, strict=True))
        return [g.mode(mixing, prior) for g in every_gram]

    odds = {share: float(log_odds(share)) for share in (found.share, 0.0)}
    start = odds[found.share] + weighed(found.share, [before])[0].log_evidence
    best, most, sensors = before, start, range(len(before.white))
    for share in odds:
        noise, there = before, -np.inf
        for together in _sweeps(sensors):
            begun = there
            for some in together:
                worth = True
                while worth and not stop():
                    known = there
                    every = [n for n in _others(noise, some) if scales.allows(n)]
                    modes = weighed(share, every) if every else []
                    logs = np.nan_to_num([odds[share] + m.log_evidence for m in modes], nan=-np.inf)
                    if len(logs) and logs.max() > there:
                        best_of = int(np.argmax(logs))
                        noise = every[best_of].scaled(modes[best_of].noise)
                        there = float(logs[best_of])
                    worth = len(some) < len(sensors) and there > known + GAINING
            if there < begun + GAINING:
                break
        if there > most:
            best, most = noise, there
    return best, most - start


def _sweeps(sensors: Sequence[int]) -> Iterator[list[Sequence[int]]]:
    """Yield which sensors are tried together: all, and then each, as often as that is worth it."""
    yield [sensors]
    for _ in range(SWEEPS if len(sensors) > 1 else 0):
        yield [[k] for k in sensors]


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


def _with(noise: Noise, sensors: Sequence[int], size: float, correlation: float) -> Noise:
    """Return the noise with that of some sensors of another size and correlation.

    The size is that between neighbouring samples, which is told best.
    """
    white, coloured, rho = noise.white.copy(), noise.coloured.copy(), noise.correlation.copy()
    at, share = list(sensors), WHITE[correlation]
    alone = share + (1.0 - share) * (1.0 - correlation) / (1.0 + correlation)
    whole = size / alone * noise.between_neighbours[at]
    white[at], coloured[at], rho[at] = share * whole, (1.0 - share) * whole, correlation
    return Noise(white, coloured, rho)
