"""Sizes that the latent force may have beside the noise, and what the innovations say of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxsr.diagnosis.likelihood.evidence import Gram
from jaxsr.diagnosis.likelihood.kalman import Latent, System, whitened
from jaxsr.diagnosis.likelihood.local import LocalModel
from jaxsr.diagnosis.likelihood.sensor_noise import Noise

LOUDEST = 4.0
"""Variance of a sensor's noise in that which neighbouring samples tell: more is not its noise."""
NEARBY, BARELY = (0.5, 0.8, 1.0, 1.25, 2.0), (0.5, 1.0, 2.0)
"""Sizes of the latent force, in that of the last step, that are tried, and where there was none in
a quarter of the least."""
PRESENT, BEYOND = 1.0 / 7.0, 0.05
"""Prior odds of a small latent force of one size against none, as seven sizes share even odds, and
what is left of them at the size of the net force: they fall exponentially (Simpson et al. 2017,
Stat. Sci. 32, section 3.3). The times that it may take are not paid for: what is likeliest among
them stands for several."""
ROOM = 2e7
"""Numbers of innovations and their derivatives that are held at once."""


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
    finest : ndarray, shape (outputs,)
        Variances that no sensor's noise is below.
    """

    forces: tuple[int, ...]
    size: np.ndarray
    shares: np.ndarray
    decay: float
    decays: tuple[float, ...]
    noise: Noise
    told: np.ndarray
    start: np.ndarray
    finest: np.ndarray

    def allows(self, noise: Noise) -> bool:
        """Whether neighbouring samples leave room for some noise."""
        return bool((noise.between_neighbours <= LOUDEST * self.told).all())

    @property
    def factors(self) -> tuple[float, float]:
        """Smallest factor on the noise that leaves every sensor its finest, and largest for which
        neighbouring samples leave room; of the two, the latter."""
        noise = self.noise
        with np.errstate(over="ignore", divide="ignore"):  # of readings that stand still
            loudest = LOUDEST * float(np.min(self.told / noise.between_neighbours))
        quietest = float(np.max(self.finest / (noise.white + noise.coloured)))
        return min(quietest, loudest), loudest

    def latent(self, local: LocalModel, share: float, decay: float | None = None) -> Latent:
        """Return the latent force of one size, and one correlation, about a linearisation."""
        at = list(self.forces)
        entering, read = local.by_constant[..., at], local.reading_by_constant[..., at]
        decay = self.decay if decay is None else decay
        return Latent(entering, share * self.size, decay, read)


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
        every = (Gram.of(found, lane, scales.factors) for lane in lanes)
        results += [g.beside(local.log_apart) for g in every]
    return results


def reaching(shares: np.ndarray, share: float) -> np.ndarray:
    """Return sizes of the latent force that go on, in their last ratio, as far as one.

    Friction behind a gear is many times the force that moves its rotor.

    Parameters
    ----------
    shares : ndarray, shape (choices,)
        In rising order.
    share : float
        That the latent force was found to have.
    """
    while shares[-1] < share:
        shares = np.append(shares, shares[-1] ** 2 / shares[-2])
    return shares


def log_odds(share: float | np.ndarray) -> np.ndarray:
    """Return the log prior odds of sizes of the latent force against none."""
    return np.where(np.asarray(share) > 0.0, np.log(PRESENT) + np.log(BEYOND) * share, 0.0)


def likeliest_size(shares: np.ndarray, logs: np.ndarray) -> float:
    """Return the size at the top of a parabola over log size, through the likeliest and its two
    neighbours; the likeliest itself where it has no neighbour on one side, or is none.

    Parameters
    ----------
    shares : ndarray, shape (choices,)
        In rising order.
    logs : ndarray, shape (choices,)
        Log evidence, prior odds included.
    """
    at = int(np.argmax(logs))
    if not 1 < at < len(shares) - 1 or not np.isfinite(logs[at - 1 : at + 2]).all():
        return float(shares[at])
    below, above = np.log(shares[at - 1 : at + 2 : 2] / shares[at])
    left, right = logs[at - 1 : at + 2 : 2] - logs[at]
    slope = (left * above**2 - right * below**2) / (below * above * (above - below))
    bend = 2.0 * (right * below - left * above) / (below * above * (above - below))
    if not bend < 0.0:
        return float(shares[at])
    return float(shares[at] * np.exp(np.clip(-slope / bend, below, above)))


def sizes_about(share: float, shares: np.ndarray) -> np.ndarray:
    """Return sizes of the latent force around one, and none; that alone where there is no other."""
    if not shares.any():
        return shares
    least = float(shares[shares > 0.0].min()) / 4.0
    sizes = share * np.array(NEARBY) if share > least else least * np.array(BARELY)
    return np.array([0.0, *sizes])
