"""Derivatives of recorded states, and how far they can be trusted."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from jaxsr.recordings import noise_level
from jaxsr.views import derivative
from jaxsr.views.derivative import choose_method
from jaxsr.views.finite_difference import finite_difference

_NEIGHBOURS = 9  # samples that one stencil joins
_DIGITS = 3e-9  # of the derivative's rms: no recording, or solver, is truer
_LEAST = 24  # samples that two stencils of different order need


def is_clean(t: np.ndarray, x: np.ndarray, order: int = 1) -> bool:
    """Tell whether differences of the samples are derivatives and not noise."""
    enough = np.count_nonzero(np.isfinite(x)) >= _LEAST
    return enough and choose_method(t, x, order) == "finite_difference"


def estimated_derivative(
    t: np.ndarray, x: np.ndarray, order: int = 1
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the derivative of a state, and its error at every sample where that is known.

    For clean samples: differences of order 8, whose error is what they differ by from those of
    order 6, plus what rounding and solver noise pass on. Fast parts of a motion are resolved
    less well than slow ones, often by many orders of magnitude; a regression that knows it
    neither bends to the former nor needs to leave them out.
    """
    if not is_clean(t, x, order):
        return derivative(t, x, order=order), None
    fine = finite_difference(t, x, derivative=order, accuracy=8)
    apart = np.abs(fine - finite_difference(t, x, derivative=order, accuracy=6))
    known = np.isfinite(apart)
    apart[known] = maximum_filter1d(apart[known], _NEIGHBOURS)
    step = float(np.median(np.diff(t)))
    digits = _DIGITS * float(np.sqrt(np.nanmean(fine**2)))
    return fine, apart + 2.0 * noise_level(t, x) / step**order + digits
