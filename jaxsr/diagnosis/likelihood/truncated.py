"""Normal distributions cut off at the bounds of their constants: mode, integral, deviations."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from scipy.linalg import get_lapack_funcs
from scipy.optimize import lsq_linear
from scipy.special import erfcx, log_ndtr, ndtri_exp

from jaxsr.diagnosis.likelihood.bounded_modes import NORMAL, ROUNDING, STEEP

_potrf, _potrs, _trtri = get_lapack_funcs(("potrf", "potrs", "trtri"), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Truncated:
    r"""The density exp(-z'Mz/2 + r'z) inside bounds, about its mode there.

    Attributes
    ----------
    matrix : ndarray, shape (constants, constants)
        M, at least the identity.
    right : ndarray, shape (constants,)
        r.
    low, high : ndarray, shape (constants,)
    mode : ndarray, shape (constants,)
        Inside the bounds.
    held : ndarray of bool, shape (constants,)
        What is at a bound, because the density is larger beyond.
    factor : ndarray
        Cholesky factor of the matrix of those that are not held.
    """

    matrix: np.ndarray
    right: np.ndarray
    low: np.ndarray
    high: np.ndarray
    mode: np.ndarray
    held: np.ndarray
    factor: np.ndarray

    @staticmethod
    def of(matrix: np.ndarray, right: np.ndarray, low: np.ndarray, high: np.ndarray) -> Truncated:
        """Find the mode inside the bounds."""
        held, factor = np.zeros(len(right), bool), factored(matrix)
        mode = _solved(factor, right)
        if ((mode < low) | (mode > high)).any():
            mode, held = _held_inside(matrix, right, low, high, factor)
            factor = factored(matrix[np.ix_(~held, ~held)])
        return Truncated(matrix, right, low, high, mode, held, factor)

    @functools.cached_property
    def log_integral(self) -> float:
        r"""Log of the integral inside the bounds over (2 pi)^(n/2) times the density at the mode.

        About a mode that touches no bound the marginals tell which share of each constant lies
        inside. Of a constant that is held the density falls from its bound, with slope s and
        curvature k of what the free constants leave, as exp(-s t - k t^2 / 2): exact where one is
        held and no other one is near its bounds.
        """
        free, held = ~self.held, self.held
        inverse = _inverted(self.factor)
        own = np.sqrt((inverse**2).sum(axis=0))
        total = -float(np.log(np.diag(self.factor)).sum())
        total += log_inside(self.mode[free], own, self.low[free], self.high[free])
        if not held.any():
            return total
        root = np.sqrt(self._curvature)
        near = self.slope / root
        far = near + (self.high - self.low)[held] * root
        beyond = np.exp(-0.5 * (far - near) * (far + near)) * erfcx(far / np.sqrt(2.0))
        share = 0.5 * (erfcx(near / np.sqrt(2.0)) - beyond)
        with np.errstate(divide="ignore"):
            return total + float(np.sum(np.log(share) - np.log(root)))

    @functools.cached_property
    def deviation(self) -> np.ndarray:
        """Standard deviations; of what is held those whose double reaches to 95 % of its own."""
        free, held = ~self.held, self.held
        found = np.empty(len(self.mode))
        inverse = _inverted(self.factor)
        variance = (inverse**2).sum(axis=0)
        if held.any():
            # An exponential fall is as wide as its slope says, a normal one as its curvature.
            own = 1.0 / np.maximum(self._curvature, self.slope**2)
            variance = variance + _solved(self.factor, self._across) ** 2 @ own
            found[held] = self._reach / NORMAL
        found[free] = np.sqrt(variance)
        return found

    @property
    def _reach(self) -> np.ndarray:
        """How far from their bounds 95 % of what is held lies, the other bound left aside."""
        root = np.sqrt(self._curvature)
        near = np.minimum(self.slope / root, STEEP)
        beyond = -ndtri_exp(np.log(0.05) + log_ndtr(-near))
        return np.minimum((beyond - near) / root, -np.log(0.05) / np.maximum(self.slope, 1e-300))

    @property
    def _across(self) -> np.ndarray:
        """Elements between free constants and those that are held."""
        return self.matrix[np.ix_(~self.held, self.held)]

    @functools.cached_property
    def slope(self) -> np.ndarray:
        """How fast the log density falls from the bounds of what is held."""
        return np.abs((self.matrix @ self.mode - self.right)[self.held])

    @functools.cached_property
    def _curvature(self) -> np.ndarray:
        """Precision of each constant that is held, what is free following."""
        own = np.diag(self.matrix)[self.held]
        across = self._across
        # At least that of the prior: sums over precise readings cancel up to rounding.
        return np.maximum(own - (across * _solved(self.factor, across)).sum(axis=0), 1.0)


def _held_inside(
    matrix: np.ndarray, right: np.ndarray, low: np.ndarray, high: np.ndarray, factor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mode inside bounds, and which constants are held there (active sets)."""
    held = np.zeros(len(right), bool)
    mode = _solved(factor, right)
    for _ in range(2 * len(right)):
        outside = ~held & ((mode < low) | (mode > high))
        if outside.any():
            held |= outside
        else:
            slope = matrix @ mode - right
            pulled = np.where(held, np.where(mode <= low, -slope, slope), 0.0)
            if pulled.max() <= ROUNDING * (1.0 + np.abs(slope).max()):
                return mode, held
            held[np.argmax(pulled)] = False  # the density is larger inside
        free = ~held
        mode = np.clip(mode, low, high)
        pull = right[free] - matrix[np.ix_(free, held)] @ mode[held]
        mode[free] = _solved(factored(matrix[np.ix_(free, free)]), pull)
    return _by_library(right, low, high, factor)  # sets that go round


def _by_library(
    right: np.ndarray, low: np.ndarray, high: np.ndarray, factor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mode inside bounds, and what is held there, by bounded least squares."""
    apart = ROUNDING * (1.0 + np.minimum(np.abs(low), np.abs(high)))  # it wants room between
    half = np.linalg.solve(factor, right)
    found = lsq_linear(factor.T, half, (low - apart, high + apart), method="bvls")
    return np.clip(found.x, low, high), found.active_mask != 0


def factored(matrix: np.ndarray) -> np.ndarray:
    """Return the Cholesky factor of the identity and something positive semidefinite.

    Sums over many precise readings are positive up to rounding alone: an eigenvalue below one is
    one.

    Raises
    ------
    numpy.linalg.LinAlgError
        An element is no number.
    """
    if not len(matrix):
        return matrix
    # Of matrices of a few rows the checks around LAPACK cost more than LAPACK.
    factor, failed = _potrf(matrix, lower=1, clean=1)
    if not failed:
        return factor
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("a product of innovations is no number")
    values, vectors = np.linalg.eigh(matrix)
    root = np.sqrt(np.maximum(values, 1.0))[:, None] * vectors.T
    triangle = np.asarray(np.linalg.qr(root, mode="r"))
    return (triangle * np.sign(np.diag(triangle))[:, None]).T


def log_inside(mean: np.ndarray, deviation: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Return the log of the shares of normal distributions that lie inside bounds, summed."""
    # By the tails on the side where they are small: a difference of two ones would be noise.
    low, high = (low - mean) / deviation, (high - mean) / deviation
    turned = high < -low
    low, high = np.where(turned, -high, low), np.where(turned, -low, high)
    above, beyond = log_ndtr(-low), log_ndtr(-high)
    share = np.exp(np.minimum(beyond, above - 1e-12) - np.maximum(above, -1e300))
    return float(np.sum(above + np.log1p(-share)))


def _solved(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    return _potrs(factor, right, lower=1)[0] if right.size else right


def _inverted(factor: np.ndarray) -> np.ndarray:
    """Return the inverse of a lower triangle."""
    return _trtri(factor, lower=1)[0] if len(factor) else factor
