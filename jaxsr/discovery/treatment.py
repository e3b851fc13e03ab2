"""A recorded signal treated for a regression: smoothed, differentiated, its noise known."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import maximum_filter1d

from jaxsr.recordings import noise_level
from jaxsr.views import derivative, fit_adaptive, noise_by_sample
from jaxsr.views.derivative import choose_method
from jaxsr.views.finite_difference import finite_difference

_NEIGHBOURS = 9  # samples that one stencil joins
_DIGITS = 3e-9  # of the derivative's rms: no recording, or solver, is truer
_LEAST = 24  # samples that two stencils of different order, or a spline, need


@dataclass(frozen=True, eq=False)
class Treated:
    """One recorded signal.

    Attributes
    ----------
    time, recorded : ndarray, (samples,)
    noise : ndarray, (samples,)
        Standard deviation of every sample.
    clean : bool
        Whether differences of the samples are derivatives and not noise.
    """

    time: np.ndarray
    recorded: np.ndarray
    noise: np.ndarray
    clean: bool

    @functools.cached_property
    def spline(self) -> BSpline:
        """Adaptive smoothing spline through the samples."""
        return fit_adaptive(self.time, self.recorded, noise=self.noise).spline

    @property
    def values(self) -> np.ndarray:
        """Samples where they are clean, else the smoothing spline at their times."""
        if self.clean:
            return self.recorded
        smooth = self.spline(self.time)
        return np.where(np.isfinite(self.recorded), smooth, np.nan)

    def derivative(self, order: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the derivative and, where it is known, its error at every sample.

        For clean samples: differences of order 8, whose error is what they differ by from those
        of order 6, plus what rounding and solver noise pass on. Fast parts of a motion are
        resolved less well than slow ones, often by many orders of magnitude; a regression that
        knows it neither bends to the former nor needs to leave them out.
        """
        t, x = self.time, self.recorded
        if not self.clean:
            if len(t) < _LEAST:
                return derivative(t, x, order=order), None
            return np.where(np.isfinite(x), self.spline(t, order), np.nan), None
        if np.count_nonzero(np.isfinite(x)) < _LEAST:
            return derivative(t, x, order=order), None
        fine = finite_difference(t, x, derivative=order, accuracy=8)
        apart = np.abs(fine - finite_difference(t, x, derivative=order, accuracy=6))
        known = np.isfinite(apart)
        apart[known] = maximum_filter1d(apart[known], _NEIGHBOURS)
        step = float(np.median(np.diff(t)))
        digits = _DIGITS * float(np.sqrt(np.nanmean(fine**2)))
        return fine, apart + 2.0 * noise_level(t, x) / step**order + digits


def treat(t: np.ndarray, x: np.ndarray, *, smooth: bool = True) -> Treated:
    """Judge a signal's noise; samples that are clean, too few or too uneven stay as they are.

    Parameters
    ----------
    t, x : ndarray, (samples,)
    smooth : bool
        False for a state whose derivative is recorded: nothing of it is differentiated.
    """
    known = np.isfinite(x)
    few = np.count_nonzero(known) < _LEAST
    clean = Treated(t, x, np.full(len(t), noise_level(t, x)), True)
    if few or not smooth or np.ptp(x[known]) == 0.0 or choose_method(t, x) == "finite_difference":
        return clean
    try:
        treated = Treated(t, x, noise_by_sample(t, x), False)
        treated.spline(t[:1])  # made here, so that samples too uneven for it are told
    except np.linalg.LinAlgError:
        return clean
    return treated
