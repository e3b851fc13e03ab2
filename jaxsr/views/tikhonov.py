"""Smoothing and derivatives under a penalty on a derivative, even or adapted to the signal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter1d

from jaxsr._result import InputError
from jaxsr.recordings.noise import noise_level
from jaxsr.views.penalised import CHOICES, PenalisedProblem, gcv

ORDERS = (2, 3, 4)
_FEWEST = 32  # knots tried first; doubled until they resolve the signal
_ADAPTED = 128  # knots of an adapted penalty, at least
_GAIN = 1e-3  # fall of the score that more knots must bring
_LEFT = 1.2  # residual next to the noise up to which nothing is left for more knots to find
_ROUNDS = 3
_REACH = 3.0  # knots over which roughness is averaged (standard deviation)
_FLOOR = 0.05  # of the mean roughness: bounds the penalty where the signal rests


@dataclass(frozen=True)
class PenalisedSpline:
    """A fitted smoothing spline.

    Attributes
    ----------
    spline : BSpline
        x(t), callable at any time, with its derivatives.
    strength : float
        lambda, in seconds^(2 order) next to weights of mean 1.
    freedom : float
        Effective degrees of freedom, the trace of the matrix that takes y to x.
    score : float
        Log of the generalised cross-validation score, in the squared unit of y.
    order : int
        Derivative in the penalty.
    """

    spline: BSpline
    strength: float
    freedom: float
    score: float
    order: int


def tikhonov(
    t: np.ndarray,
    y: np.ndarray,
    derivative: int = 1,
    order: int = 3,
    strength: float | None = None,
    noise: float | np.ndarray | None = None,
    choice: str = "gcv",
) -> np.ndarray:
    r"""Smooth or differentiate under Tikhonov's penalty on a derivative.

    Minimises over splines x of degree 2 order - 1, with weights w_i proportional to 1 / noise_i^2
    and of mean 1 over n present samples,

        1/n sum_i w_i (y_i - x(t_i))^2 + strength / T int (x^(order))^2 dt,   T = t_n - t_1,

    whose gain on a sine of frequency f is 1 / (1 + strength (2 pi f)^(2 order)).

    Parameters
    ----------
    t : ndarray, shape (samples,)
        Strictly increasing time in seconds; need not be uniform.
    y : ndarray, shape (samples,)
        Signal. Missing samples (NaN) are filled by the spline.
    derivative : int
        0, 1, ..., `order`.
    order : int
        Derivative in the penalty: 2, 3 or 4.
    strength : float, optional
        In seconds^(2 order); chosen from the data by default.
    noise : float or ndarray, shape (samples,), optional
        Standard deviation of the noise, for each sample if it varies.
    choice : str
        How to choose the strength: "gcv", generalised cross-validation, n rss / (n - 1.2 df)^2;
        "likelihood", that of y under a Gaussian prior of x^(order); "risk", Stein's unbiased risk
        rss + 2 noise^2 df; "discrepancy", Morozov's rss = n noise^2. The last two take
        `noise_level` if `noise` is not given. The factor 1.2 keeps GCV from the rare fits
        that follow the noise.

    Returns
    -------
    ndarray, shape (samples,)

    Raises
    ------
    InputError
        For another order, derivative or choice, noise that is not positive, or too few samples.

    References
    ----------
    Craven and Wahba, "Smoothing noisy data with spline functions", Numer. Math. 31 (1979).
    Cummins, Filloon and Nychka, "Confidence intervals for nonparametric curve estimates",
    JASA 96 (2001), for the factor on df.
    """
    _check_derivative(derivative, order)
    fit = fit_spline(t, y, order, strength, noise, choice)
    return _evaluate(fit.spline, t, derivative)


def adaptive_spline(
    t: np.ndarray,
    y: np.ndarray,
    derivative: int = 1,
    orders: Sequence[int] = ORDERS,
    noise: float | np.ndarray | None = None,
) -> np.ndarray:
    r"""Smooth or differentiate under a penalty that is weak where the signal is rough.

    The penalty of `tikhonov` becomes strength / T int r(t) (x^(order))^2 dt with
    r = 1 / (u + 0.05 mean(u))^2, u the root mean square of the last fit's x^(order) near t (a
    Gaussian of three knots). Three rounds; the strength by GCV in each. Among the rounds, the even
    penalty and the orders, the least GCV score is taken, so a signal that is equally rough
    everywhere loses nothing.

    Parameters
    ----------
    t, y, derivative, noise
        As for `tikhonov`.
    orders : sequence of int
        Derivatives in the penalty to try.

    Returns
    -------
    ndarray, shape (samples,)

    Raises
    ------
    InputError
        As `tikhonov`.

    References
    ----------
    Storlie, Bondell and Reich, "A locally adaptive penalty for estimation of functions with
    varying roughness", J. Comput. Graph. Stat. 19 (2010), for a penalty from a first fit.
    """
    _check_derivative(derivative, max(orders, default=0))
    return _evaluate(fit_adaptive(t, y, orders, noise).spline, t, derivative)


def fit_spline(
    t: np.ndarray,
    y: np.ndarray,
    order: int = 3,
    strength: float | None = None,
    noise: float | np.ndarray | None = None,
    choice: str = "gcv",
) -> PenalisedSpline:
    """Fit the smoothing spline of `tikhonov`, whose parameters these are.

    Knots lie at quantiles of the times: as few as resolve the signal, since the equations of many
    knots under a strong penalty lose their digits.
    """
    samples = _Samples.read(t, y, order, strength, noise, choice)
    problem, chosen = _resolve(samples, order, strength, choice)
    return samples.restore(problem, problem.solve(chosen), chosen, problem.freedom(chosen))


def fit_adaptive(
    t: np.ndarray,
    y: np.ndarray,
    orders: Sequence[int] = ORDERS,
    noise: float | np.ndarray | None = None,
) -> PenalisedSpline:
    """Fit the spline of `adaptive_spline`, whose parameters these are."""
    if not orders:
        raise InputError("no orders of the penalty", remedy="Give some of 2, 3, 4")
    size = int(np.count_nonzero(np.isfinite(np.asarray(y, dtype=np.float64))))
    # a high order needs samples; the lowest says so if there are too few for it, too
    orders = [k for k in orders if size >= 4 * k] or [min(orders)]
    fits = [_adapt(_Samples.read(t, y, k, None, noise, "gcv"), k) for k in orders]
    return min(fits, key=lambda fit: fit.score)


def _check_derivative(derivative: int, order: int) -> None:
    if not 0 <= derivative <= order:
        raise InputError(f"derivative {derivative} under a penalty of order {order}")


def _evaluate(spline: BSpline, t: np.ndarray, derivative: int) -> np.ndarray:
    t = np.asarray(t, dtype=np.float64)
    return spline.derivative(derivative)(t) if derivative else spline(t)


@dataclass(frozen=True)
class _Samples:
    """Present samples in units of the record's length and the signal's spread."""

    t: np.ndarray
    y: np.ndarray
    weights: np.ndarray
    noise: float  # standard deviation of a sample of weight 1
    start: float
    span: float
    middle: float
    spread: float

    @staticmethod
    def read(
        t: np.ndarray,
        y: np.ndarray,
        order: int,
        strength: float | None,
        noise: float | np.ndarray | None,
        choice: str,
    ) -> _Samples:
        t, y = np.asarray(t, dtype=np.float64), np.asarray(y, dtype=np.float64)
        present = np.isfinite(y)
        if order not in ORDERS:
            raise InputError(f"penalty of order {order}", remedy="Use 2, 3 or 4")
        if choice not in CHOICES:
            raise InputError(f"unknown choice '{choice}'", remedy=f"Use {', '.join(CHOICES)}")
        if strength is not None and not 0.0 <= strength < np.inf:
            raise InputError(f"strength={strength}", remedy="Give a number from 0 up")
        if noise is not None and not np.all(np.asarray(noise, dtype=np.float64) > 0.0):
            raise InputError("noise is not positive everywhere", remedy="Give deviations above 0")
        if np.count_nonzero(present) < 2 * order:
            raise InputError(
                f"{np.count_nonzero(present)} samples are too few for a penalty of order {order}",
                remedy=f"Give at least {2 * order}",
            )
        if noise is None:
            level = noise_level(t, y) if choice in ("risk", "discrepancy") else 1.0
            noise = level or 1e-12 * float(np.ptp(y[present])) or 1.0
        sigma = np.broadcast_to(np.asarray(noise, dtype=np.float64), y.shape)[present]
        relative = (np.min(sigma) / sigma) ** 2
        middle, spread = float(np.mean(y[present])), float(np.ptp(y[present])) or 1.0
        start, span = float(t[0]), float(t[-1] - t[0])
        return _Samples(
            (t[present] - start) / span,
            (y[present] - middle) / spread,
            relative / np.mean(relative),
            float(np.min(sigma) / np.sqrt(np.mean(relative))) / spread,
            start,
            span,
            middle,
            spread,
        )

    def restore(
        self, problem: PenalisedProblem, c: np.ndarray, strength: float, freedom: float
    ) -> PenalisedSpline:
        """Return to seconds and the unit of y."""
        order = problem.order
        knots = self.start + self.span * problem.knots
        spline = BSpline(knots, problem.spline(c).c * self.spread + self.middle, 2 * order - 1)
        score = gcv(problem.residual(c), freedom, self.t.size) + 2.0 * np.log(self.spread)
        return PenalisedSpline(spline, strength * self.span ** (2 * order), freedom, score, order)


def _resolve(
    samples: _Samples, order: int, strength: float | None, choice: str
) -> tuple[PenalisedProblem, float]:
    """As many knots as the signal needs, and the strength with them."""
    count = samples.t.size
    sizes = [_FEWEST]
    while sizes[-1] < count:
        sizes.append(2 * sizes[-1])
    floor = noise_level(samples.t, samples.y)
    best: tuple[float, PenalisedProblem, float] | None = None
    for size in sorted({max(min(size, count), 2 * order) for size in sizes}):
        problem = PenalisedProblem(samples.t, samples.y, samples.weights, order, size)
        if strength is None:
            relative = problem.choose(choice, samples.noise)
        else:
            relative = strength / samples.span ** (2 * order)
            while not problem.solvable(relative):  # stiffer than rounding lets pass
                relative /= 10.0
        score = problem.score(relative, "gcv")
        if best is None or score < best[0] - _GAIN:
            best = (score, problem, relative)
        elif not np.isfinite(score) or problem.remainder(relative) <= _LEFT * floor:
            break
    assert best is not None
    return best[1], best[2]


def _adapt(samples: _Samples, order: int) -> PenalisedSpline:
    """Reweigh the penalty by the last fit's roughness; keep the round of the least score."""
    even, strength = _resolve(samples, order, None, "gcv")
    fits = [samples.restore(even, even.solve(strength), strength, even.freedom(strength))]
    size = min(max(2 * even.size, _ADAPTED), samples.t.size)
    problem = PenalisedProblem(samples.t, samples.y, samples.weights, order, size)
    middles = (problem.edges[1:] + problem.edges[:-1]) / 2.0
    for turn in range(_ROUNDS + 1):
        strength = problem.choose(near=strength)
        # clean data ask for less penalty than makes the equations regular
        if not np.isfinite(problem.score(strength)):
            break
        c = problem.solve(strength)
        if turn:
            fits.append(samples.restore(problem, c, strength, problem.freedom(strength)))
        rough = problem.spline(c).derivative(order)(middles) ** 2
        rough = np.sqrt(gaussian_filter1d(rough, _REACH, mode="nearest"))
        mean = float(np.mean(rough))
        if not mean > 0.0:
            break
        # of one size for this fit, so that the strength need not be searched from afar
        rigour = (rough / mean + _FLOOR) ** -2.0
        rigour *= np.sum(rough**2) / np.sum(rigour * rough**2)
        problem.penalty = problem.penalise(rigour)
    return min(fits, key=lambda fit: fit.score)
