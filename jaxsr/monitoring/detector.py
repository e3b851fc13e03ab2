r"""Sequential evidence of a change, at a stated rate of false alarms.

Every alternative k has a density of each block of samples given those before it. With the ratio
:math:`L_k` of that density to the density of normal running, the Shiryaev-Roberts statistic

.. math:: R_k(t) = (1 + R_k(t-1)) \, L_k(t)^{\theta}, \qquad R(t) = \frac{1}{K} \sum_k R_k(t)

is the evidence that a change began at any block up to now. In normal running the expected ratio is
1, so that R(t) - t is a martingale: by optional stopping an alarm at R >= A comes after at least A
blocks on average. The exponent is 1 unless normal running shows larger ratios than its own
likelihood expects.

References
----------
Pollak, Optimal detection of a change in distribution, Annals of Statistics 13 (1985) 206-227;
Roberts, Technometrics 8 (1966) 411-430. The block at which an alternative's cumulative sum left
zero last is Page's estimate of the change: Page, Biometrika 41 (1954) 100-115.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float

STRETCHES, FEWEST = (1, 4, 16), 8
"""Blocks in a row over which expected ratios are checked, and the fewest such stretches."""
SIGNIFICANT, CHANCE = 3.0, 20.0
"""Standard errors by which a mean ratio is above 1, or else the mean itself, that is not chance: a
ratio whose expectation is 1 is as large as 20 in one case of 20 at most (Markov)."""
WEAKEST = 0.02
"""Least exponent: normal running that asks for less is none."""
CERTAIN = 300.0
"""Logarithm of a ratio beyond which nothing is told apart."""


@dataclass(frozen=True, eq=False)
class Watch:
    """Evidence so far.

    Attributes
    ----------
    log_r : ndarray, shape (alternatives,)
        Logarithms of the Shiryaev-Roberts statistics.
    cusum : ndarray, shape (alternatives,)
        Cumulative sums of the logarithms of the ratios, never below 0.
    since : ndarray, shape (alternatives,)
        Where these left 0, in s.
    """

    log_r: Float[np.ndarray, " alternatives"]
    cusum: Float[np.ndarray, " alternatives"]
    since: Float[np.ndarray, " alternatives"]

    @staticmethod
    def begun(alternatives: int, time: float = -np.inf) -> Watch:
        """Return the evidence before the first block."""
        nothing = np.full(alternatives, -np.inf)
        return Watch(nothing, np.zeros(alternatives), np.full(alternatives, time))

    def after(self, gains: Float[np.ndarray, " alternatives"], start: float) -> Watch:
        """Return the evidence behind a block.

        Parameters
        ----------
        gains : ndarray, shape (alternatives,)
            Logarithms of the ratios.
        start : float
            Where the block begins, in s.
        """
        gains = np.clip(gains, -CERTAIN, CERTAIN)
        log_r = np.minimum(np.logaddexp(0.0, self.log_r) + gains, CERTAIN)
        since = np.where(self.cusum > 0.0, self.since, start)
        return replace(self, log_r=log_r, cusum=np.maximum(self.cusum + gains, 0.0), since=since)

    @property
    def log_evidence(self) -> float:
        """Logarithm of the statistic that an alarm is at."""
        return float(np.logaddexp.reduce(self.log_r) - np.log(self.log_r.size))

    @property
    def shares(self) -> Float[np.ndarray, " alternatives"]:
        """Share of every alternative in it."""
        return np.exp(self.log_r - np.logaddexp.reduce(self.log_r))


def exponent(gains: Float[np.ndarray, "alternatives blocks"]) -> float:
    """Return the largest exponent, at most 1, with which normal ratios are 1 on average.

    Parameters
    ----------
    gains : ndarray, shape (alternatives, blocks)
        Logarithms of the ratios on normal running, in order.
    """
    theta = 1.0
    for length in STRETCHES:
        count = gains.shape[1] // length
        if count < FEWEST and length > 1:
            break
        sums = gains[:, : count * length].reshape(len(gains), count, length).sum(axis=2)
        for row in sums:
            theta = min(theta, _root(row, theta))
    return theta


def _root(sums: np.ndarray, most: float) -> float:
    """Return the largest exponent up to `most` with which the mean ratio is 1 but for chance."""

    def above(theta: float) -> bool:
        ratios = np.exp(np.minimum(theta * sums, CERTAIN))
        mean, error = float(np.mean(ratios)), float(np.std(ratios) / np.sqrt(sums.size))
        return mean > CHANCE or mean - SIGNIFICANT * error > 1.0

    if not above(most):
        return most
    low, high = WEAKEST, most
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if above(middle) else (middle, high)
    return low
