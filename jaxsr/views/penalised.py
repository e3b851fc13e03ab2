"""Penalised least squares in B-splines: the equations under Tikhonov and adaptive smoothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.polynomial import Legendre
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.optimize import minimize_scalar
from scipy.sparse.linalg import spsolve

CHOICES = ("gcv", "likelihood", "risk", "discrepancy")
INFLATION = 1.2  # of the degrees of freedom, keeps GCV from the rare fits that follow the noise
_STEP = 0.01  # of log(strength), in the derivative of a determinant
_REFUSED = 1e12  # score of a strength at which rounding takes over
_STIFFEST = 1e12  # largest penalty next to 1 for the samples that rounding lets pass


def gcv(residual: float, freedom: float, samples: int) -> float:
    """Log of the generalised cross-validation score rss / (n - 1.2 df)^2, per sample.

    Parameters
    ----------
    residual : float
        Weighted mean square of y - x.
    freedom : float
        Trace of the matrix that takes y to x.
    samples : int
    """
    left = 1.0 - INFLATION * freedom / samples
    return float(np.log(max(residual, 1e-300)) - 2.0 * np.log(left)) if left > 0.0 else np.inf


class PenalisedProblem:
    """Minimise 1/n sum_i w_i (y_i - x(t_i))^2 + strength int r(t) (x^(order))^2 dt, 0 <= t <= 1.

    x is a spline of degree 2 order - 1 with `count` coefficients c and knots at quantiles of t, so
    that the normal equations (A + strength P) c = b are banded. The weights w have mean 1.

    Polynomials of degree below `order` carry no penalty: the one that fits best is taken out first
    and put back by `spline`, so that rounding in the normal equations touches the rest alone.
    """

    def __init__(
        self, t: np.ndarray, y: np.ndarray, weights: np.ndarray, order: int, count: int
    ) -> None:
        degree = 2 * order - 1
        places = np.linspace(0.0, t.size - 1.0, count - degree + 1)[1:-1]
        inner = np.interp(places, np.arange(t.size), t)
        self.knots = np.concatenate([np.zeros(degree + 1), inner, np.ones(degree + 1)])
        self.order, self.samples, self.size = order, t.size, count
        self.plain = _polynomial(t, y, weights, order)
        y = y - self.plain(t)
        self.y, self.weights = y, weights
        self.basis = sparse.csr_array(BSpline.design_matrix(t, self.knots, degree))
        weighted = sparse.csr_array(self.basis.multiply(weights[:, None] / t.size))
        self.gram = _bands(weighted.T @ self.basis, degree, count)
        self.wanted = weighted.T @ y
        self.total = float(np.mean(weights * y**2))
        self.penalty = self.penalise()

    def penalise(self, rigour: np.ndarray | None = None) -> np.ndarray:
        """Matrix P of the penalty, r(t) = `rigour`, shape (intervals,), between the knots.

        Gauss-Legendre quadrature is exact here.
        """
        order, degree = self.order, 2 * self.order - 1
        points, gauss = np.polynomial.legendre.leggauss(order)
        edges = self.edges
        half = np.diff(edges)[:, None] / 2.0
        share = half * gauss * (1.0 if rigour is None else rigour[:, None])
        t = (edges[:-1, None] + half * (points + 1.0)).ravel()
        low = BSpline.design_matrix(t, self.knots[order:-order], degree - order)
        basis = sparse.csr_array(low)
        # derivatives of B-splines are differences of B-splines of the degree below
        for d in range(order, 0, -1):
            p = degree - d + 1
            inner = self.knots[d - 1 : self.knots.size - d + 1]
            count = inner.size - p - 1
            step = p / (inner[p + 1 : p + count] - inner[1:count])
            diagonals = np.stack([np.append(-step, 0.0), np.append(0.0, step)])
            difference = sparse.dia_array((diagonals, [0, 1]), shape=(count - 1, count))
            basis = sparse.csr_array(basis @ difference)
        weighted = sparse.csr_array(basis.multiply(share.ravel()[:, None]))
        return _bands(weighted.T @ basis, degree, self.size)

    @property
    def edges(self) -> np.ndarray:
        """Knots without their repetition at the ends, shape (intervals + 1,)."""
        return self.knots[2 * self.order - 1 : self.size + 1]

    def spline(self, c: np.ndarray) -> BSpline:
        """Return x(t) of coefficients c, the polynomial put back."""
        degree = 2 * self.order - 1
        # at the Greville points interpolation by splines of this degree is well conditioned
        places = np.lib.stride_tricks.sliding_window_view(self.knots[1:-1], degree).mean(axis=1)
        design = BSpline.design_matrix(np.clip(places, 0.0, 1.0), self.knots, degree)
        plain = spsolve(design.tocsc(), self.plain(places))
        return BSpline(self.knots, c + plain, degree)

    def factor(self, strength: float) -> np.ndarray:
        """Cholesky factor of A + strength P in lower band form."""
        return cholesky_banded(self.gram + strength * self.penalty, lower=True, check_finite=False)

    def solvable(self, strength: float) -> bool:
        """Whether rounding leaves A + strength P positive definite, also where `freedom` looks."""
        try:
            for near in (-_STEP, 0.0, _STEP):
                self.factor(strength * np.exp(near))
        except LinAlgError:
            return False
        return True

    def solve(self, strength: float) -> np.ndarray:
        """Coefficients c."""
        return cho_solve_banded((self.factor(strength), True), self.wanted, check_finite=False)

    def determinant(self, strength: float) -> float:
        """Return log det(A + strength P)."""
        return float(2.0 * np.log(self.factor(strength)[0]).sum())

    def freedom(self, strength: float) -> float:
        """Trace of (A + s P)^-1 A: the size less the derivative of log det(A + s P) by log s."""
        if strength == 0.0:
            return float(self.size)
        low, high = (self.determinant(strength * np.exp(d)) for d in (-_STEP, _STEP))
        return float(self.size - (high - low) / (2.0 * _STEP))

    def residual(self, c: np.ndarray) -> float:
        """Weighted mean square of y - x."""
        return float(np.mean(self.weights * (self.y - self.basis @ c) ** 2))

    def remainder(self, strength: float) -> float:
        """Root mean square of y - x, all samples alike."""
        return float(np.sqrt(np.mean((self.y - self.basis @ self.solve(strength)) ** 2)))

    def score(self, strength: float, choice: str = "gcv", noise: float = 0.0) -> float:
        """What a choice of the strength minimises; infinite where rounding takes over."""
        try:
            c = self.solve(strength)
            if choice == "likelihood":
                lost = max(self.total - float(self.wanted @ c), 1e-300)
                prior = (self.size - self.order) * np.log(strength)
                fit = (self.samples - self.order) * np.log(lost)
                return fit + self.determinant(strength) - prior
            residual = self.residual(c)
            if choice == "discrepancy":
                return float(abs(np.log(max(residual, 1e-300) / noise**2)))
            freedom = self.freedom(strength)
        except LinAlgError:
            return np.inf
        if choice == "risk":
            return residual + 2.0 * noise**2 * freedom / self.samples
        return gcv(residual, freedom, self.samples)

    def choose(self, choice: str = "gcv", noise: float = 0.0, near: float | None = None) -> float:
        """Strength of the least score: over all strengths, or within two decades of `near`."""

        def score(log_strength: float) -> float:
            # finite, since the search forms differences
            return min(self.score(float(np.exp(log_strength)), choice, noise), _REFUSED)

        if near is None:
            scale = np.log(np.max(self.gram[0]) / np.max(self.penalty[0]))
            logs = scale + np.log(10.0) * np.arange(-8.0, np.log10(_STIFFEST))
        else:
            logs = np.log(near) + np.log(10.0) * np.array([-2.0, 0.0, 2.0])
        scores = np.array([score(x) for x in logs])
        least = int(np.argmin(scores))
        bounds = logs[max(least - 1, 0)], logs[min(least + 1, logs.size - 1)]
        found: Any = minimize_scalar(score, bounds=bounds, method="bounded", options={"xatol": 0.1})
        return float(np.exp(found.x if found.fun < scores[least] else logs[least]))


def _polynomial(t: np.ndarray, y: np.ndarray, weights: np.ndarray, order: int) -> Legendre:
    """Return the polynomial of degree below `order` of least weighted squares over [0, 1]."""
    return Legendre.fit(t, y, order - 1, domain=[0.0, 1.0], w=np.sqrt(weights))


def _bands(matrix: sparse.csr_array, degree: int, size: int) -> np.ndarray:
    """Lower band form of a symmetric sparse matrix."""
    bands = np.zeros((degree + 1, size))
    for d in range(min(degree + 1, size)):
        bands[d, : size - d] = matrix.diagonal(-d)
    return bands
