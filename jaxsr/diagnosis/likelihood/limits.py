"""Readings at the limit of a sensor: they tell that the motion goes beyond it, and no more.

Noise that was there before the limit does not show behind it, so that such readings are censored
(Tobin, Econometrica 26, 1958): where a path leads beyond the limit they are certain. In the unit of
the other readings, a density, that is one in a step of what is read; or, where noise follows the
limit, the density of that noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxsr.diagnosis.likelihood.workspace import Workspace, in_columns
from jaxsr.diagnosis.mechanisms.limits import CLIPPING, FLAT, GRAIN, MIRRORED
from jaxsr.diagnosis.mechanisms.site import Threshold
from jaxsr.diagnosis.mechanisms.super_model import SuperModel
from jaxsr.models.least_squares import Problem
from jaxsr.models.lifting import readings_along

STANDING = 4.0
"""Deviations of the noise before its limit in which a sensor stands at it."""


@dataclass(frozen=True, eq=False)
class Limit:
    """One end of a sensor's range, by what a member of a set says.

    Attributes
    ----------
    output : int
    column : int
        Of the limit, among the parameters of the super-model.
    value : float
        At which the sensor stands.
    unlimited : float
    mirrored : bool
        Whether the other end of the range is the negative of this one.
    """

    output: int
    column: int
    value: float
    unlimited: float
    mirrored: bool

    def reached(self, readings: np.ndarray, depth: float) -> np.ndarray:
        """Whether readings are at the limit or beyond it, or before it by less than a depth."""
        with np.errstate(invalid="ignore"):
            if self.mirrored:
                return np.abs(readings) > self.value - depth
            sign = np.sign(self.unlimited)
            return sign * readings > sign * self.value - depth


def limits_of(model: SuperModel, members: Sequence[int]) -> list[Limit]:
    """Return the limits of sensors that members tell."""
    names, found = list(model.model.parameters), []
    for i in members:
        candidate = model.candidates[i]
        if candidate.mechanism != CLIPPING:
            continue
        ((output, reading),) = candidate.readings
        number, mirrored = model.given.outputs.index(output), reading == MIRRORED
        for end in candidate.parameters:
            assert isinstance(end, Threshold)
            column = names.index(model.names[i][end.name])
            found.append(Limit(number, column, end.seed, end.neutral, mirrored))
    return found


@dataclass(frozen=True, eq=False)
class _Standing:
    """Samples that stand at a limit: exactly, or up to the noise of a sensor that follows it.

    Attributes
    ----------
    samples : ndarray of bool, shape (samples, pieces)
    off : ndarray, shape (samples, pieces)
        From the limit, in deviations of the noise; zero where they are exact.
    width : float
        Of a density as high as theirs: a step of what is read where they are exact, which no noise
        is finer than, else that of the noise.
    reach : float
        Of all readings.
    """

    samples: np.ndarray
    off: np.ndarray
    width: float
    reach: float

    @staticmethod
    def of(work: Workspace, limit: Limit) -> _Standing:
        """Look at the readings of the sensor."""
        readings = work.narrow.segments.outputs[limit.output]
        seen = np.unique(readings[np.isfinite(readings)])
        reach = float(np.ptp(seen))
        off = (np.abs(readings) if limit.mirrored else readings) - limit.value
        with np.errstate(invalid="ignore"):
            exact = np.abs(off) <= GRAIN * reach
        if np.count_nonzero(exact) >= FLAT:
            steps = np.diff(seen)
            width = float(steps[steps > GRAIN * reach].min())
            return _Standing(exact, np.zeros(readings.shape), width, reach)
        deviation = float(np.sqrt(work.scales.told[limit.output]))
        near = limit.reached(readings, STANDING * deviation)
        return _Standing(near, off / deviation, float(np.sqrt(2.0 * np.pi)) * deviation, reach)


def at_limits(work: Workspace, limits: Sequence[Limit]) -> np.ndarray:
    """Return which samples stand at limits.

    Returns
    -------
    ndarray of bool, shape (outputs, samples, pieces)
    """
    found = np.zeros(work.narrow.segments.outputs.shape, bool)
    for limit in limits:
        found[limit.output] |= _Standing.of(work, limit).samples
    return found


@dataclass(frozen=True, eq=False)
class Censored:
    """Samples that a path leads beyond limits, at which the sensors stand.

    Attributes
    ----------
    samples : ndarray of bool, shape (outputs, samples, pieces)
    log_density : float
        Of these samples, and of where the limits are among all values that the sensors read.
    deviation : ndarray, shape (limits,)
        To which the samples tell each limit.
    """

    samples: np.ndarray
    log_density: float
    deviation: np.ndarray

    @staticmethod
    def along(
        work: Workspace,
        limits: Sequence[Limit],
        problem: Problem,
        values: np.ndarray,
        columns: Sequence[int],
        path: np.ndarray,
    ) -> Censored:
        """Follow the readings of a path without its limits.

        Parameters
        ----------
        problem : Problem
            Of the set.
        values : ndarray, shape (parameters,)
            Of the problem.
        columns : sequence of int
            Where the limits stand among them.
        path : ndarray, shape (states, samples, pieces)
        """
        free = values.copy()
        free[list(columns)] = [limit.unlimited for limit in limits]
        args = problem.simulator, problem.stepping, problem.segments, free, path
        with np.errstate(all="ignore"):
            read = readings_along(*args, late=True, live=True)[0]
        beyond, log, deviation = np.zeros(read.shape, bool), 0.0, []
        for limit in limits:
            standing, along = _Standing.of(work, limit), read[limit.output]
            here = standing.samples & limit.reached(along, 0.0)
            if limit.mirrored:  # at the end where the sensor stands
                here &= along * problem.segments.outputs[limit.output] > 0.0
            count = int(np.count_nonzero(here))
            log -= count * np.log(standing.width) + 0.5 * np.sum(np.square(standing.off[here]))
            # Where the limit is, of all values that are read.
            log += np.log(standing.width / (np.sqrt(max(count, 1)) * standing.reach))
            deviation.append(standing.width / np.sqrt(max(count, 1)))
            beyond[limit.output] |= here
        return Censored(beyond, float(log), np.array(deviation))


def blind(problem: Problem, samples: np.ndarray) -> Problem:
    """Return a problem without some readings."""
    outputs = np.where(samples, np.nan, problem.segments.outputs)
    return replace(problem, segments=replace(problem.segments, outputs=outputs))


def censored(
    work: Workspace, members: Sequence[int], theta: np.ndarray, path: np.ndarray
) -> Workspace:
    """Return the workspace without the readings that a set's path leads beyond its limits.

    Parameters
    ----------
    theta : ndarray, shape (parameters of the super-model,)
    path : ndarray, shape (states of the given model, samples, pieces)
    """
    limits = limits_of(work.columns, [k for k, i in enumerate(work.place) if i in members])
    if not limits:
        return work
    columns, values = [limit.column for limit in limits], in_columns(work, theta)
    found = Censored.along(work, limits, work.narrow, values, columns, path)
    return replace(work, narrow=blind(work.narrow, found.samples))
