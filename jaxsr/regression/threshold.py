"""Hard thresholding with a check on the residual (paper Eq. 12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxsr._result import InputError
from jaxsr.regression.gram import Array


@dataclass(frozen=True, slots=True)
class HardThreshold:
    r"""Remove the terms whose coefficients are negligible and whose removal costs nothing.

    Candidates for removal are

    .. math:: \mathcal K = \{F_k \mid |\xi_k| \le \sigma\,\max_j |\xi_j|\};

    they go together if the residual sum of squares rises by at most ``tolerance`` of itself, else
    one by one in the order of what they cost, as long as that holds.

    Parameters
    ----------
    sigma : float
        Threshold :math:`\sigma`, in [0, 1).
    tolerance : float
        Relative rise of the residual sum of squares that counts as neglectable.
    floor : float
        Residual, relative to :math:`y^T y`, below which a fit is exact to rounding; a rise that
        stays under it counts as none.

    References
    ----------
    Askari and Crevecoeur, section 4.3. They compare raw coefficients; the columns here have unit
    norm, so a term is judged by its share of the equation whatever its unit.
    """

    sigma: float = 1e-4
    tolerance: float = 1e-3
    floor: float = 1e-14

    def __post_init__(self) -> None:
        if not 0.0 <= self.sigma < 1.0:
            raise InputError(f"sigma must lie in [0, 1), got {self.sigma}", "HardThreshold")
        if self.tolerance < 0.0 or self.floor < 0.0:
            raise InputError("tolerance and floor must not be negative", "HardThreshold")

    def keep(self, matrix: Array, moment: Array, total: float, ridge: float = 1e-10) -> list[int]:
        """Return the positions of the terms that stay, at least one.

        Parameters
        ----------
        matrix : ndarray, (terms, terms)
            Gram matrix of unit-norm columns.
        moment : ndarray, (terms,)
        total : float
            :math:`y^T y`.
        """
        kept = list(range(len(moment)))
        xi, rss = _solve(matrix, moment, total, kept, ridge)
        allowed = max(rss * (1.0 + self.tolerance), self.floor * total)
        while len(kept) > 1:
            limit = self.sigma * np.max(np.abs(xi))
            small = [k for k, value in zip(kept, xi, strict=True) if abs(value) <= limit]
            small = small[: len(kept) - 1]
            if not small:
                break
            trials = [small] if len(small) > 1 else []
            trials += [[k] for k in small]
            costs = []
            for trial in trials:
                rest = [k for k in kept if k not in trial]
                costs.append(_solve(matrix, moment, total, rest, ridge)[1])
            # all at once first; one by one only where that is not allowed
            best = 0 if costs[0] <= allowed else int(np.argmin(costs))
            if costs[best] > allowed:
                break
            kept = [k for k in kept if k not in trials[best]]
            xi, _ = _solve(matrix, moment, total, kept, ridge)
        return kept


def _solve(
    matrix: Array, moment: Array, total: float, kept: list[int], ridge: float
) -> tuple[Array, float]:
    block = matrix[np.ix_(kept, kept)]
    b = moment[kept]
    xi = np.asarray(np.linalg.solve(block + ridge * np.eye(len(kept)), b), np.float64)
    return xi, max(float(total - 2.0 * xi @ b + xi @ block @ xi), 0.0)
