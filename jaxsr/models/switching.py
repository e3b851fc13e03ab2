r"""Laws that jump, switched exactly inside a step: dry friction that slips, crosses or sticks.

``sign(g)`` with g affine in the states is a mode of the motion: 1 or -1 on either side of the
surface g = 0, and on it, where the rates of both sides lead back to it, the value between them that
keeps the state there (Filippov's sliding). A step is taken in parts, from one change of mode to the
next; each change is located along the step. With f^- and f^+ the rates before and after, G the
slope of g, and b the derivative of the rates by the value of the sign,

.. math:: d\tau = -\frac{G dx}{G f^-}, \quad dx^+ = dx^- + (f^- - f^+) d\tau, \qquad
    \sigma = \sigma_0 - \frac{G f(\sigma_0)}{G b}

are the derivatives through a change and the value on the surface. Letting go is continuous.

References
----------
Filippov, Differential Equations with Discontinuous Righthand Sides (1988), section 4; Leine and
Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (2004), section 7.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions import Term, evaluate
from jaxsr.expressions.affine import affine_slope
from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field, Point
from jaxsr.models.following import followed
from jaxsr.models.parts import Part
from jaxsr.models.simulator import Simulator
from jaxsr.models.sliding import Sliding, slid

Array = Any
CHANGES = 3
"""Changes of a switch within a substep: it arrives, lets go and comes back. More are steps that
cannot tell the side (a drag whose slope is infinite at rest): the rest is taken in the last mode.
"""
LOCATED, SETTLED = 20, 1e-10
"""Iterations that locate a change, and the share of a substep up to which they do."""
RESTING, BESIDE = 1e-9, 1e-3
"""Distance from a surface, in typical ones, within which a state is on it: rounding; and how far,
in that, it is put beside it."""


def switchable(simulator: Simulator) -> tuple[int, ...]:
    """Return which of the smoothed arguments can be switched exactly: affine in states alone.

    A reading that jumps shows the jump itself, at a sample; that stays rounded.
    """
    model, states = simulator.model, set(simulator.model.states)
    if simulator.function is not None or model.events:
        return ()
    read = {n for term in model.reading_terms.values() for n in term.distinct()}
    found = []
    for number, argument in enumerate(simulator.smoothed_arguments):
        shown = any(n.args and n.args[0] == argument for n in read)
        if (
            argument.variables <= states
            and not shown
            and _slope(model.states, argument) is not None
        ):
            found.append(number)
    return tuple(found)


def _slope(states: Sequence[str], argument: Term) -> list[float] | None:
    """Derivatives of an argument by the states, where they are numbers."""
    slopes = [affine_slope(argument, s) for s in states]
    if any(slope is None or not slope.is_constant for slope in slopes):
        return None
    return [slope.value for slope in slopes if slope is not None]


@dataclass(frozen=True, eq=False)
class Switches:
    """Surfaces on which laws jump; asked as `Jumps` are, by `advanced`.

    Attributes
    ----------
    field : Field
        In which the signs are constants, `names`.
    names : tuple of str
    slope : ndarray, shape (switches, states)
        G; a surface is where G x + offset is zero.
    offset, rest : ndarray, shape (switches,)
        `rest` is how near to a surface a state is on it.
    """

    field: Field
    names: tuple[str, ...]
    slope: np.ndarray
    offset: np.ndarray
    rest: np.ndarray

    @staticmethod
    def of(field: Field, typical: Array) -> Switches:
        """Return the switches of a field in which some widths are 0.

        Parameters
        ----------
        typical : ndarray, shape (states, samples, segments)
            Where the states are.
        """
        model = field.model
        arguments = [field.simulator.smoothed_arguments[i] for i in field.switched]
        nowhere = dict.fromkeys(model.states, 0.0)
        slope = np.array([_slope(model.states, a) for a in arguments], dtype=float)
        offset = np.array([float(evaluate(a, nowhere)) for a in arguments])
        rms = np.sqrt(np.mean(_heights(slope, offset, typical) ** 2, axis=(1, 2)))
        return Switches(field, field.signs, slope, offset, RESTING * rms)

    def heights(self, x: Array) -> Array:
        """Distances G x + offset of states, shape (switches, ...)."""
        return _heights(self.slope, self.offset, x)

    def begun(self, path: Array) -> tuple[Field, Crossings]:
        """Return the field in the modes of a path's samples, and what becomes of these modes."""
        start = self.heights(path)
        modes = np.where(start < 0.0, -1.0, 1.0)
        resting = (np.abs(start) <= self.rest.reshape(-1, 1, 1)).any(axis=0)
        return self.field.valued(dict(zip(self.names, modes, strict=True))), Crossings(
            self, modes, resting
        )


def _heights(slope: Array, offset: Array, x: Array) -> Array:
    apart = offset.reshape(-1, *([1] * (np.ndim(x) - 1)))
    return np.tensordot(slope, np.asarray(x), axes=1) + apart


@dataclass(frozen=True, eq=False)
class Crossings:
    """Samples in some modes, and which of them leave these before the next one."""

    switches: Switches
    modes: np.ndarray
    resting: np.ndarray

    def crossed(self, field: Field, before: Point, after: Point, length: Array) -> Array:
        """Return where a mode ends between two points, shape (1, ...)."""
        del field, before
        over = self.modes * self.switches.heights(np.stack(after.states)) < 0.0
        return ((over.any(axis=0) | self.resting) & (length > 0.0))[None]

    def through(
        self,
        field: Field,
        to: Directions | None,
        method: str,
        x: list[Array],
        time: Array,
        length: Array,
        stages: Callable[[int], Stages],
    ) -> tuple[list[Array], Array]:
        """Advance by all substeps, from mode to mode: as `Jumps.through`."""
        first = stages(0)
        walk = _Walk(self.switches, field, to, method, x, Point(time, x, first.at(0.0)))
        for number in range(length.shape[1]):
            walk.substep(time, length[:, number], stages(number))
            time = time + length[:, number]
        return list(walk.x), walk.slopes


class _Walk:
    """States on their way from mode to mode, one below the other: shape (samples, 1)."""

    def __init__(
        self,
        switches: Switches,
        field: Field,
        to: Directions | None,
        method: str,
        x: list[Array],
        start: Point,
    ) -> None:
        self.switches, self.field, self.to, self.method = switches, field, to, method
        self.model, self.x, self.shape = field.model, np.stack(x), np.shape(x[0])
        n, height = len(x), switches.heights(np.stack(x))
        self.signs = np.where(height < 0.0, -1.0, 1.0)
        self.stuck = np.zeros(height.shape, dtype=bool)
        self.fresh = np.zeros(height.shape, dtype=bool)  # has just left its surface
        self.slopes = np.zeros((n, 0 if to is None else to.count, *self.shape))
        if to is not None:
            self.slopes[range(n), range(n)] = 1.0
        for k in range(len(height)):
            self._settle(k, start, np.abs(height[k]) <= switches.rest[k], arriving=False)

    def motion(self, at: Point) -> tuple[Array, Array, Array]:
        """Return rates, their derivatives by the signs, and these with those that stick."""
        return self._sliding(self.field, self.signs, self.stuck).motion(at)

    def substep(self, time: Array, h: Array, stages: Stages) -> None:
        """Advance by one substep: from change to change, and on to its end."""
        done = np.zeros(self.shape)
        for _ in range(CHANGES * len(self.signs)):
            part = Part(stages, time, h, done, np.ones(self.shape))
            ends, by = self._stepped(part)
            over = (self._held(part, ends, 1.0) < 0.0).any(axis=0) & (part.length > 0.0)
            if not over.any():
                self._taken(ends, by)
                return
            share = self._located(part, over, ends)
            stop = np.where(over, done + share * (1.0 - done), 1.0)
            part = Part(stages, time, h, done, stop)
            self._taken(*self._stepped(part))
            at = part.at(list(self.x), 1.0)
            which = np.argmin(self._held(part, list(self.x), 1.0), axis=0)
            for k in range(len(self.signs)):
                self._change(k, at, over & (which == k))
            done = np.where(1.0 - stop < SETTLED, 1.0, stop)
            if not (done < 1.0).any():
                return
        part = Part(stages, time, h, done, np.ones(self.shape))
        self._taken(*self._stepped(part))

    def _sliding(self, field: Field, signs: Array, stuck: Array) -> Sliding:
        return Sliding(self.switches.names, self.switches.slope, field, signs, stuck)

    def _stepped(self, part: Part, slopes: bool = True) -> tuple[Array, Array]:
        """Return states after a step in these modes, and their derivatives by those before it."""
        to = self.to if slopes else None
        sticking = self.stuck.any(axis=0)
        ends = np.empty_like(self.x)
        by = np.empty((len(self.x), 0 if to is None else to.count, *self.shape))
        for slides, chosen in ((False, ~sticking), (True, sticking)):
            if not chosen.any():
                continue
            begun = [a[chosen][:, None] for a in self.x]
            signs, stuck = self.signs[:, chosen][..., None], self.stuck[:, chosen][..., None]
            field = self._sliding(self.field.column(chosen), signs, stuck)
            span = part.column(chosen)
            if slides:
                along, own = slid(field, to, self.method, begun, [span])
            else:
                along, own = followed(field.signed, to, self.method, begun, [span])
            ends[:, chosen], by[:, :, chosen] = np.stack(along[-1])[..., 0], own[..., 0]
        return ends, by

    def _taken(self, ends: Array, by: Array) -> None:
        """Make a step that was taken the state, and carry the derivatives along."""
        if self.to is not None:
            n = len(ends)
            moved = np.einsum("ij...,jk...->ik...", by[:, :n], self.slopes)
            moved[:, n:] += by[:, n:]
            self.slopes = moved
        self.x = ends

    def _held(self, part: Part, x: Sequence[Array], share: Array | float) -> Array:
        """How far each mode is from its end, shape (switches, samples, 1): below 0 it is over.

        Distances are in typical ones, divided by the share of the step where the
        state has just left the surface: the end that it began with is none.
        """
        typical = self.switches.rest[:, None, None] / RESTING + 1e-300
        height = self.switches.heights(np.stack(x)) / typical
        height = self.signs * height
        with np.errstate(all="ignore"):
            height = np.where(self.fresh, height / np.maximum(share, 1e-6), height)
        if not self.stuck.any():
            return height
        value = self.motion(part.at(x, share))[2]
        return np.where(self.stuck, 1.0 - np.abs(value), height)

    def _located(self, part: Part, over: Array, ends: Array) -> Array:
        """Return the share of a step at which the first mode ends (Illinois method)."""

        def left(share: Array) -> Array:
            x, _ = self._stepped(part.upto(share), slopes=False)
            return self._held(part, x, share).min(axis=0)

        low, high = np.zeros(self.shape), np.ones(self.shape)
        b = self._held(part, ends, 1.0).min(axis=0)
        # Of one that has just left its surface the distance at the start says nothing.
        a = np.maximum(self._held(part, list(self.x), 0.0), 0.0)
        a = np.where(self.fresh, np.inf, a).min(axis=0)
        a = np.where(np.isfinite(a), a, np.abs(b))
        share, side = high, np.zeros(self.shape, dtype=bool)
        for _ in range(LOCATED):
            before = share
            with np.errstate(all="ignore"):
                share = np.nan_to_num(low + (high - low) * a / (a - b), nan=0.5)
            share = np.clip(share, low, high)
            if np.where(over, np.abs(share - before), 0.0).max() < SETTLED:
                break
            c = left(share)
            above = c > 0.0
            again = np.where(above == side, 0.5, 1.0)  # an end that stays twice counts half
            b, a = np.where(above, again * b, c), np.where(above, c, again * a)
            side = above
            low, high = np.where(above, share, low), np.where(above, high, share)
        return np.where(over, share, 1.0)

    def _change(self, number: int, at: Point, chosen: Array) -> None:
        """End the mode of one switch: let go, or arrive at the surface."""
        if not chosen.any():
            return
        letting = chosen & self.stuck[number]
        if letting.any():
            value = self.motion(at)[2][number]
            self.signs[number] = np.where(letting, np.sign(value), self.signs[number])
            self.stuck[number] &= ~letting
            self.fresh[number] |= letting
            self._put_on(number, letting, self.signs[number])
        self._settle(number, at, chosen & ~letting)

    def _put_on(self, number: int, chosen: Array, side: Array) -> None:
        """Put states on a surface that they are on but for rounding.

        They lie beside it by far less than that: on it, other laws may have no slope.
        """
        slope = self.switches.slope[number][:, None, None]
        apart = self.switches.heights(self.x)[number] - side * BESIDE * self.switches.rest[number]
        self.x = np.where(chosen, self.x - slope * apart / np.sum(slope**2), self.x)

    def _settle(self, number: int, at: Point, chosen: Array, arriving: bool = True) -> None:
        """Choose the mode of states that are on a surface: to either side, or along it.

        Derivatives change where a state has arrived there, or stays.
        """
        if not chosen.any():
            return
        slope = self.switches.slope[number]
        self._put_on(number, chosen, self.signs[number])
        f, by, _ = self.motion(Point(at.time, list(self.x), at.inputs))
        by = by[:, number]
        rate, own = np.tensordot(slope, f, axes=1), np.tensordot(slope, by, axes=1)
        sign = self.signs[number].copy()
        up, down = rate + (1.0 - sign) * own, rate - (1.0 + sign) * own
        with np.errstate(all="ignore"):
            value = np.nan_to_num(sign - rate / own)
        sticks = chosen & (up < 0.0) & (down > 0.0)
        aside = np.where(up > 0.0, 1.0, np.where(down < 0.0, -1.0, sign))
        after = np.where(sticks, np.clip(value, -1.0, 1.0), aside)
        if self.to is not None:
            past = np.einsum("n,nd...->d...", slope, self.slopes)
            with np.errstate(all="ignore"):
                late = np.where(rate != 0.0, -past / rate, 0.0)  # d tau
            change = (sign - after) * by
            moved = self.slopes + change[:, None] * late[None]
            self.slopes = np.where(chosen & (sticks | arriving), moved, self.slopes)
        self.stuck[number] |= sticks
        self.signs[number] = np.where(chosen, after, sign)
        self.fresh[number] = np.where(chosen, ~sticks, self.fresh[number])
        self._put_on(number, chosen, np.where(sticks, sign, after))
