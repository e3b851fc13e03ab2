"""The simulator linearised sample by sample along a path: steps and readings."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from jaxsr.models.late import samples_late
from jaxsr.models.least_squares import LARGEST
from jaxsr.models.lifting import one_step_and_readings
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Segments
from jaxsr.models.simulator import Simulator
from jaxsr.recordings import noise_level


@dataclass(frozen=True, eq=False)
class LocalModel:
    r"""Linear steps and readings about a path, in deviations from it.

    With d the deviation of the state from the path and c a change of the constants,

    .. math:: d_{t+1} = \delta_t + A_t d_t + B_t c, \qquad e_t = H_t d_t + J_t c + \text{noise}.

    Pieces of recordings lie side by side; a piece that is shorter than the others is padded with
    steps that change nothing and samples that nobody measured.

    Attributes
    ----------
    defect : ndarray, shape (steps, pieces, states)
        Where the step map leads, less the path's next sample.
    by_state : ndarray, shape (steps, pieces, states, states)
    by_constant : ndarray, shape (steps, pieces, states, constants)
    innovation : ndarray, shape (samples, pieces, outputs)
        Measured less read off the path; NaN where missing.
    reading : ndarray, shape (samples, pieces, outputs, states)
    reading_by_constant : ndarray, shape (samples, pieces, outputs, constants)
    apart : ndarray, shape (1, pieces), optional
        Log density of readings that are left out of `innovation`; none by default.
    """

    defect: np.ndarray
    by_state: np.ndarray
    by_constant: np.ndarray
    innovation: np.ndarray
    reading: np.ndarray
    reading_by_constant: np.ndarray
    apart: np.ndarray | None = None

    def of(self, pieces: Sequence[int]) -> LocalModel:
        """Return the model of some of the pieces."""
        at = list(pieces)
        changed = {
            part.name: value[:, at]
            for part in fields(self)
            if (value := getattr(self, part.name)) is not None
        }
        return replace(self, **changed)

    def first(self, samples: int) -> LocalModel:
        """Return the model of the first samples of every piece; at least two."""
        names = "defect", "by_state", "by_constant"
        steps = {name: getattr(self, name)[: samples - 1] for name in names}
        names = "innovation", "reading", "reading_by_constant"
        return replace(self, **steps, **{name: getattr(self, name)[:samples] for name in names})

    @property
    def log_apart(self) -> float:
        """Log density of the readings that are left out."""
        return 0.0 if self.apart is None else float(self.apart.sum())

    @property
    def leads_on(self) -> bool:
        """Whether steps and their derivatives are of sizes whose squares are numbers.

        A stiff state may run away within a sample. To hold what runs away for still would cut the
        other states from what they were before: they would owe nothing to the model.
        """
        sizes = (np.abs(v).max(initial=0.0) for v in (self.defect, self.by_state))
        return all(size < LARGEST for size in sizes)

    def by_first(self, count: int) -> LocalModel:
        """Return the model with the first constants alone left to change."""
        by, read = self.by_constant[..., :count], self.reading_by_constant[..., :count]
        return replace(self, by_constant=by, reading_by_constant=read)

    def moved(self, change: np.ndarray) -> LocalModel:
        """Return the model with its constants changed, and none of them left to change."""
        return replace(
            self,
            defect=self.defect + self.by_constant @ change,
            innovation=self.innovation - self.reading_by_constant @ change,
            by_constant=self.by_constant[..., :0],
            reading_by_constant=self.reading_by_constant[..., :0],
        )


def linearised(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: np.ndarray,
    path: np.ndarray,
    active: Sequence[int],
) -> LocalModel:
    """Linearise the step map and the readings about a path.

    Parameters
    ----------
    theta : ndarray, shape (parameters,)
    path : ndarray, shape (states, samples, segments)
    active : sequence of int
        Constants to differentiate by. Derivatives that are not finite become zero: along such a
        direction nothing is known.

    Notes
    -----
    The last few results are kept: what ends an estimate, or tells how fine steps have to be, is
    where the next estimate begins.
    """
    place = simulator, stepping, segments, theta, path
    for known in tuple(_RECENT):
        found = known.asked(*place, active)
        if found is not None:
            return found
    local = _linearised(*place, active)
    _RECENT.append(
        _Known(simulator, stepping, segments, theta.copy(), path.copy(), (*active,), local)
    )
    return local


@dataclass(frozen=True, eq=False)
class _Known:
    """A linearisation, and of what."""

    simulator: Simulator
    stepping: Stepping
    segments: Segments
    theta: np.ndarray
    path: np.ndarray
    active: tuple[int, ...]
    local: LocalModel

    def asked(
        self,
        simulator: Simulator,
        stepping: Stepping,
        segments: Segments,
        theta: np.ndarray,
        path: np.ndarray,
        active: Sequence[int],
    ) -> LocalModel | None:
        """Return the part of it that is asked for; None where it is another one."""
        same = simulator is self.simulator and segments is self.segments
        if not same or stepping != self.stepping or not set(active) <= set(self.active):
            return None
        if not np.array_equal(theta, self.theta) or not np.array_equal(path, self.path):
            return None
        if tuple(active) == self.active:
            return self.local
        at = [self.active.index(j) for j in active]
        by, read = self.local.by_constant[..., at], self.local.reading_by_constant[..., at]
        return replace(self.local, by_constant=by, reading_by_constant=read)


_RECENT: deque[_Known] = deque(maxlen=2)


def _linearised(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: np.ndarray,
    path: np.ndarray,
    active: Sequence[int],
) -> LocalModel:
    """Return what `linearised` does, calculated."""
    with np.errstate(all="ignore"):
        args = simulator, stepping, segments, theta, path, active
        (ends, slopes), (y, by) = one_step_and_readings(*args)
        n = len(path)
        local = LocalModel(
            defects(ends, path, segments).transpose(1, 2, 0),
            np.ascontiguousarray(
                np.nan_to_num(slopes[:, :n], posinf=0.0, neginf=0.0).transpose(2, 3, 0, 1)
            ),
            np.ascontiguousarray(_bounded(slopes[:, n:]).transpose(2, 3, 0, 1)),
            (segments.outputs - y).transpose(1, 2, 0),
            np.ascontiguousarray(_bounded(by[:, :n]).transpose(2, 3, 0, 1)),
            np.ascontiguousarray(_bounded(by[:, n:]).transpose(2, 3, 0, 1)),
        )
        return in_time(simulator, segments, theta, local)


def in_time(
    simulator: Simulator, segments: Segments, theta: np.ndarray, local: LocalModel
) -> LocalModel:
    """Put readings that come late where the state is that they show.

    A reading's derivatives are those by the state at its sample; of one that shows the state of
    several samples before they would move the wrong one. What is left over, readings of states
    before or behind a piece, and of two that by a clock of their own show the same sample the
    second, stands where no reading shows a state and tells of nothing: a path that is continued to
    beyond a piece is no motion of the model. Where what shows states from there is nearer to what
    the sensor reads at any time than to that, it is left out, for that density.
    """
    late = samples_late(simulator, segments, theta)
    if not late:
        return local
    innovation, reading = local.innovation.copy(), local.reading.copy()
    by_constant, apart = local.reading_by_constant.copy(), np.zeros((1, segments.number))
    for k, ages in late.items():
        recorded = segments.outputs[k]
        if not np.isfinite(recorded).any():
            continue
        usual = float(np.nanmean(recorded)), float(np.nanvar(recorded))
        noise = _noise_of(segments, k)
        for piece, count in enumerate(segments.count):
            at, spare, outside = _shown(np.arange(count) - ages[:count, piece])
            for rows in (innovation, reading, by_constant):
                rows[:count, piece, k] = rows[at, piece, k]
            for rows in (reading, by_constant):
                rows[:count, piece, k][spare] = 0.0
            left = innovation[:count, piece, k]  # a view
            along = _log_density(left[outside], 0.0, noise**2)
            alone = _log_density(recorded[at, piece][outside], *usual)
            if alone > along:
                left[outside] = np.nan
                apart[0, piece] += alone
    return replace(
        local,
        innovation=innovation,
        reading=reading,
        reading_by_constant=by_constant,
        apart=apart,
    )


def _shown(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which reading stands at each sample, where one does that shows none, and is outside.

    Parameters
    ----------
    places : ndarray of int, shape (samples,)
        Samples that the readings show, of any range.

    Returns
    -------
    at : ndarray of int, shape (samples,)
    spare, outside : ndarray of bool, shape (samples,)
    """
    count = len(places)
    inside = (places >= 0) & (places < count)
    at, own = np.full(count, -1), np.zeros(count, bool)
    shown, first = np.unique(places[inside], return_index=True)
    readings = np.flatnonzero(inside)[first]
    at[shown], own[readings] = readings, True
    spare = at < 0
    at[spare] = np.flatnonzero(~own)
    return at, spare, spare & ~inside[at]


def _noise_of(segments: Segments, output: int) -> float:
    """Deviation of a sensor's noise as neighbouring samples tell it."""
    values = segments.outputs[output]
    pieces = enumerate(segments.count)
    return float(np.median([noise_level(segments.time[:c, k], values[:c, k]) for k, c in pieces]))


def _log_density(values: np.ndarray, mean: float, variance: float) -> float:
    """Log density of what was measured of some values, all of one normal distribution."""
    if not variance > 0.0:
        return -np.inf
    known = values[np.isfinite(values)]
    scaled = np.log(2.0 * np.pi * variance) + (known - mean) ** 2 / variance
    return -0.5 * float(np.sum(scaled))


def defects(ends: np.ndarray, path: np.ndarray, segments: Segments) -> np.ndarray:
    """Return where samples lead, less the path's next ones; shape (states, steps, segments)."""
    inside = np.arange(1, path.shape[1])[:, None] < segments.count
    return np.where(inside, ends - path[:, 1:], 0.0)


def _bounded(slopes: np.ndarray) -> np.ndarray:
    size = np.abs(slopes).max(axis=(0, 2, 3), initial=0.0)
    kept = np.isfinite(size) & (size < LARGEST)
    return np.where(kept[None, :, None, None], slopes, 0.0)
