"""A recorded signal treated for a regression: smoothed, differentiated, its noise known."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import maximum_filter1d

from jaxsr._result import InputError
from jaxsr.recordings import noise_level
from jaxsr.views import (
    DERIVATIVES,
    SMOOTHERS,
    derivative,
    fit_adaptive,
    fit_spline,
    noise_by_sample,
    smooth,
)
from jaxsr.views.derivative import choose_method
from jaxsr.views.finite_difference import finite_difference
from jaxsr.views.gaps import reachable

_NEIGHBOURS = 9  # samples that one stencil joins
_DIGITS = 3e-9  # of the derivative's rms: no recording, or solver, is truer
_LEAST = 24  # samples that two stencils of different order, or a spline, need


@dataclass(frozen=True, slots=True)
class Treatment:
    """How states are smoothed and differentiated; "auto" decides from each signal.

    Attributes
    ----------
    smoothing : str
        "auto", "none", or a key of :data:`jaxsr.views.SMOOTHERS`. "auto" smooths noisy states
        by an adaptive spline, but those whose derivatives are columns, not at all.
    derivative : str
        "auto" or a key of :data:`jaxsr.views.DERIVATIVES`. "auto" takes differences of order 8
        of clean states.
    view : str
        "auto", "derivative" or "weak". "auto" takes the weak view for noisy states.
    """

    smoothing: str = "auto"
    derivative: str = "auto"
    view: str = "auto"

    def __post_init__(self) -> None:
        known = {
            "smoothing": ("auto", "none", *SMOOTHERS),
            "derivative": ("auto", *DERIVATIVES),
            "view": ("auto", "derivative", "weak"),
        }
        for name, values in known.items():
            given = getattr(self, name)
            if given not in values:
                raise InputError(
                    f"unknown {name} {given!r}", "Treatment", f"Use one of {', '.join(values)}."
                )
        if self.view == "weak" and self.derivative != "auto":
            raise InputError("the weak view takes no derivative", "Treatment", "Name one of them.")


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
    weak : bool
        Whether its equation is taken in the weak view.
    treatment : Treatment
    hurried : bool
        Whether it is smoothed evenly.
    """

    time: np.ndarray
    recorded: np.ndarray
    noise: np.ndarray
    clean: bool
    weak: bool
    treatment: Treatment = field(default_factory=Treatment)
    hurried: bool = False

    @functools.cached_property
    def spline(self) -> BSpline:
        """Adaptive smoothing spline through the samples."""
        if self.hurried:
            return fit_spline(self.time, self.recorded, noise=self.noise).spline
        return fit_adaptive(self.time, self.recorded, noise=self.noise).spline

    @property
    def values(self) -> np.ndarray:
        """Samples where they are clean, else smoothed at their times.

        Missing ones among noisy ones are filled between near neighbours, and NaN in long gaps.
        """
        way = self.treatment.smoothing
        if way not in ("auto", "none"):
            return smooth(self.time, self.recorded, way)
        if self.clean or way == "none":
            return self.recorded
        return np.where(self.near, self.spline(self.time), np.nan)

    @functools.cached_property
    def near(self) -> np.ndarray:
        """Whether a sample is there, or missing between near neighbours (samples,)."""
        return reachable(self.time, np.isfinite(self.recorded))

    @property
    def filled(self) -> np.ndarray:
        """Samples as recorded; missing ones between near neighbours smoothed."""
        return np.where(np.isfinite(self.recorded), self.recorded, self.values)

    def derivative(self, order: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the derivative and, where it is known, its error at every sample.

        For clean samples: differences of order 8, whose error is what they differ by from those
        of order 6, plus what rounding and solver noise pass on. Fast parts of a motion are
        resolved less well than slow ones, often by many orders of magnitude; a regression that
        knows it neither bends to the former nor needs to leave them out.
        """
        t, x, way = self.time, self.recorded, self.treatment.derivative
        if way != "auto":
            return derivative(t, self.values, way, order), None
        if not self.clean:
            if len(t) < _LEAST:
                return derivative(t, x, order=order), None
            return np.where(self.near, self.spline(t, order), np.nan), None
        if np.count_nonzero(np.isfinite(x)) < _LEAST:
            return derivative(t, x, order=order), None
        fine = finite_difference(t, x, derivative=order, accuracy=8)
        apart = np.abs(fine - finite_difference(t, x, derivative=order, accuracy=6))
        known = np.isfinite(apart)
        apart[known] = maximum_filter1d(apart[known], _NEIGHBOURS)
        step = float(np.median(np.diff(t)))
        digits = _DIGITS * float(np.sqrt(np.nanmean(fine**2)))
        return fine, apart + 2.0 * noise_level(t, x) / step**order + digits


def treat(
    t: np.ndarray,
    x: np.ndarray,
    treatment: Treatment | None = None,
    *,
    given: bool = False,
    hurried: bool = False,
) -> Treated:
    """Judge a signal's noise; samples that are clean, too few or too uneven stay as they are.

    Parameters
    ----------
    t, x : ndarray, (samples,)
    treatment : Treatment, optional
    given : bool
        Whether the state's derivative is a column: nothing of it is differentiated then.
    hurried : bool
        Whether noise is taken to be even and the weak view is left out, unless it is asked for.
    """
    treatment = treatment or Treatment()
    known = np.isfinite(x)
    few = np.count_nonzero(known) < _LEAST
    forced = treatment.view == "weak" and not given and not few
    level = np.full(len(t), noise_level(t, x))
    clean = Treated(t, x, level, True, forced, treatment)
    if few or given or np.ptp(x[known]) == 0.0 or choose_method(t, x) == "finite_difference":
        return clean
    weak = treatment.view != "derivative" and treatment.derivative == "auto"
    try:
        noise = level if hurried and level[0] > 0.0 else noise_by_sample(t, x)
        weak &= not hurried or treatment.view == "weak"
        treated = Treated(t, x, noise, False, weak, treatment, hurried)
        treated.spline(t[:1])  # made here, so that samples too uneven for it are told
    except np.linalg.LinAlgError:
        return clean
    return treated
