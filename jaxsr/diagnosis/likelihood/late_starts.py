"""Where the search for a sensor's delay or clock begins.

A path that follows a late sensor is late itself, in part: about it no delay leads to the true one.
The path on which all other sensors lead shows by how much this one is late.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.diagnosis.mechanisms.timing import REACH
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import readings_along


def late_sensors(model: SuperModel, members: Sequence[int]) -> list[tuple[int, str]]:
    """Return sensors that come late, or by a clock of their own, by what members say.

    None where no other sensor is left to tell the motion.

    Returns
    -------
    list of (int, str)
        Number of the output, and the parameter of the super-model that shifts it.
    """
    found = []
    for i in members:
        candidate = model.candidates[i]
        for signal, _ in (*candidate.delays, *candidate.clock):
            if signal in model.given.outputs:
                name = model.names[i][candidate.parameters[0].name]
                found.append((model.given.outputs.index(signal), name))
    alone = len({k for k, _ in found}) == len(model.given.outputs)
    return [] if alone else found


def best_shift(
    problem: Problem, theta: np.ndarray, path: np.ndarray, output: int, column: int
) -> float:
    """Return the value of a shift with which the readings of a path are nearest to a sensor's.

    Parameters
    ----------
    theta : ndarray, shape (parameters,)
    path : ndarray, shape (states, samples, pieces)
    output : int
    column : int
        Of the shift, among the parameters; values within its bounds are tried, about a sample
        apart.
    """
    bounds = list(problem.simulator.model.parameters.values())[column].bounds
    best, least = float(theta[column]), np.inf
    if bounds is None:
        return best
    for value in np.linspace(*bounds, 2 * int(REACH) + 1):
        tried = theta.copy()
        tried[column] = value
        args = problem.simulator, problem.stepping, problem.segments, tried, path
        with np.errstate(all="ignore"):
            read = readings_along(*args, late=True, live=True)[0][output]
            loss = float(np.nansum((problem.segments.outputs[output] - read) ** 2))
        if loss < least:
            best, least = float(value), loss
    return best
