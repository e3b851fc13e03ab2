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

        Least squares on the samples of which all before are known: covariances, which count the
        ends of stretches as zeros, would make slow noise forget too soon.
        """
        r, count = np.where(seen, residual, 0.0), max(int(seen.sum()), 1)
        largest = max(min(largest, len(r) // FEWEST), 0)
        predictors, variances = [np.zeros(0)], [float(np.sum(r**2)) / count + 1e-300]
        for m in range(1, largest + 1):
            lags = range(1, m + 1)
            known = np.logical_and.reduce([seen[m - j : len(r) - j] for j in range(m + 1)])
            if known.sum() < FEWEST * m:
                break
            before = np.stack([r[m - j : len(r) - j][known] for j in lags], axis=1)
            now = r[m:][known]
            weights = np.linalg.lstsq(before, now, rcond=1e-12)[0]
            predictors.append(weights)
            variances.append(float(np.mean((now - before @ weights) ** 2)) + 1e-300)
        orders = np.arange(len(variances))
        best = int(np.argmin(count * np.log(variances) + orders * np.log(max(count, 2))))
        return Autoregression(tuple(predictors[: best + 1]), np.array(variances[: best + 1]))

    def innovations(self, a: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """Return what the samples before do not tell of an array (..., samples, segments).

        Parameters
        ----------
        seen : ndarray of bool, shape (samples, segments)
        """
        known = np.zeros(seen.shape, dtype=int)  # samples in a row before each
        for k in range(1, len(seen)):
            known[k] = np.where(seen[k - 1], known[k - 1] + 1, 0)
        known, result = np.minimum(known, self.order), np.array(a, dtype=float)
        for m in range(1, self.order + 1):
            rows, columns = np.nonzero((known == m) & seen)
            for j, weight in enumerate(self.predictors[m], start=1):
                result[..., rows, columns] -= weight * a[..., rows - j, columns]
        return result * np.sqrt(self.variances[-1] / self.variances[known])
