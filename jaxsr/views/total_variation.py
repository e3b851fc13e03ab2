"""Smoothing and derivatives regularised by total variation, which keep jumps sharp."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded

from jaxsr._result import InputError
from jaxsr.recordings.noise import noise_level
from jaxsr.views.penalised import gcv

_ITERATIONS = 40
_SMOOTHING = 1e-4  # of the spread of the jumps: makes |jump| differentiable
_TOLERANCE = 1e-5  # change of the residual between iterations that ends them
_BISECTIONS = 24
_FAINT = 1e-6
_ACTIVE = 0.1  # of the mean jump: one of this size counts half as a degree of freedom
_MARGIN = 1.03  # on the noise: to fit noise costs more than to smooth a little too much
_STIFFEST = 1e11  # largest entry of the normal equations, next to 1 for a sample


def total_variation(
    t: np.ndarray,
    y: np.ndarray,
    derivative: int = 1,
    strength: float | None = None,
    noise: float | np.ndarray | None = None,
    order: int | None = None,
) -> np.ndarray:
    r"""Smooth or differentiate under a penalty on the total variation of a derivative.

    Minimises over the smoothed signal x, with u = x^(order) and weights w_i proportional to
    1 / noise_i^2 and of mean 1,

        1/2 sum_i w_i (y_i - x_i)^2 + strength * sum_i |u_{i+1} - u_i|.

    This is the functional of Chartrand with u = dx/dt as the unknown's derivative, so that every
    matrix is banded and an iteration costs O(samples). Solved by lagged diffusivity.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds; need not be uniform.
    y : ndarray, shape (samples,)
        Signal. Missing samples (NaN) are filled by the regularisation.
    derivative : int
        0 (the smoothed signal), 1 or 2.
    strength : float, optional
        Weight of the penalty. By default the discrepancy principle: the residual's root mean
        square equals the noise.
    noise : float or ndarray, shape (samples,), optional
        Standard deviation of the noise, for each sample if it varies; `noise_level` by default.
    order : int, optional
        Derivative whose variation counts, from `derivative` to 3: 0 keeps steps of the signal,
        1 kinks. By default `derivative`, and 2 for the smoothed signal.

    Returns
    -------
    ndarray, shape (samples,)

    Raises
    ------
    InputError
        For another derivative or order, a negative strength or too few samples.

    References
    ----------
    Chartrand, "Numerical differentiation of noisy, nonsmooth data", ISRN Applied Mathematics
    (2011), Eq. 2 and section 2; the principle is Morozov's.
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    order = (derivative or 2) if order is None else order
    _check(t, y, derivative, order, strength, noise)
    h, middle, spread = _units(t, y)
    if spread == 0.0:
        return np.full(t.size, 0.0 if derivative else middle)
    problem, smooth = _fit(t, y, strength, noise, order)
    x = problem.differentiate(smooth, derivative) * (spread / h**derivative)
    return x if derivative else x + middle


def total_variation_score(
    t: np.ndarray, y: np.ndarray, noise: float | np.ndarray | None, order: int
) -> float:
    """Log of the GCV score of the smoothed signal, comparable to `PenalisedSpline.score`."""
    _check(t, y, 0, order, None, noise)
    spread = _units(t, y)[2]
    if spread == 0.0:
        return -np.inf
    problem, smooth = _fit(t, y, None, noise, order)
    count = int(np.count_nonzero(np.isfinite(y)))
    return gcv(problem.residual(smooth) ** 2, problem.freedom(smooth), count) + 2 * np.log(spread)


def _check(
    t: np.ndarray,
    y: np.ndarray,
    derivative: int,
    order: int,
    strength: float | None,
    noise: float | np.ndarray | None,
) -> None:
    count = int(np.count_nonzero(np.isfinite(y)))
    if derivative not in (0, 1, 2):
        raise InputError(f"total variation for derivative {derivative}", remedy="Use 0, 1 or 2")
    if not derivative <= order <= 3:
        raise InputError(
            f"variation of derivative {order}", remedy=f"Use an order from {derivative} to 3"
        )
    if strength is not None and not strength >= 0.0:
        raise InputError(f"strength={strength} of the penalty", remedy="Give a number from 0 up")
    if isinstance(noise, np.ndarray) and not np.all(np.asarray(noise) > 0.0):
        raise InputError("noise is not positive everywhere", remedy="Give deviations above 0")
    if count < order + 3:
        raise InputError(f"{count} samples", remedy=f"Give at least {order + 3}")


def _units(t: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Mean interval, mean and spread: in these units the equations are well scaled."""
    known = y[np.isfinite(y)]
    return (t[-1] - t[0]) / (t.size - 1), float(np.mean(known)), float(np.ptp(known))


def _fit(
    t: np.ndarray,
    y: np.ndarray,
    strength: float | None,
    noise: float | np.ndarray | None,
    order: int,
) -> tuple[_Problem, np.ndarray]:
    """The problem in `_units` and its solution there."""
    h, middle, spread = _units(t, y)
    present = np.isfinite(y)
    weights = present.astype(np.float64)
    level = noise
    if isinstance(noise, np.ndarray):
        sigma = np.broadcast_to(noise, y.shape)
        inverse = np.where(present, (np.min(sigma) / sigma) ** 2, 0.0)
        weights = inverse / np.mean(inverse[present])
        level = float(np.min(sigma) / np.sqrt(np.mean(inverse[present])))
    problem = _Problem((t - t[0]) / h, (y - middle) / spread, present, order, weights)
    if strength is not None:
        return problem, problem.solve(strength / (spread * h**order))
    level = noise_level(t, y) if level is None else float(level)
    return problem, _by_discrepancy(problem, level / spread)


def _by_discrepancy(problem: _Problem, noise: float) -> np.ndarray:
    """Bisect the strength until the residual is as large as the noise."""
    noise = _MARGIN * noise
    strength = max(noise, 1e-14)
    smooth = problem.solve(strength)
    low = high = None
    for _ in range(_BISECTIONS):
        residual = problem.residual(smooth)
        if abs(residual - noise) <= 0.005 * noise:
            break
        if residual > noise:
            high = strength
        else:
            low = strength
        if low is not None and high is not None:
            strength = float(np.sqrt(low * high))
        else:
            strength *= 4.0 if high is None else 0.25
        if not 1e-12 < strength < 1e12:
            break
        smooth = problem.solve(strength, smooth)
    return smooth


class _Problem:
    """The functional on a grid of unit mean spacing."""

    def __init__(
        self,
        t: np.ndarray,
        y: np.ndarray,
        present: np.ndarray,
        order: int,
        weights: np.ndarray,
    ) -> None:
        index = np.arange(y.size)
        self.filled = np.interp(index, index[present], y[present])
        # missing samples weigh next to nothing, enough to keep the equations regular
        self.weights = np.where(present, weights, _FAINT)
        # bands[r, j]: coefficient of x[r + j]; level k holds the k-th derivative
        self.bands = [np.ones((t.size, 1))]
        self.times = [t]
        for _ in range(order):
            above, times = self.bands[-1], self.times[-1]
            step = np.diff(times)[:, None]
            self.bands.append(_difference(above) / step)
            self.times.append((times[1:] + times[:-1]) / 2.0)
        self.jump = _difference(self.bands[-1])

    def solve(self, strength: float, start: np.ndarray | None = None) -> np.ndarray:
        """Minimise by lagged diffusivity: reweighted quadratic penalties."""
        smooth = self.filled if start is None else start
        before = np.inf
        for _ in range(_ITERATIONS):
            jumps = np.abs(_apply(self.jump, smooth))
            floor = _SMOOTHING * max(float(np.mean(jumps)), 1e-12)
            smooth = self._weighted(strength / np.hypot(jumps, floor))
            residual = self.residual(smooth)
            if abs(residual - before) <= _TOLERANCE * residual:
                break
            before = residual
        return smooth

    def _weighted(self, weights: np.ndarray) -> np.ndarray:
        """Solve (W + J' diag(weights) J) x = W y, W the weights of the samples."""
        rows, width = self.jump.shape
        # beyond this the present samples would be lost in rounding
        weights = np.minimum(weights, _STIFFEST / np.sum(self.jump**2, axis=1))
        upper = np.zeros((width, self.filled.size))
        upper[-1] = self.weights
        for j in range(width):
            for k in range(j, width):
                upper[width - 1 - (k - j), k : k + rows] += (
                    weights * self.jump[:, j] * self.jump[:, k]
                )
        return solveh_banded(upper, self.weights * self.filled, check_finite=False)

    def freedom(self, smooth: np.ndarray) -> float:
        """Degrees of freedom: the jumps that are not zero, and those of the null space."""
        jumps = np.abs(_apply(self.jump, smooth))
        floor = _ACTIVE * max(float(np.mean(jumps)), 1e-300)
        return self.jump.shape[1] - 1.0 + float(np.sum(jumps**2 / (jumps**2 + floor**2)))

    def residual(self, smooth: np.ndarray) -> float:
        """Root mean square of what the smoothing took away."""
        return float(
            np.sqrt(np.sum(self.weights * (self.filled - smooth) ** 2) / self.weights.sum())
        )

    def differentiate(self, smooth: np.ndarray, derivative: int) -> np.ndarray:
        """A derivative at the samples, from its values between them."""
        between = _apply(self.bands[derivative], smooth)
        return np.interp(self.times[0], self.times[derivative], between)


def _difference(bands: np.ndarray) -> np.ndarray:
    """Bands of row r + 1 minus row r."""
    result = np.zeros((bands.shape[0] - 1, bands.shape[1] + 1))
    result[:, 1:] += bands[1:]
    result[:, :-1] -= bands[:-1]
    return result


def _apply(bands: np.ndarray, x: np.ndarray) -> np.ndarray:
    rows = bands.shape[0]
    return sum((bands[:, j] * x[j : j + rows] for j in range(bands.shape[1])), start=np.zeros(rows))
