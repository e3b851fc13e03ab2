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

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr._deadline import ask
from jaxsr.models.alone import alone
from jaxsr.models.corners import Corners
from jaxsr.models.delays import delayed_stages, stage_of
from jaxsr.models.directions import Directions
from jaxsr.models.field import Field, Point
from jaxsr.models.jumps import Jumps
from jaxsr.models.late import late_readings
from jaxsr.models.rollout import Stepping
from jaxsr.models.segments import Segments, values_over
from jaxsr.models.sensitivity import advanced, condensed
from jaxsr.models.simulator import Simulator
from jaxsr.models.switching import Switches

Array = Any
CLOSING, CLOSING_LONG, SHORT = 8, 20, 60
"""Newton iterations to a simulation, for segments of up to `SHORT` samples and for longer ones,
which are dear to simulate from sample to sample."""
CLOSE, CLOSE_WINDOW = 1e-9, 1e-12
"""Step of a path, in sizes of the states, at which it is a simulation, and at which a part is."""
LEAST_WINDOW, MOST_WINDOW, CLOSING_WINDOW = 8, 128, 6
"""Samples that are closed at once, and Newton iterations for them, where all are too many."""


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
    ground = _Ground.of(simulator, stepping, segments, theta, active)
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
    return _Ground.of(simulator, stepping, segments, theta, active).step(path, tangents=tangents)


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
    return _Ground.of(simulator, stepping, segments, theta, active).read(path, late, live)


def one_step_and_readings(
    simulator: Simulator,
    stepping: Stepping,
    segments: Segments,
    theta: Array,
    path: Array,
    active: Sequence[int],
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return what `one_step` and `readings_along` do of a path; sensors may be live before it."""
    ground = _Ground.of(simulator, stepping, segments, theta, active)
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
    ground = _Ground.of(simulator, stepping, segments, theta, ())
    y = np.stack(ground.field.readings(ground.at(path))[0])
    read = y, np.zeros((0, *y.shape))
    return late_readings(simulator, segments, ground.values, ground.to, read)[0]


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
    ground = _Ground.of(simulator, stepping, segments, theta, ())
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


@dataclass(frozen=True, eq=False)
class _Ground:
    """Formulas, inputs and directions: what does not change along a path."""

    stepping: Stepping
    segments: Segments
    values: list[Array]
    field: Field
    to: Directions
    stages: tuple[Array, dict[int, Array]]
    jumps: Jumps | None
    switches: Switches | None
    corners: Corners | None
    own: Array  # 0 where a recording has a value of its own

    @staticmethod
    def of(
        simulator: Simulator,
        stepping: Stepping,
        segments: Segments,
        theta: Array,
        active: Sequence[int] | np.ndarray,
    ) -> _Ground:
        model = simulator.model
        names = list(model.parameters)
        chosen = [names[i] for i in active]
        values = values_over(theta, segments.override)
        late = [u for u in model.inputs if model.delays.get(u) in chosen]
        field = Field(simulator, values, stepping.widths, chosen, late)
        to = _directions(simulator, chosen, late)
        own = np.ones((to.count, segments.number))
        own[len(model.states) :] = np.isnan(segments.override[list(active)])
        stages = delayed_stages(model, segments, values, chosen)
        jumps = Jumps.of(field, Point(segments.time, list(segments.course), list(segments.inputs)))
        switches = Switches.of(field, segments.course) if field.switched else None
        cut = stepping.widths, stepping.parts, stepping.staying
        corners = Corners.of(field, *cut)
        bends = jumps, switches, corners
        return _Ground(stepping, segments, values, field, to, stages, *bends, own)

    def step(self, path: Array, first: int = 0, tangents: bool = True) -> tuple[Array, Array]:
        """Integrate from every sample to the next, with derivatives in all directions.

        The path begins at sample `first` of the segments.
        """
        ask()
        here = slice(first, first + path.shape[1] - 1)
        inputs, rates = self.stages
        stages = inputs[:, :, here], {i: rate[:, here] for i, rate in rates.items()}
        field, jumps = self.field, self.jumps or self.corners
        if self.switches is not None:
            field, jumps = self.switches.begun(path[:, :-1])
        ends, slopes = advanced(
            field,
            self.to if tangents else None,
            self.stepping.method,
            list(path[:, :-1]),
            self.segments.time[here],
            self.segments.length[here],
            functools.partial(stage_of, *stages),
            jumps,
        )
        return np.stack(ends), slopes

    def read(self, path: Array, late: bool, live: bool = False) -> tuple[Array, Array]:
        """Return readings of a path and their derivatives in all directions."""
        values, rows = self.field.readings(self.at(path))
        y, none, place = np.stack(values), np.zeros(path.shape[1:]), self.to.columns
        names = [*self.to.states, *sorted(place, key=lambda name: place[name])]
        by = np.array([[row.get(name, 0.0) + none for row in rows] for name in names])
        if late:
            own = self.field.simulator, self.segments, self.values, self.to
            y, by = late_readings(*own, (y, by), live)
        return y, by.swapaxes(0, 1)

    def newton(
        self, path: Array, iterations: int, stop: Callable[[], bool], first: int = 0
    ) -> tuple[int, Array]:
        """Move a path towards the simulation; return up to which sample it is one, and the path."""
        done, last = 0, path.shape[1] - 1
        usual = np.abs(self.segments.course).max((1, 2))[:, None] + 1e-300
        close = CLOSE if last == self.segments.time.shape[0] - 1 else CLOSE_WINDOW
        for _ in range(iterations):
            if stop():
                break
            ends, slopes = self.step(path, first)
            _, shift = condensed(slopes, ends - path[:, 1:])
            moved = path + shift
            # Beyond a corner a path may be anywhere: sizes are those up to a sample.
            size = np.maximum.accumulate(np.maximum(np.abs(moved).max(2), usual), axis=1)
            far = (np.abs(shift).max(2) / size).max(0)
            if not np.isfinite(far).all():
                break
            path, apart = moved, np.flatnonzero(far >= close)
            done = int(apart[0]) - 1 if apart.size else last
            if done == last:
                break
        return done, path

    def by_windows(self, path: Array, first: int, stop: Callable[[], bool]) -> Array | None:
        """Simulate from sample `first` on: what Newton's method closes at once, else one by one."""
        path, last, window = path.copy(), path.shape[1] - 1, MOST_WINDOW
        while first < last:
            end = min(first + window, last)
            done, found = self.newton(path[:, first : end + 1], CLOSING_WINDOW, stop, first)
            path[:, first : first + done + 1] = found[:, : done + 1]
            first += done
            whole = first == end
            window = min(2 * window, MOST_WINDOW) if whole else max(window // 2, LEAST_WINDOW)
            if whole:
                continue
            end = min(first + LEAST_WINDOW, last)
            part = self.forward(path[:, first : end + 1], stop, first)
            if part is None:
                return None
            path[:, first : end + 1], first = part, end
        return path

    def forward(self, path: Array, stop: Callable[[], bool], first: int = 0) -> Array | None:
        """Simulate from the start of a path, one sample after the other; None if it diverges."""
        path = path.copy()
        own = any(np.ndim(value) for value in self.values)
        smooth = self.jumps is None and self.switches is None
        plain = smooth and self.stepping.method == "rk4" and not own
        if path.shape[2] == 1 and plain:
            return alone(self.field, self.segments, self.stages[0], path, stop, first)
        for k in range(path.shape[1] - 1):
            path[:, k + 1] = self.step(path[:, k : k + 2], first + k, tangents=False)[0][:, 0]
            if stop() or not np.isfinite(path[:, k + 1]).all():
                return None
        return path

    def at(self, path: Array) -> Point:
        """A path with its times and inputs."""
        return Point(self.segments.time, list(path), list(self.segments.inputs))


def _directions(simulator: Simulator, active: Sequence[str], late: Sequence[str]) -> Directions:
    model = simulator.model
    columns = {name: len(model.states) + k for k, name in enumerate(active)}
    delays = {model.inputs.index(u): columns[str(model.delays[u])] for u in late}
    return Directions(tuple(model.states), columns, delays, tuple(model.inputs))


def _read(ground: _Ground, path: Array, spread: Array) -> tuple[Array, Array]:
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
