r"""Jumps of the state inside a step: where an event expression crosses zero, states are reset.

A step in which one crosses is taken again in parts: up to the crossing, which is located along
the step, the reset, and the rest. Derivatives go through a jump by the saltation matrix: with g the
event expression, r the reset, f^- and f^+ the rates before and after,

.. math:: d\tau = -\frac{g_x dx + g_p dp}{\dot g}, \quad
    dx^+ = r_x (dx + f^- d\tau) + r_p dp + (r_t - f^+) d\tau.

References
----------
Leine & Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (2004), section 7.3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.expressions import Term, evaluate
from jaxsr.expressions.slopes import evaluate_with_slopes
from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Field, Point
from jaxsr.models.model import Event, Model
from jaxsr.models.parts import Part
from jaxsr.models.steps import METHODS
from jaxsr.models.transitions import Taken, transition

Array = Any
MOST_JUMPS = 16
RESTING = 0.02
"""Jumps within a step, and share of it between two jumps at which the state has come to rest: it
then waits for the next step."""
GRID, SECANTS, POLISHED = 8, 5, 2
"""Places of a step at which the return of a state that starts at the surface is looked for, secants
along a cubic through the step, and steps of Newton's method along steps of the method itself."""
BAND = 5e-3
"""Distance beyond a surface, in typical distances from it, from which a state that is on its way
further is taken to be at it: states come from sensors that have noise."""
ROUNDING = 1e-6
"""The same in largest distances: a state at rest on a surface is there but for rounding."""
SETTLED = 1e-12
"""Move of a share of a step that changes nothing any more."""
NEAR = 1e-3
"""Share of a step at which it shows whether a state at the surface is on its way through."""


@dataclass(frozen=True, eq=False)
class Jumps:
    """The events of a model, and how near to its surface a state counts as being at it.

    Attributes
    ----------
    whens : tuple of Term
    resets : tuple of mapping
        State to the term of its value after the jump.
    bands : tuple of float
    """

    model: Model
    whens: tuple[Term, ...]
    resets: tuple[Mapping[str, Term], ...]
    bands: tuple[float, ...]

    @staticmethod
    def of(field: Field, along: Point) -> Jumps | None:
        """Return the jumps of a model, None where it has none; typical states lie `along`."""
        model = field.model
        if not model.events:
            return None
        whens = tuple(model.term(e.when) for e in model.events)
        resets = tuple({s: model.term(r) for s, r in e.reset.items()} for e in model.events)
        env = field.environment(along)
        with np.errstate(all="ignore"):
            heights = [np.abs(np.asarray(evaluate(w, env), dtype=float)) for w in whens]
            heights = [h[np.isfinite(h)] if h.ndim else h[None] for h in heights]
        bands = tuple(
            BAND * float(np.std(h)) + ROUNDING * float(h.max(initial=0.0)) for h in heights
        )
        return Jumps(model, whens, resets, bands)

    def crossed(self, field: Field, before: Point, after: Point, length: Array) -> Array:
        """Return, for each event, where it lies between two points; shape (events, ...)."""
        found = []
        for number, event in enumerate(self.model.events):
            a, b = (self._height(field, number, event, at, before) for at in (before, after))
            through = (a > 0.0) & (b <= 0.0)
            if event.direction:
                through = through | ((a <= 0.0) & (a >= -self.bands[number]) & (b < a))
            found.append(through & (length > 0.0))
        return np.stack(found)

    def _height(self, field: Field, number: int, event: Event, at: Point, start: Point) -> Array:
        """Signed distance from the surface: an event happens where it falls through zero."""
        value = self._when(field, number, at)
        if event.direction:
            return -event.direction * value
        return value * np.sign(self._when(field, number, start))

    def _when(self, field: Field, number: int, at: Point) -> Array:
        value = evaluate(self.whens[number], field.environment(at))
        return value + np.zeros(np.shape(at.states[0]))

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
        """Advance by all substeps, with jumps: the arguments and results of `advanced`."""
        walk = _Walk(self, field, to, method, x)
        for number in range(length.shape[1]):
            walk.substep(time, length[:, number], stages(number))
            time = time + length[:, number]
        return walk.x, walk.slopes


class _Walk:
    """States on their way through substeps, with their derivatives."""

    def __init__(
        self, jumps: Jumps, field: Field, to: Directions | None, method: str, x: list[Array]
    ) -> None:
        self.jumps, self.field, self.to, self.method = jumps, field, to, method
        self.x, self.shape = list(x), np.shape(x[0])
        n = len(x)
        self.slopes = np.zeros((n, 0 if to is None else to.count, *self.shape))
        if to is not None:
            for i in range(n):
                self.slopes[i, i] = 1.0

    def substep(self, time: Array, h: Array, stages: Stages) -> None:
        """Advance by one substep: from jump to jump, and on to its end."""
        done = np.zeros(self.shape)
        for count in range(MOST_JUMPS):
            part = Part(stages, time, h, done, np.ones(self.shape))
            ends, rows = self._stepped(part)
            before, after = part.at(self.x, 0.0), part.at(ends, 1.0)
            hits = self.jumps.crossed(self.field, before, after, part.length)
            shares = np.stack([self._share(k, part, ends, hit) for k, hit in enumerate(hits)])
            first = np.argmin(shares, axis=0)
            share = np.min(shares, axis=0)
            jumping = share <= 1.0
            if not jumping.any():
                self._taken(part, ends, rows)
                return
            stop = np.where(jumping, done + share * (1.0 - done), 1.0)
            part = Part(stages, time, h, done, stop)
            self._taken(part, *self._stepped(part))
            for k in range(len(hits)):
                self._jump(k, part, jumping & (first == k))
            resting = jumping & (stop - done < RESTING) & (count > 0)
            done = np.where(resting, 1.0, stop)
            if not (done < 1.0).any():
                return

    def _stepped(self, part: Part) -> tuple[list[Array], list]:
        _, step = METHODS[self.method]
        return step(self.field, self.x, part.begin, part.length, part.stages, self.to is not None)

    def _taken(self, part: Part, ends: list[Array], rows: list) -> None:
        """Make a step that was taken the state, and carry the derivatives along."""
        if self.to is not None:
            tableau, _ = METHODS[self.method]
            taken = [Taken(part.length, rows, part.stages)]
            by = transition(tableau, self.to, taken, (self.shape[0], self.shape[1]))
            n = len(ends)
            moved = np.einsum("ij...,jk...->ik...", by[:, :n], self.slopes)
            moved[:, n:] += by[:, n:]
            self.slopes = moved
        self.x = list(ends)

    def _share(self, number: int, part: Part, ends: list[Array], hit: Array) -> Array:
        """Locate a crossing as a share of a step; above 1 where there is none."""
        if not hit.any():
            return np.full(self.shape, 2.0)
        event, jumps = self.jumps.model.events[number], self.jumps
        start = part.at(self.x, 0.0)
        rates = [self.field.rates(p) for p in (start, part.at(ends, 1.0))]

        def height(share: Array) -> Array:
            return jumps._height(
                self.field,
                number,
                event,
                part.at(self._between(part, ends, rates, share), share),
                start,
            )

        low, high = np.zeros(self.shape), np.ones(self.shape)
        a, b = height(low), height(high)
        if event.direction and (hit & (a <= 0.0)).any():
            low, high = self._from_surface(height, hit, a)
            a, b = height(low), height(high)
        share = high
        with np.errstate(all="ignore"):
            for _ in range(SECANTS):  # regula falsi with halved ends (Illinois)
                before = share
                share = np.nan_to_num(low + (high - low) * a / (a - b))
                share = np.clip(share, np.minimum(low, high), np.maximum(low, high))
                if np.abs(np.where(hit, share - before, 0.0)).max() < SETTLED:
                    break
                c = height(share)
                above = c > 0.0
                b = np.where(above, 0.5 * b, c)
                a = np.where(above, c, 0.5 * a)
                low, high = np.where(above, share, low), np.where(above, high, share)
        return np.where(hit, self._polished(number, part, np.where(high > low, share, high)), 2.0)

    def _from_surface(
        self, height: Callable[[Array], Array], hit: Array, start: Array
    ) -> tuple[Array, Array]:
        """Return where states that start at the surface come back to it: an interval of shares.

        One that is on its way through jumps at once; the interval is then empty.
        """
        low, high = np.zeros(self.shape), np.ones(self.shape)
        first = height(np.full(self.shape, NEAR))
        at = hit & (start <= 0.0)
        low = np.where(at, NEAR, low)
        high = np.where(at & (first <= start), 0.0, high)
        low = np.where(at & (first <= start), 0.0, low)
        open_ = at & (first > start)
        for share in np.linspace(0.0, 1.0, GRID + 1)[1:]:
            below = open_ & (height(np.full(self.shape, share)) <= 0.0)
            high = np.where(below, share, high)
            open_ &= ~below
            low = np.where(open_, share, low)
        return low, high

    def _between(
        self, part: Part, ends: list[Array], rates: list[list[Array]], share: Array
    ) -> list[Array]:
        """States inside a step, on the cubic through its ends and their rates (Hermite)."""
        s, h = share, part.length
        a, b = (1 + 2 * s) * (1 - s) ** 2, s**2 * (3 - 2 * s)
        c, d = h * s * (1 - s) ** 2, h * s**2 * (s - 1)
        return [
            a * x0 + b * x1 + c * f0 + d * f1
            for x0, x1, f0, f1 in zip(self.x, ends, *rates, strict=True)
        ]

    def _polished(self, number: int, part: Part, share: Array) -> Array:
        """Put a crossing on the steps that the method takes, by Newton's method."""
        for _ in range(POLISHED):
            piece = part.upto(share)
            _, step = METHODS[self.method]
            x, _ = step(self.field, self.x, piece.begin, piece.length, piece.stages, False)
            at = piece.at(x, 1.0)
            value = self.jumps._when(self.field, number, at)
            rate = part.length * self._rate(number, part, at, self._slopes_of(number, at))
            with np.errstate(all="ignore"):
                change = np.nan_to_num(value / rate, posinf=0.0, neginf=0.0)
            near = np.abs(change) < 0.1
            moved = np.where(near & (share > 0.0), np.clip(share - change, 0.0, 1.0), share)
            far, share = np.abs(moved - share).max(), moved
            if far < SETTLED:
                break
        return share

    def _slopes_of(self, number: int, at: Point) -> dict[str, Array]:
        model = self.jumps.model
        by = self.field.by | {model.time, *model.inputs}
        env = self.field.environment(at)
        return evaluate_with_slopes(self.jumps.whens[number], env, by)[1]

    def _rate(self, number: int, part: Part, at: Point, slopes: dict[str, Array]) -> Array:
        """Total derivative of an event expression by time."""
        model = self.jumps.model
        total = slopes.get(model.time, 0.0) + np.zeros(self.shape)
        for state, rate in zip(model.states, self.field.rates(at), strict=True):
            total = total + slopes.get(state, 0.0) * rate
        for name, rate in zip(model.inputs, part.input_rates, strict=True):
            total = total + slopes.get(name, 0.0) * rate
        return total

    def _jump(self, number: int, part: Part, chosen: Array) -> None:
        """Reset the chosen states, and take their derivatives through the jump."""
        if not chosen.any():
            return
        model, jumps = self.jumps.model, self.jumps
        at = part.at(self.x, 1.0)
        env, by = self.field.environment(at), self.field.by | {model.time}
        shared: dict[Term, Any] = {}
        found = {
            s: evaluate_with_slopes(r, env, by, shared) for s, r in jumps.resets[number].items()
        }
        after = [
            np.where(chosen, found[s][0], a) if s in found else a
            for s, a in zip(model.states, self.x, strict=True)
        ]
        if self.to is not None:
            new = self._saltation(number, part, at, after, {s: v for s, (_, v) in found.items()})
            self.slopes = np.where(chosen, new, self.slopes)
        self.x = after

    def _saltation(
        self,
        number: int,
        part: Part,
        at: Point,
        after: list[Array],
        resets: Mapping[str, Mapping[str, Array]],
    ) -> Array:
        """Derivatives of the states after a jump."""
        assert self.to is not None
        model, to, slopes = self.jumps.model, self.to, self.slopes
        when = self._slopes_of(number, at)
        rate = self._rate(number, part, at, when)
        before, then = self.field.rates(at), self.field.rates(part.at(after, 1.0))
        by = sum(np.asarray(when.get(s, 0.0)) * slopes[i] for i, s in enumerate(model.states))
        by = np.array(by + np.zeros_like(slopes[0]))
        for name, column in to.columns.items():
            if name in when:
                by[column] += when[name]
        with np.errstate(all="ignore"):
            shift = -np.nan_to_num(by / rate, posinf=0.0, neginf=0.0)
        total = slopes + np.stack(before)[:, None] * shift
        result = np.empty_like(slopes)
        for i, state in enumerate(model.states):
            if state not in resets:
                result[i] = total[i]
            else:
                own = resets[state]
                result[i] = np.asarray(own.get(model.time, 0.0)) * shift
                for j, other in enumerate(model.states):
                    if other in own:
                        result[i] += own[other] * total[j]
                for name, column in to.columns.items():
                    if name in own:
                        result[i, column] += own[name]
            result[i] -= then[i] * shift
        return result
