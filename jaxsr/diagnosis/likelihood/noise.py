"""Sizes and correlations of the sensors' noise, by the likelihood itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxsr.diagnosis.likelihood.estimate import Belief, Estimate, Scales
from jaxsr.diagnosis.likelihood.evidence import Gram
from jaxsr.diagnosis.likelihood.kalman import Noise, System, whitened

CORRELATIONS = (0.0, 0.5, 0.8, 0.95)
SIZES = (0.5, 1.0, 2.0)
WHITE = 0.02
"""White part of a coloured noise: no sensor knows its next value."""
ROUNDS, PIECES = 2, 4


def likeliest(
    found: Estimate, scales: Scales, chosen: np.ndarray, belief: Belief
) -> tuple[Noise, float]:
    """Return the noise beside which an estimate has most evidence, and what it gains.

    Variances and correlations of one sensor are tried side by side, those of the others held, in
    at most `ROUNDS` rounds, on some of the pieces; once beside the latent force of the estimate and
    once without any, which slow noise may be taken for. Constants follow each of them: without a
    latent force they are told far more sharply, and elsewhere.

    Parameters
    ----------
    chosen : ndarray of int
        Parameters that were estimated, the first of those that the estimate is linearised by.
    belief : Belief
        Of them.
    """
    count = found.local.defect.shape[1]
    pieces = sorted({int(k) for k in np.linspace(0, count - 1, min(count, PIECES))})
    part, force = found.local.of(pieces), found.latent.of(pieces)
    before = scales.noise.scaled(found.mode.noise)
    prior, mixing = belief.about(found.theta[chosen]), belief.mixing

    def weighed(share: float, every: list[Noise]) -> np.ndarray:
        latent = replace(force, scale=share * scales.size)
        rows = whitened(System.of(part, [latent] * len(every), every, scales.start))
        lanes = (slice(k, k + len(pieces)) for k in range(0, len(every) * len(pieces), len(pieces)))
        modes = (Gram.of(rows, lane).mode(mixing, prior, scaled=False) for lane in lanes)
        return np.array([m.log_evidence for m in modes])

    best, most = before, float(weighed(found.share, [before])[0])
    start = most
    for share in dict.fromkeys((found.share, 0.0)):
        noise = before
        for _ in range(ROUNDS):
            begun = noise
            for k in range(len(noise.white)):
                grid = [(size, rho) for size in SIZES for rho in CORRELATIONS]
                grid = [c for c in grid if scales.allows(_with(noise, k, *c))]
                logs = weighed(share, [_with(noise, k, *choice) for choice in grid])
                if not np.isfinite(logs).any():
                    continue
                size, rho = grid[int(np.nanargmax(logs))]
                if (size, rho) != (1.0, noise.correlation[k]):
                    noise = _with(noise, k, size, rho)
                if np.nanmax(logs) > most:
                    best, most = noise, float(np.nanmax(logs))
            if noise is begun:
                break
    return best, most - start


def _with(noise: Noise, sensor: int, size: float, correlation: float) -> Noise:
    """Return the noise with that of one sensor of another size and correlation."""
    white, coloured, rho = noise.white.copy(), noise.coloured.copy(), noise.correlation.copy()
    whole = size * (white[sensor] + coloured[sensor])
    share = WHITE if correlation else 1.0
    white[sensor], coloured[sensor] = share * whole, (1.0 - share) * whole
    rho[sensor] = correlation
    return Noise(white, coloured, rho)
