r"""Innovations of coloured noise: what the samples before do not tell.

Noise of a sensor that is sampled far faster than it follows (a filter, slow ripple) is correlated
over many samples, and not as a first-order process: neighbours hardly differ, and their
differences say nothing of its size. An autoregression

.. math:: r_k = \sum_{j=1}^{p} \phi_j r_{k-j} + e_k, \qquad e_k \sim N(0, v_p),

follows any such spectrum; its order p is that of the least :math:`n \log v_p + p \log n`
(Schwarz). The first samples of a stretch, before which p are not known, are predicted by lower
orders, each innovation in units of :math:`v_p`.

References
----------
Brockwell & Davis, Time Series: Theory and Methods (1991), sections 5.2 and 8.6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LARGEST_ORDER = 8
"""Highest order that is tried."""
FEWEST = 10
"""Samples for each lag that an order needs."""
ENOUGH = 0.25
"""Share of the samples that must have all before them known, as many as the highest order."""


@dataclass(frozen=True, eq=False)
class Autoregression:
    """Predictors of all orders up to p.

    Attributes
    ----------
    predictors : tuple of ndarray
        Predictor m, shape (m,): its j-th number weighs the sample j + 1 before.
    variances : ndarray, shape (p + 1,)
        Of the innovations of every order.
    """

    predictors: tuple[np.ndarray, ...]
    variances: np.ndarray

    @property
    def order(self) -> int:
        """The order p."""
        return len(self.predictors) - 1

    @staticmethod
    def of(residual: np.ndarray, seen: np.ndarray, largest: int = LARGEST_ORDER) -> Autoregression:
        """Estimate from residuals, both (samples, segments); what is not `seen` does not count.

        Least squares on the samples of which all before are known, the same for all orders:
        covariances, which count the ends of stretches as zeros, would make slow noise forget too
        soon.
        """
        least = ENOUGH * max(int(seen.sum()), 1)
        largest = max(min(largest, len(residual) // FEWEST), 0)
        known = _following(seen, largest)
        while largest and known.sum() < max(least, FEWEST * largest):
            largest -= 1
            known = _following(seen, largest)
        size = len(residual)
        lags = [residual[largest - j : size - j][known] for j in range(largest + 1)]
        count = max(int(known.sum()), 2)
        # one factor serves all orders: their columns are its first ones
        factor = np.asarray(np.linalg.qr(np.stack([*lags[1:], lags[0]], axis=1), mode="r"))
        told = factor[:, -1] if known.any() else np.zeros(1)  # a sensor without any error
        predictors = [np.zeros(0)]
        for m in range(1, largest + 1):
            inner = factor[:m, :m]
            solved = np.linalg.lstsq(inner, told[:m], rcond=1e-12)[0]
            predictors.append(np.asarray(solved, dtype=np.float64))
        left = np.cumsum(told[::-1] ** 2)[::-1][: largest + 1]
        variances = left / count + 1e-300
        orders = np.arange(largest + 1)
        best = int(np.argmin(count * np.log(variances) + orders * np.log(count)))
        return Autoregression(tuple(predictors[: best + 1]), np.array(variances[: best + 1]))

    def innovations(self, a: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Return what the samples before do not tell of an array (..., samples, segments).

        Parameters
        ----------
        seen : ndarray of bool, shape (samples, segments)
        """
        size, most = len(seen), self.order
        known, result = _in_a_row(seen, most), np.array(a, dtype=float)
        for j, weight in enumerate(self.predictors[most], start=1):
            result[..., most:, :] -= weight * a[..., most - j : size - j, :]
        for m in range(most):  # the beginnings of stretches
            rows, columns = np.nonzero((known == m) & seen)
            early = a[..., rows, columns].astype(float)
            for j, weight in enumerate(self.predictors[m], start=1):
                early -= weight * a[..., rows - j, columns]
            result[..., rows, columns] = early
        result = np.where(seen, result, 0.0)
        return result * np.sqrt(self.variances[-1] / self.variances[known])


def _in_a_row(seen: np.ndarray, most: int) -> np.ndarray:
    """Count the samples before each that are seen without a break, up to `most`."""
    known, whole = np.zeros(seen.shape, dtype=int), np.ones(seen.shape, dtype=bool)
    for j in range(1, min(most, len(seen)) + 1):
        whole[:j] = False
        whole[j:] &= seen[: len(seen) - j]
        known += whole
    return known


def _following(seen: np.ndarray, lags: int) -> np.ndarray:
    """Whether each sample from `lags` on is seen and as many before it are."""
    size = len(seen)
    return np.logical_and.reduce([seen[lags - j : size - j] for j in range(lags + 1)])
