"""Formulas, inputs and jumps of segments: what does not change along a path."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
CLOSE, CLOSE_WINDOW = 1e-9, 1e-12
"""Step of a path, in sizes of the states, at which it is a simulation, and at which a part is."""
LEAST_WINDOW, MOST_WINDOW, CLOSING_WINDOW = 8, 128, 6
"""Samples that are closed at once, and Newton iterations for them, where all are too many."""


@dataclass(frozen=True, eq=False)
class Ground:
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
    ) -> Ground:
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
        return Ground(stepping, segments, values, field, to, stages, *bends, own)

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

    def jumped(self, path: Array) -> Array:
        """Return in which steps from a path an event happens, shape (samples - 1, segments)."""
        if self.jumps is None:
            return np.zeros((path.shape[1] - 1, path.shape[2]), bool)
        here = self.step(path, tangents=False)[0]
        return (here != replace(self, jumps=None).step(path, tangents=False)[0]).any(0)

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
