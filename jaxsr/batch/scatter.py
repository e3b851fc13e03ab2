"""Regression of values that have intervals of their own and scatter besides."""

# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

Vector = NDArray[np.float64]
_TINY = 1e-12  # standard error relative to the values below which nothing is told apart
FEWEST = 3  # machines beside one that it is compared with, and dates of one


@dataclass(frozen=True)
class Regression:
    r"""Weighted least squares with a variance that all values share.

    Attributes
    ----------
    coefficients : array of shape (columns,)
    covariance : array of shape (columns, columns)
    variance : float
        Scatter of the values beside their own errors: the estimate of Paule and Mandel, with
        which :math:`\sum r_i^2 / (\tau^2 + s_i^2)` is the number of degrees of freedom, or zero.
    freedom : int
        Degrees of freedom.
    """

    coefficients: Vector
    covariance: Vector
    variance: float
    freedom: int

    def bound(self, rate: float) -> float:
        """Return the quantile that Student's t exceeds, on either side, at a rate."""
        return -float(special.stdtrit(self.freedom, 0.5 * rate))


def regression(design: Vector, values: Vector, errors: Vector) -> Regression:
    """Fit values, of which each has a standard error of its own, to a design.

    Parameters
    ----------
    design : array of shape (values, columns)
    values, errors : arrays of shape (values,)
    """
    freedom = len(values) - design.shape[1]
    plain = _solved(design, values, np.ones(len(values)))
    most = float(np.sum((values - design @ plain[0]) ** 2)) / freedom
    floor = (_TINY * max(float(np.max(np.abs(values))), np.finfo(float).tiny)) ** 2
    own = errors**2 + floor

    def excess(share: float) -> float:
        weights = 1.0 / (share * most + own)
        left = values - design @ _solved(design, values, weights)[0]
        return float(np.sum(weights * left**2)) - freedom

    # With the plain variance of the residuals the sum is no more than the degrees of freedom.
    variance = 0.0
    if excess(0.0) > 0.0:
        variance = most * float(cast("Any", optimize).brentq(excess, 0.0, 2.0))
    return Regression(*_solved(design, values, 1.0 / (variance + own)), variance, freedom)


def _solved(design: Vector, values: Vector, weights: Vector) -> tuple[Vector, Vector]:
    covariance: Vector = np.asarray(
        np.linalg.inv(design.T @ (weights[:, None] * design)), dtype=np.float64
    )
    return covariance @ (design.T @ (weights * values)), covariance


@dataclass(frozen=True)
class Outlier:
    """A value outside of where the others predict it."""

    place: int
    low: float
    high: float


def outliers(values: Vector, errors: Vector, rate: float) -> list[Outlier]:
    """Return the values outside the predictive intervals that all others give.

    Each is left out in turn; the interval holds the spread of the others, the uncertainty of
    their mean and the value's own error. Machines that are alike and spread normally fall
    outside at no more than `rate`, each.
    """
    found: list[Outlier] = []
    if len(values) <= FEWEST:
        return found
    for place in range(len(values)):
        others = np.arange(len(values)) != place
        fit = regression(np.ones((len(values) - 1, 1)), values[others], errors[others])
        middle = float(fit.coefficients[0])
        spread = fit.variance + errors[place] ** 2 + float(fit.covariance[0, 0])
        reach = fit.bound(rate) * float(np.sqrt(spread))
        if not abs(values[place] - middle) <= reach:
            found.append(Outlier(place, middle - reach, middle + reach))
    return found


@dataclass(frozen=True)
class Trend:
    """A change over time, per day."""

    slope: float
    low: float
    high: float


def trend(days: Vector, values: Vector, errors: Vector, rate: float) -> Trend | None:
    """Return the slope of values over time with its 95 % interval; None where it may be zero.

    It is told where zero lies outside the interval that misses it at `rate`, for values that
    scatter independently about a constant.
    """
    if len(values) < FEWEST or len(np.unique(days)) < FEWEST:
        return None
    scale = float(np.ptp(days))
    design = np.column_stack([np.ones(len(days)), (days - days.mean()) / scale])
    fit = regression(design, values, errors)
    slope, error = float(fit.coefficients[1]), float(np.sqrt(fit.covariance[1, 1]))
    if abs(slope) <= fit.bound(rate) * error:
        return None
    reach = fit.bound(0.05) * error
    return Trend(slope / scale, (slope - reach) / scale, (slope + reach) / scale)
