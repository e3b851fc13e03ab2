"""Equations that need no search: a state whose derivative is another state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import cumulative_trapezoid

from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.samples import Samples
from jaxsr.expressions.term import Term
from jaxsr.recordings import noise_level

_MOST_LEFT = 0.1  # of the motion's square that an integral may miss, however noisy the sensor


def recognised(samples: Samples, state: str, states: Sequence[str]) -> str | None:
    """Return the state whose integral over time is ``state``, if there is one.

    The integral is compared and not the derivative: it needs no differentiation and averages
    noise. The slope must be 1 within 1 % and what noise adds, and what is left over at most 2 % of
    the motion, or twice the sensor's noise.
    """
    time = samples.variables[next(iter(samples.variables))]
    groups = [samples.group == number for number in np.unique(samples.group)]
    motion = _centred(samples.variables[state], groups)
    levels = [noise_level(time[rows], samples.variables[state][rows]) for rows in groups]
    noise = sum(v**2 * np.count_nonzero(g) for v, g in zip(levels, groups, strict=True))
    if not motion @ motion > 0.0:
        return None
    size = float(motion @ motion)
    allowed = min(max(4e-4 * size, 4.0 * noise), _MOST_LEFT * size)
    for other in states:
        rate = samples.variables[other]
        if other == state or not np.any(rate):
            continue
        parts = [cumulative_trapezoid(rate[rows], time[rows], initial=0.0) for rows in groups]
        area = np.concatenate([part - np.mean(part) for part in parts])
        if not area @ area > 0.0:
            continue
        slope = float(area @ motion / (area @ area))
        left = motion - slope * area
        # neighbours of a noisy rate's integral err alike: a tenth of the samples tell something
        doubt = np.sqrt(10.0 * float(left @ left) / (size * len(left)))
        if abs(slope - 1.0) < 0.01 + 2.0 * doubt and left @ left < allowed:
            return other
    return None


def _centred(values: np.ndarray, groups: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([values[rows] - np.mean(values[rows]) for rows in groups])


def kinematic(state: str, rate: str, train: Samples, judge: Samples) -> Equation:
    """Return the equation d(state)/dt = rate."""

    def mse(part: Samples) -> float:
        return float(np.mean((part.targets[state] - part.variables[rate]) ** 2))

    exact = FittedTerm(Term.variable(rate), 1.0, (1.0, 1.0), given=True)
    return Equation(state, (exact,), mse(train), mse(judge))
