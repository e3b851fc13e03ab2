"""What normal running looks like: the filter that makes it likeliest, and how sure that is."""

# SciPy states no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from scipy.optimize import minimize

from jaxsr._result import InputError
from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.models.segments import Prepared
from jaxsr.monitoring.following import LANES, Filter, Followed, Follower, Window
from jaxsr.monitoring.windows import batches

if TYPE_CHECKING:
    from jaxtyping import Float

MOST = 2 * LANES
"""Windows that noise and unknown force are estimated on."""
STEPS = (10, 10, 40)
"""Steps of the estimates, each along the motion that the last one followed."""
BEGIN, SLOW, FAINT = 0.2, 8.0, 0.02
"""Where an estimate begins: coloured noise relative to the white part, its time in samples, and the
unknown force relative to the net force."""
LEAST, MOST_SIZE = 1e-6, 1e4
"""Least and largest variance of noise, relative to that which neighbouring samples tell."""
TIMES = (0.5, 200.0)
"""Least and largest correlation times, in samples."""
STEP = 1e-4
"""Difference of a logarithm by which the likelihood is differentiated."""
SURE, VAGUE = 3.0, 1.0
"""Standard deviations that the truth may be away from the estimate, and what is believed of a
logarithm that normal running does not tell."""


@dataclass(frozen=True, eq=False)
class Units:
    """Logarithms that an estimate is made in: white and coloured noise, its time, force, its time.

    Attributes
    ----------
    white : ndarray, shape (outputs,)
    size : ndarray, shape (forces,)
    """

    white: Float[np.ndarray, " outputs"]
    size: Float[np.ndarray, " forces"]

    @staticmethod
    def of(follower: Follower) -> Units:
        """Return the units of a model's sensors and forces."""
        return Units(follower.noise.white, np.where(follower.size > 0.0, follower.size, 1.0))

    @property
    def begin(self) -> Float[np.ndarray, " logarithms"]:
        """Logarithms with which an estimate begins."""
        k, m = len(self.white), len(self.size)
        parts = np.zeros(k), np.full(k, np.log(BEGIN)), np.full(k, np.log(SLOW))
        return np.concatenate([*parts, np.full(m, np.log(FAINT)), [np.log(SLOW)]])

    @property
    def bounds(self) -> Float[np.ndarray, "logarithms 2"]:
        """Least and largest of every logarithm."""
        k, m = len(self.white), len(self.size)
        every = [*[(LEAST, MOST_SIZE)] * (2 * k), *[TIMES] * k, *[(1e-6, 10.0)] * m, TIMES]
        return np.log(every)

    def filter(self, logs: Float[np.ndarray, " logarithms"]) -> Filter:
        """Return the filter of some logarithms."""
        k, m = len(self.white), len(self.size)
        white, coloured = self.white * np.exp(logs[:k]), self.white * np.exp(logs[k : 2 * k])
        correlation = np.exp(-np.exp(-logs[2 * k : 3 * k]))
        scale = self.size * np.exp(logs[3 * k : 3 * k + m])
        return Filter(Noise(white, coloured, correlation), scale, float(np.exp(-np.exp(-logs[-1]))))

    def around(self, logs: Float[np.ndarray, " logarithms"]) -> list[Filter]:
        """Return the filter of some logarithms, and of each of them a little larger."""
        return [self.filter(p) for p in (logs, *(logs + STEP * np.eye(len(logs))))]


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal running, and how well it is known.

    Attributes
    ----------
    units : Units
    logs : ndarray, shape (logarithms,)
        The likeliest filter's.
    scores : ndarray, shape (blocks, logarithms)
        Derivatives of the log density of each block of normal running.
    """

    units: Units
    logs: Float[np.ndarray, " logarithms"]
    scores: Float[np.ndarray, "blocks logarithms"]

    @property
    def filter(self) -> Filter:
        """The likeliest filter."""
        return self.units.filter(self.logs)

    @property
    def covariance(self) -> Float[np.ndarray, "logarithms logarithms"]:
        """Uncertainty of the logarithms, by the scores of the blocks (Berndt et al. 1974)."""
        precision = self.scores.T @ self.scores + np.eye(len(self.logs)) / VAGUE**2
        return np.linalg.inv(precision)

    def least_favourable(self, gains: Float[np.ndarray, " blocks"]) -> Filter:
        r"""Return the normal running, as near as the estimate leaves open, most like a change.

        With the covariance C of the logarithms and the mean score g of blocks as the change has
        them, it is :math:`\hat\eta + r C g / \sqrt{g^T C g}`. If the truth is nearer to the
        estimate, the expected ratio of the change's density to this one is at most 1.

        Parameters
        ----------
        gains : ndarray, shape (blocks,)
            Logarithms of the ratio of the change's density to the likeliest one.
        """
        weights = np.exp(gains - gains.max())
        mean = weights @ self.scores / weights.sum() - self.scores.mean(axis=0)
        step = self.covariance @ mean
        length = float(np.sqrt(max(mean @ step, 1e-300)))
        low, high = self.units.bounds.T
        return self.units.filter(np.clip(self.logs + SURE * step / length, low, high))


def calibrated(
    follower: Follower, prepared: Sequence[Prepared], windows: Sequence[Window]
) -> tuple[Follower, Normal, list[Followed]]:
    """Estimate noise and unknown force on normal running, by the likelihood of its innovations.

    Parameters
    ----------
    follower : Follower
    prepared : sequence of Prepared
        Normal recordings.
    windows : sequence of Window

    Returns
    -------
    follower : Follower
        With steps so fine that the sensors do not see their errors.
    normal : Normal
    followed : list of Followed
        The windows that it rests on.

    Raises
    ------
    InputError
        There is too little of it, or the model has no motion there.
    """
    if len(windows) < 2:
        what = "too short to say what is normal"
        raise InputError(what, prepared[0].recording.name, "Give more of normal running")
    places = np.unique(np.linspace(0, len(windows) - 1, MOST).astype(int))
    every = list(batches([windows[int(k)] for k in places], LANES))
    units = Units.of(follower)
    logs, parts = units.begin, list[Followed]()
    follower = follower.resolved(prepared, every[0], units.filter(logs))
    for steps in STEPS:
        parts = [follower.follow(prepared, part, units.filter(logs)) for part in every]
        if not any(p.finite.any() for p in parts):
            what = "the model has no motion along these recordings"
            raise InputError(what, prepared[0].recording.name, "Diagnose them first")
        logs = _likeliest(follower, parts, units, logs, steps)
    found = densities(follower, parts, units.around(logs))
    scores = np.nan_to_num((found[1:] - found[0]).T / STEP)
    return follower, Normal(units, logs, scores), parts


def densities(
    follower: Follower, parts: Sequence[Followed], filters: Sequence[Filter]
) -> Float[np.ndarray, "filters windows"]:
    """Return log densities of all that was followed."""
    return np.concatenate([follower.log_likelihoods(p, filters) for p in parts], axis=1)


def _likeliest(
    follower: Follower, parts: Sequence[Followed], units: Units, begin: np.ndarray, steps: int
) -> np.ndarray:
    """Return the logarithms that make what is judged likeliest, after at most so many steps."""
    readings = max(sum(p.readings for p in parts), 1)

    def loss(logs: np.ndarray) -> tuple[float, np.ndarray]:
        found = np.nansum(densities(follower, parts, units.around(logs)), axis=1)
        score = -found / readings
        if not np.isfinite(score).all():
            return 1e6, np.zeros(len(logs))
        return float(score[0]), (score[1:] - score[0]) / STEP

    options = {"maxiter": steps, "ftol": 1e-8}
    found: Any = minimize(
        loss, begin, jac=True, method="L-BFGS-B", bounds=units.bounds, options=options
    )
    least = np.asarray(cast("Any", found).x)
    return least if loss(least)[0] <= loss(begin)[0] else begin
