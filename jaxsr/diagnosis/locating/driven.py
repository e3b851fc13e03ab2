"""Where the inputs have spectral lines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import median_filter

HARMONICS = 7
PROMINENT = 20.0
"""Power of a spectral line of an input over the median of its neighbours. The largest of 1000 lines
of white noise reaches ln(1000)/ln(2) = 10."""
NEIGHBOURS = 61
"""Points of the grid, four to a resolved line, over which the median is taken."""


def driven_lines(
    grid: np.ndarray, span: float, time: np.ndarray, inputs: Iterable[np.ndarray]
) -> np.ndarray:
    """Return where on a grid of frequencies an input has a line; for a pure tone, its harmonics.

    A nonlinearity turns one tone into its harmonics, and errors of the weak view leave a little
    of every tone.
    """
    mask, width = np.zeros(grid.size, bool), 3.0 * np.pi / span
    for u in inputs:
        power = np.abs(np.exp(-1j * np.outer(grid, time)) @ (u - u.mean())) ** 2
        top = power.max(initial=0.0)
        lines = np.flatnonzero((power > PROMINENT * floor_of(power)) & (power > 1e-2 * top))
        near = np.abs(grid - grid[np.argmax(power)]) < width
        pure = power[near].sum() > 0.8 * power.sum() > 0.0
        for tone in grid[lines]:
            for k in range(1, HARMONICS + 1 if pure else 2):
                mask |= np.abs(grid - k * tone) < width
    return mask


def floor_of(power: np.ndarray) -> np.ndarray:
    """Median of the neighbours on the grid."""
    return median_filter(power, min(NEIGHBOURS, power.size), mode="nearest")
