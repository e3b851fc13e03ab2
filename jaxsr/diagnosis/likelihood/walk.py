"""Paths through jumps of the state: a motion of the model that a filter keeps near the readings.

What smooths readings knows of no impact: before and behind one its rates are neither's, and steps
from them jump at other samples than the readings do. An extended Kalman filter follows the model
itself, jumps included (Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking
and Navigation (2001), 10.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.sensor_noise import Noise
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import readings_along, walked
from jaxsr.models.model import Model
from jaxsr.models.segments import Segments

LACKING = 0.3
"""Deviation of what pushes along an equation from sample to sample, in the usual change of the
state, beside what free parameters do: enough to follow a force that is missing."""


def through_jumps(
    given: Model,
    problem: Problem,
    theta: np.ndarray,
    noise: Noise,
    start: np.ndarray,
    pushed: Sequence[int],
) -> Problem:
    """Return the problem with a course that jumps as its model does.

    Parameters
    ----------
    given : Model
    problem : Problem
        Of a model that has all that the given one has.
    theta : ndarray, shape (parameters,)
    noise : Noise
        Of the sensors.
    start : ndarray, shape (states,)
        Variances of the states at the start of a piece, about the segments' course.
    pushed : sequence of int
        States whose equations may lack a force.
    """
    order = list(problem.simulator.model.parameters)
    unknown = _unknown(given)
    segments, course = problem.segments, problem.segments.course
    args = problem.simulator, problem.stepping, segments, theta
    usual = np.median(np.abs(np.diff(course, axis=1)), axis=(1, 2))
    process = np.zeros(len(course))
    process[list(pushed)] = (LACKING * usual[list(pushed)]) ** 2
    with np.errstate(all="ignore"):
        y, by = readings_along(*args, course)
        filter = _Filter(
            segments,
            segments.outputs - y,
            by[:, : len(course)],
            noise.white + noise.coloured,
            process,
            np.square([*unknown.values()]),
            np.repeat(np.diag(start)[None], segments.number, axis=0),
        )
        begun = filter.read(0, course[:, 0])
        path = walked(*args, begun, [order.index(name) for name in unknown], filter.led)
    return replace(problem, segments=replace(segments, course=path))


@dataclass(frozen=True, eq=False)
class _Filter:
    """An extended Kalman filter of all pieces side by side.

    Attributes
    ----------
    segments : Segments
    left : ndarray, shape (outputs, samples, pieces)
        What was measured less readings of the course; NaN where missing.
    reading : ndarray, shape (outputs, states, samples, pieces)
        Derivatives of readings along the course.
    noise : ndarray, shape (outputs,)
    process : ndarray, shape (states,)
        Variances of what pushes from one sample to the next.
    unknown : ndarray, shape (constants,)
        Variances of what is believed of constants.
    spread : ndarray, shape (pieces, states, states)
        Of the states; changes from sample to sample.
    """

    segments: Segments
    left: np.ndarray
    reading: np.ndarray
    noise: np.ndarray
    process: np.ndarray
    unknown: np.ndarray
    spread: np.ndarray

    def led(self, k: int, ends: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Return the states at a sample to which the one before leads with these derivatives."""
        course, n = self.segments.course[:, k], len(ends)
        move, by_constant = np.split(np.nan_to_num(slopes.transpose(2, 0, 1)), [n], axis=2)
        ahead = move @ self.spread @ move.transpose(0, 2, 1) + np.diag(self.process)
        ahead += (by_constant * self.unknown) @ by_constant.transpose(0, 2, 1)
        self.spread[:] = 0.5 * (ahead + ahead.transpose(0, 2, 1))
        found = self.read(k, np.where(np.isfinite(ends), ends, course))
        return np.where(k < self.segments.count, found, course)

    def read(self, k: int, state: np.ndarray) -> np.ndarray:
        """Take in the readings of a sample, one sensor after the other."""
        course = self.segments.course[:, k]
        for left, reading, noise in zip(self.left, self.reading, self.noise, strict=True):
            h, seen = reading[:, k].T, np.isfinite(left[k])
            cross = np.einsum("pij,pj->pi", self.spread, h)
            gain = cross * (seen / (np.sum(cross * h, axis=1) + noise))[:, None]
            missed = np.where(seen, left[k], 0.0) - np.sum(h * (state - course).T, axis=1)
            state = state + (gain * missed[:, None]).T
            self.spread[:] -= gain[:, :, None] * cross[:, None, :]
        return state


def _unknown(model: Model) -> dict[str, float]:
    """Return parameters that are not known, and the deviation that each is believed to have.

    They are the free ones, and those that say what an event does: where a jump leads is told by
    nothing else.
    """
    expressions = [e for event in model.events for e in (event.when, *event.reset.values())]
    used = {name for text in expressions for name in model.term(text).variables}
    found: dict[str, float] = {}
    for name, parameter in model.parameters.items():
        if parameter.bounds is not None:
            low, high = parameter.bounds
            found[name] = (high - low) / np.sqrt(12.0)
        elif name in used:
            found[name] = 0.5 * abs(parameter.value)
    return found
