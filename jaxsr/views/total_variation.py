"""Derivatives regularised by total variation, which keep jumps sharp."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solveh_banded

from jaxsr._result import InputError
from jaxsr.recordings.noise import noise_level

_ITERATIONS = 40
_SMOOTHING = 1e-4  # of the spread of the jumps: makes |jump| differentiable
_TOLERANCE = 1e-5  # change of the residual between iterations that ends them
_BISECTIONS = 24
_FAINT = 1e-6
_MARGIN = 1.03  # on the noise: to fit noise costs more than to smooth a little too much
_STIFFEST = 1e11  # largest entry of the normal equations, next to 1 for a sample


def total_variation(
    t: np.ndarray,
    y: np.ndarray,
    derivative: int = 1,
    strength: float | None = None,
    noise: float | None = None,
) -> np.ndarray:
    r"""Differentiate under a penalty on the total variation of the derivative.

    Minimises over the smoothed signal x, with u = x^(derivative),

        1/2 sum_i (y_i - x_i)^2 + strength * sum_i |u_{i+1} - u_i|.

    This is the functional of Chartrand with u = dx/dt as the unknown's derivative, so that every
    matrix is banded and an iteration costs O(samples). Solved by lagged diffusivity.

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds; need not be uniform.
    y : ndarray, shape (samples,)
        Signal. Missing samples (NaN) are filled by the regularisation.
    derivative : int
        1, or 2 (total variation of the second derivative).
    strength : float, optional
        Weight of the penalty. By default the discrepancy principle: the residual's root mean
        square equals the noise.
    noise : float, optional
        Standard deviation of the noise; `noise_level` by default.

    Returns
    -------
    ndarray, shape (samples,)

    Raises
    ------
    InputError
        For another derivative, a negative strength or too few samples.

    References
    ----------
    Chartrand, "Numerical differentiation of noisy, nonsmooth data", ISRN Applied Mathematics
    (2011), Eq. 2 and section 2; the principle is Morozov's.
    """
    t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
    present = np.isfinite(y)
    if derivative not in (1, 2):
        raise InputError(f"total variation of derivative {derivative}", remedy="Use 1 or 2")
    if strength is not None and not strength >= 0.0:
        raise InputError(f"strength={strength} of the penalty", remedy="Give a number from 0 up")
    if np.count_nonzero(present) < derivative + 3:
        raise InputError(f"{np.count_nonzero(present)} samples", remedy="Give more")
    # unit spacing and unit spread keep the equations well scaled
    h = (t[-1] - t[0]) / (t.size - 1)
    middle, spread = float(np.mean(y[present])), float(np.ptp(y[present]))
    if spread == 0.0:
        return np.zeros(t.size)
    problem = _Problem((t - t[0]) / h, (y - middle) / spread, present, derivative)
    if strength is not None:
        smooth = problem.solve(strength / (spread * h**derivative))
    else:
        noise = noise_level(t, y) if noise is None else noise
        smooth = _by_discrepancy(problem, noise / spread)
    return problem.differentiate(smooth) * (spread / h**derivative)


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

    def __init__(self, t: np.ndarray, y: np.ndarray, present: np.ndarray, derivative: int) -> None:
        index = np.arange(y.size)
        self.filled = np.interp(index, index[present], y[present])
        # missing samples weigh next to nothing, enough to keep the equations regular
        self.present = np.where(present, 1.0, _FAINT)
        self.derivative = derivative
        # bands[r, j]: coefficient of x[r + j]; level k holds the k-th derivative
        self.bands = [np.ones((t.size, 1))]
        self.times = [t]
        for _ in range(derivative):
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
        """Solve (P + J' diag(weights) J) x = P y, P one for the present samples."""
        rows, width = self.jump.shape
        # beyond this the present samples would be lost in rounding
        weights = np.minimum(weights, _STIFFEST / np.sum(self.jump**2, axis=1))
        upper = np.zeros((width, self.filled.size))
        upper[-1] = self.present
        for j in range(width):
            for k in range(j, width):
                upper[width - 1 - (k - j), k : k + rows] += (
                    weights * self.jump[:, j] * self.jump[:, k]
                )
        return solveh_banded(upper, self.present * self.filled, check_finite=False)

    def residual(self, smooth: np.ndarray) -> float:
        """Root mean square of what the smoothing took away."""
        return float(
            np.sqrt(np.sum(self.present * (self.filled - smooth) ** 2) / self.present.sum())
        )

    def differentiate(self, smooth: np.ndarray) -> np.ndarray:
        """The derivative at the samples; it is piecewise constant between them."""
        between = _apply(self.bands[-1], smooth)
        return np.interp(self.times[0], self.times[-1], between)


def _difference(bands: np.ndarray) -> np.ndarray:
    """Bands of row r + 1 minus row r."""
    result = np.zeros((bands.shape[0] - 1, bands.shape[1] + 1))
    result[:, 1:] += bands[1:]
    result[:, :-1] -= bands[:-1]
    return result


def _apply(bands: np.ndarray, x: np.ndarray) -> np.ndarray:
    rows = bands.shape[0]
    return sum((bands[:, j] * x[j : j + rows] for j in range(bands.shape[1])), start=np.zeros(rows))
