"""Equations that need no search: a state whose derivative is another state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.integrate import cumulative_trapezoid

from jaxsr.discovery.equation import Equation, FittedTerm
from jaxsr.discovery.samples import Samples
from jaxsr.expressions.term import Term
from jaxsr.recordings import noise_level


def recognised(samples: Samples, state: str, states: Sequence[str]) -> str | None:
    """Return the state whose integral over time is ``state``, if there is one.

    The integral is compared and not the derivative: it needs no differentiation and averages
    noise. The slope must be 1 within 1 %, and what is left over at most 2 % of the motion, or
    twice the sensor's noise.
    """
    time = samples.variables[next(iter(samples.variables))]
    x = samples.variables[state]
    for other in states:
        if other == state:
            continue
        columns, parts, noise = [], [], []
        for number in np.unique(samples.group):
            rows = samples.group == number
            integral = cumulative_trapezoid(samples.variables[other][rows], time[rows], initial=0.0)
            columns.append(integral - np.mean(integral))
            parts.append(x[rows] - np.mean(x[rows]))
            noise.append(noise_level(time[rows], x[rows]) ** 2 * np.count_nonzero(rows))
        area, motion = np.concatenate(columns), np.concatenate(parts)
        if not area @ area > 0.0 or not motion @ motion > 0.0:
            continue
        slope = float(area @ motion / (area @ area))
        left = motion - slope * area
        allowed = max(4e-4 * float(motion @ motion), 4.0 * float(np.sum(noise)))
        if abs(slope - 1.0) < 0.01 and left @ left < min(allowed, 0.04 * (motion @ motion)):
            return other
    return None


def kinematic(state: str, rate: str, train: Samples, judge: Samples) -> Equation:
    """Return the equation d(state)/dt = rate."""

    def mse(part: Samples) -> float:
        return float(np.mean((part.targets[state] - part.variables[rate]) ** 2))

    exact = FittedTerm(Term.variable(rate), 1.0, (1.0, 1.0))
    return Equation(state, (exact,), mse(train), mse(judge))
