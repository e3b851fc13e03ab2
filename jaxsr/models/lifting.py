r"""Segments linearised about a whole path at once, and condensed to their starts.

The states at all samples, x_k, are unknowns beside the parameters theta; the simulation is the
set of conditions x_{k+1} = F_k(x_k, theta) with F_k the integration from one sample to the next.
Linearised about a path,

    dx_{k+1} = (dF_k/dx) dx_k + (dF_k/dtheta) dtheta + (F_k(x_k) - x_{k+1}),

so that every dx_k is linear in dx_0 and dtheta. All F_k are evaluated side by side; only the
products of small matrices go from sample to sample. The path need not be a simulation until the
end, which keeps unstable and chaotic systems near their data.

References
----------
Albersmeyer & Diehl, SIAM J. Optim. 20 (2010); Bock & Plitt, IFAC Proc. 17 (1984).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.models.ground import (
    Ground,
)
from jaxsr.models.late import late_readings
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Segments
from jaxsr.models.sensitivity import condensed
from jaxsr.models.simulator import Simulator

Array = Any
CLOSING, CLOSING_LONG, SHORT = 8, 20, 60
"""Newton iterations to a simulation, for segments of up to `SHORT` samples and for longer ones,
which are dear to simulate from sample to sample."""


AHEAD, BEHIND = 2, 2
"""Samples ahead of one into which an event fell, and behind it, that the model leads to anew."""


def liftable(simulator: Simulator) -> bool:
    """Whether a simulator consists of formulas."""
    return simulator.function is None


@dataclass(frozen=True, eq=False)
class Linear:
    """Segments as linear functions of their starts and of parameters, about a path.

    Attributes
    ----------
    path : ndarray, shape (states, samples, segments)
    shift : ndarray, shape (states, samples, segments)
        What has to be added to the path for a simulation from its start, to first order.
    spread : ndarray, shape (samples, segments, states, directions)
        Derivatives of the states: by the start first, then by the active parameters.
    outputs : ndarray, shape (outputs, samples, segments)
        Readings of the simulation from the path's start, to first order in `shift`.
    gap : ndarray, shape (outputs, samples, segments)
        What `shift` adds to the readings: how far the path is from a simulation.
    by_theta : ndarray, shape (active, outputs, samples, segments)
    by_start : ndarray, shape (states, outputs, samples, segments)
    """

    path: Array
    shift: Array
    spread: Array
    outputs: Array
    gap: Array
    by_theta: Array
    by_start: Array

    def moved(self, start: Array, theta: Array, share: float = 1.0) -> Array:
        """Return the path after a step of the starts (states, segments) and active parameters."""
        n = self.path.shape[0]
        by_start = np.einsum("ksij,js->iks", self.spread[..., :n], start)
        by_theta = np.einsum("ksij,j->iks", self.spread[..., n:], theta)
        return self.path + share * (self.shift + by_start + by_theta)


def linear(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: Array,
    path: Array,
    active: Sequence[int] | np.ndarray,
) -> Linear:
    """Linearise all segments about a path.

    Parameters
    ----------
    theta : ndarray, shape (parameters,)
    path : ndarray, shape (states, samples, segments)
    active : sequence of int
        Parameters to differentiate by.
    """
    ground = Ground.of(simulator, stepping, segments, theta, active)
    n, own = len(simulator.model.states), ground.own
    ends, slopes = ground.step(path)
    slopes = slopes if own.all() else slopes * own[None, :, None, :]
    spread, shift = condensed(slopes, ends - path[:, 1:])
    y, by = _read(ground, path + shift, spread)
    gap = y - np.stack(ground.field.readings(ground.at(path))[0])
    y, by = late_readings(simulator, segments, ground.values, ground.to, (y, by))
    return Linear(path, shift, spread, y, gap, by[n:], by[:n])


def one_step(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: Array,
    path: Array,
    active: Sequence[int] = (),
    tangents: bool = True,
) -> tuple[Array, Array]:
    """Return where each sample of a path leads by the next, and the derivatives.

    Returns
    -------
    ends : ndarray, shape (states, samples - 1, segments)
    slopes : ndarray, shape (states, states + active, samples - 1, segments)
        By the state at the earlier sample, then by the active parameters; in no direction
        without `tangents`.
    """
    return Ground.of(simulator, stepping, segments, theta, active).step(path, tangents=tangents)


def readings_along(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: Array,
    path: Array,
    active: Sequence[int] = (),
    late: bool = False,
    live: bool = False,
) -> tuple[Array, Array]:
    """Return readings of a path and their derivatives; delays and clocks only where `late`.

    Shapes are (outputs, samples, segments) and (outputs, states + active, samples, segments).
    """
    return Ground.of(simulator, stepping, segments, theta, active).read(path, late, live)


def one_step_and_readings(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: Array,
    path: Array,
    active: Sequence[int],
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return what `one_step` and `readings_along` do of a path; sensors may be live before it."""
    ground = Ground.of(simulator, stepping, segments, theta, active)
    return ground.step(path), ground.read(path, late=True, live=True)


def carried_errors(
    simulator: Simulator,
    coarse: tuple[Stepping, Segments],
    fine: tuple[Stepping, Segments],
    theta: Array,
    path: Array,
) -> Array:
    """Return how far two ways to integrate lead apart in the readings, to first order.

    Both start from the states of a path, sample by sample; the differences are carried along by
    the model's own derivatives.
    """
    ends, slopes = one_step(simulator, *coarse, theta, path)
    other, _ = one_step(simulator, *fine, theta, path, tangents=False)
    apart = condensed(slopes, other - ends)[1]
    _, by = readings_along(simulator, *coarse, theta, path)
    return np.einsum("oits,its->ots", by, apart)


def simulated(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: Array,
    x0: Array,
    stop: Callable[[], bool] = lambda: False,
) -> Array | None:
    """Simulate every segment from its start; None where the path does not close, or `stop` says so.

    Newton's method on the states at all samples; the sensors' states are the first guess.
    Returned are the outputs, shape (outputs, samples, segments).
    """
    path = segments.course.copy()
    path[:, 0] = x0
    path = closed(simulator, stepping, segments, theta, path, stop)
    if path is None:
        return None
    ground = Ground.of(simulator, stepping, segments, theta, ())
    y = np.stack(ground.field.readings(ground.at(path))[0])
    read = y, np.zeros((0, *y.shape))
    return late_readings(simulator, segments, ground.values, ground.to, read)[0]


def walked(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: Array,
    start: Array,
    active: Sequence[int],
    corrected: Callable[[int, Array, Array], Array],
) -> Array:
    """Return a path that is followed sample by sample and put right by what is read on the way.

    Parameters
    ----------
    start : ndarray, shape (states, segments)
    corrected : callable
        Of a sample's number, where the one before leads (states, segments), and the derivatives of
        that (states, states + active, segments); returns the states there.
    """
    ground = Ground.of(simulator, stepping, segments, theta, active)
    path = np.repeat(start[:, None], len(segments.time), axis=1)
    for k in range(path.shape[1] - 1):
        ends, slopes = ground.step(path[:, k : k + 2], k)
        path[:, k + 1] = corrected(k + 1, ends[:, 0], slopes[:, :, 0])
    return path


def through_events(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    before: tuple[Array, Array],
    after: tuple[Array, Array],
) -> Array:
    """Return a moved path whose samples about events are where the model leads.

    A sample behind an event that comes later now was moved to where no motion is: behind the jump,
    beyond the surface. The model leads there from the samples ahead of it.

    Parameters
    ----------
    before, after : (theta, path)
        In steps from the first path events happened; the second one is changed.
    """
    events = Ground.of(simulator, stepping, segments, before[0], ()).jumped(before[1])
    ground = Ground.of(simulator, stepping, segments, after[0], ())
    path = after[1].copy()
    led = np.zeros_like(events)
    for shift in range(-AHEAD, BEHIND + 1):
        rows = slice(max(shift, 0), len(events) + min(shift, 0))
        led[rows] |= events[max(-shift, 0) : len(events) - max(shift, 0)]
    for _ in range(AHEAD + BEHIND + 1):
        ends = ground.step(path, tangents=False)[0]
        path[:, 1:] = np.where(led & np.isfinite(ends).all(0), ends, path[:, 1:])
    return path


def closed(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: Array,
    path: Array,
    stop: Callable[[], bool] = lambda: False,
    near: bool = True,
) -> Array | None:
    """Return the simulation from a path's starts, shape (states, samples, segments).

    Newton's method from that path; what it does not close, where a law has corners, goes step by
    step, as all does that is not `near`. None where states are not finite, or `stop` says so.
    """
    ground = Ground.of(simulator, stepping, segments, theta, ())
    long, last = path.shape[1] > SHORT, path.shape[1] - 1
    most = (CLOSING_LONG if long else CLOSING) if near else 0
    with np.errstate(all="ignore"):
        first, found = ground.newton(path, most, stop)
        if first == last:
            return found
        # Where Newton's method went astray, the path that it came from is nearer.
        begun = np.concatenate([found[:, : first + 1], path[:, first + 1 :]], axis=1)
        # Explicit steps at a corner multiply errors.
        if near and long and stepping.method == "rodas3":
            found = ground.by_windows(begun, first, stop)
            if found is not None and ground.newton(found, 1, stop)[0] == last:
                return found
        return ground.forward(begun, stop)


def _read(ground: Ground, path: Array, spread: Array) -> tuple[Array, Array]:
    """Readings along a path, and their derivatives in all directions."""
    to = ground.to
    y, rows = ground.field.readings(ground.at(path))
    by = np.zeros((to.count, len(y), *path.shape[1:]))
    for k, row in enumerate(rows):
        for i, state in enumerate(to.states):
            if state in row:
                by[:, k] += np.moveaxis(spread[:, :, i, :], 2, 0) * row[state]
        for name, column in to.columns.items():
            if name in row:
                by[column, k] += row[name] * ground.own[column]
    return np.stack(y), by
