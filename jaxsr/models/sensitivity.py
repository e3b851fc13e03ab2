"""Steps of an ordinary differential equation with their sensitivities, all samples at once.

The steps between neighbouring samples start from known states, so none waits for another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr.models.field import Field, Point, Row, implicit
from jaxsr.models.stepping import factorised

Array = Any


@dataclass(frozen=True, eq=False)
class Stages:
    """Inputs along a step: at its start, middle and end, and their derivatives by their delays.

    Attributes
    ----------
    values : ndarray, shape (3, inputs, ...)
    rates : mapping
        Position of an input to d(values)/d(delay), shape (3, ...).
    """

    values: Array
    rates: Mapping[int, Array]

    def at(self, share: float) -> list[Array]:
        """Inputs at a share of the step, by the parabola through the three."""
        return list(_parabola(self.values, share))

    def rate(self, number: int, share: float) -> Array:
        """Derivative of an input by its delay."""
        return _parabola(self.rates[number], share)


def _parabola(values: Array, share: float) -> Array:
    if share == 0.0:
        return values[0]
    if share == 1.0:
        return values[2]
    if share == 0.5:
        return values[1]
    a, b, c = (1 - share) * (1 - 2 * share), 4 * share * (1 - share), share * (2 * share - 1)
    return a * values[0] + b * values[1] + c * values[2]


@dataclass(frozen=True, eq=False)
class Directions:
    """What states are differentiated by: every state at the start, then parameters.

    Attributes
    ----------
    states : tuple of str
    columns : mapping
        Parameter to its direction.
    delays : mapping
        Position of an input to the direction of its delay.
    inputs : tuple of str
    """

    states: tuple[str, ...]
    columns: Mapping[str, int]
    delays: Mapping[int, int]
    inputs: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of directions."""
        return len(self.states) + len({*self.columns.values(), *self.delays.values()})

    def along(self, rows: Sequence[Row], tangents: Array, stages: Stages, share: float) -> Array:
        """Derivatives of rates with the given Jacobian `rows` in all directions.

        `tangents`, (states, directions, ...), are those of the states; so is the result.
        """
        result = np.zeros_like(tangents)
        spare = np.empty_like(tangents[0])
        for total, row in zip(result, rows, strict=True):
            for state, tangent in zip(self.states, tangents, strict=True):
                if state in row:
                    total += np.multiply(row[state], tangent, out=spare)
            for name, k in self.columns.items():
                if name in row:
                    total[k] += row[name]
            for number, k in self.delays.items():
                if self.inputs[number] in row:
                    total[k] += row[self.inputs[number]] * stages.rate(number, share)
        return result


State = tuple[list[Array], Array]
"""States, an array each, and their derivatives in all directions, (states, directions, ...)."""


def _moved(start: Sequence[Array], *pairs: tuple[Any, Sequence[Array]]) -> list[Array]:
    result = list(start)
    for scale, other in pairs:
        result = [a + scale * b for a, b in zip(result, other, strict=True)]
    return result


def rk4(
    field: Field, to: Directions | None, state: State, time: Array, h: Array, stages: Stages
) -> State:
    """Advance states and sensitivities by the classical Runge-Kutta method of order four."""
    x, dx = state

    def slope(share: float, own: list[Array], tangents: Array) -> State:
        here = Point(time + share * h, own, stages.at(share))
        if to is None:
            return field.rates(here), np.zeros_like(tangents)
        rates, rows = field.slopes(here)
        return rates, to.along(rows, tangents, stages, share)

    k1, d1 = slope(0.0, x, dx)
    k2, d2 = slope(0.5, _moved(x, (h / 2, k1)), _added(h / 2, d1, dx))
    k3, d3 = slope(0.5, _moved(x, (h / 2, k2)), _added(h / 2, d2, dx))
    k4, d4 = slope(1.0, _moved(x, (h, k3)), _added(h, d3, dx))
    sixth, third = h / 6, h / 3
    d2 += d3
    d2 *= 2.0
    d2 += d1
    d2 += d4
    return (
        _moved(x, (sixth, k1), (third, k2), (third, k3), (sixth, k4)),
        _added(sixth, d2, dx),
    )


def _added(scale: Array, slope: Array, start: Array) -> Array:
    """Return start + scale * slope."""
    result = scale * slope
    result += start
    return result


_G = 0.43586652150845899942
_B = (-(6 * _G**2 - 16 * _G + 1) / 4, (6 * _G**2 - 20 * _G + 5) / 4)
_STAGES = ((), ((1 - _G) / 2,), _B)
_SHARES = (_G, (1 + _G) / 2, 1.0)
_NEWTON, _HARD = 4, 60
_SETTLED = 1e-9
"""Last step of a rate, in sizes of the rates, that ends the iteration."""


def sdirk3(
    field: Field, to: Directions | None, state: State, time: Array, h: Array, stages: Stages
) -> State:
    """Advance by the L-stable singly diagonally implicit method of order three.

    References
    ----------
    Alexander, SIAM J. Numer. Anal. 14 (1977), Theorem 5.
    """
    x, dx = state
    rates: list[list[Array]] = []
    slopes: list[Array] = []
    for weights, share in zip(_STAGES, _SHARES, strict=True):
        pairs = [(h * w, k) for w, k in zip(weights, rates, strict=True)]
        base = _moved(x, *pairs)
        tangents = dx
        for w, d in zip(weights, slopes, strict=True):
            tangents = _added(h * w, d, tangents)

        def at(k: list[Array], base: list[Array] = base, share: float = share) -> Point:
            return Point(time + share * h, _moved(base, (h * _G, k)), stages.at(share))

        names = field.model.states
        k, rows = _stage(field, names, at, h, rates[-1] if rates else None)
        rates.append(k)
        if to is not None:
            solve = factorised(implicit(rows, names, h * _G))
            tangents = np.stack(solve(tuple(to.along(rows, tangents, stages, share))))
        slopes.append(tangents)
    weights = (*_B, _G)
    tangents = dx
    for w, d in zip(weights, slopes, strict=True):
        tangents = _added(h * w, d, tangents)
    return (
        _moved(x, *((h * w, k) for w, k in zip(weights, rates, strict=True))),
        tangents,
    )


def _stage(
    field: Field,
    states: Sequence[str],
    at: Callable[[list[Array]], Point],
    h: Array,
    guess: list[Array] | None,
) -> tuple[list[Array], Sequence[Row]]:
    """Solve k = f(base + h g k) by Newton's method, first everywhere, then where it is hard."""
    k = field.rates(at([0.0 * h] * len(states))) if guess is None else guess
    k, hard, rows = _newton(field, at, h, k, _NEWTON)
    if not hard.any():
        return k, rows
    here = at(k)
    shape = hard.shape

    def picked(values: Sequence[Array]) -> list[Array]:
        return [np.broadcast_to(v, shape)[hard] for v in values]

    step, own = np.broadcast_to(h, shape)[hard], picked(k)
    time, inputs = picked([here.time])[0], picked(here.inputs)
    base = [x - step * _G * rate for x, rate in zip(picked(here.states), own, strict=True)]
    found, *_ = _newton(
        field.picked(hard).by_states(),
        lambda rates: Point(time, _moved(base, (step * _G, rates)), inputs),
        step,
        own,
        _HARD,
    )
    for all_, part in zip(k, found, strict=True):
        all_[hard] = part
    return k, field.slopes(at(k))[1]


def _newton(
    field: Field,
    at: Callable[[list[Array]], Point],
    h: Array,
    k: list[Array],
    iterations: int,
) -> tuple[list[Array], Array, Sequence[Row]]:
    """Iterate k = f(base + h g k), the step halved where it overshoots a corner.

    Returns
    -------
    k : list of ndarray
    hard : ndarray of bool
        Where the iteration has not settled.
    rows
        Jacobian of f at the last point but one.
    """
    size, share = np.inf, 1.0
    step: list[Array] = []
    for _ in range(iterations):
        left, newton, rows = field.newton(at(k), k, h * _G)
        now = sum(np.abs(a) for a in left)
        worse = (now > size) & (share > 1e-6)
        if step and np.any(worse):
            # Back half the way where the last step made things worse.
            share = np.where(worse, 0.5 * share, 1.0)
            step = [np.where(worse, s, n) for s, n in zip(step, newton, strict=True)]
            moves = [np.where(worse, -share * s, s) for s in step]
        else:
            share, step = np.ones(np.shape(now)), list(newton)
            moves = step
        size = np.where(worse, size, now)
        k = [own + s for own, s in zip(k, moves, strict=True)]
        hard = np.zeros(np.shape(now), dtype=bool)
        for own, s in zip(k, moves, strict=True):
            reach = float(np.nanmax(np.abs(own), initial=0.0)) + 1e-300
            hard |= np.abs(s) > _SETTLED * reach
        if not hard.any():
            break
    return k, hard, rows


METHODS: dict[str, Callable[..., State]] = {"rk4": rk4, "rodas3": sdirk3}
"""By the names of `stepping.METHODS`: where that takes a stiff method, this takes its own."""


def advanced(
    field: Field,
    to: Directions | None,
    method: str,
    x: Sequence[Array],
    time: Array,
    length: Array,
    stages: Callable[[int], Stages],
) -> State:
    """Advance by all substeps between neighbouring samples.

    Parameters
    ----------
    to : Directions or None
        None: states alone, with derivatives in no direction.
    x : sequence of ndarray
        States at the earlier samples.
    time : ndarray
    length : ndarray, shape (..., substeps, ...)
        On axis 1.
    stages : callable
        Number of a substep to its inputs.
    """
    n, shape = len(x), np.shape(x[0])
    tangents = np.zeros((n, 0 if to is None else to.count, *shape))
    for i in range(n if to is not None else 0):
        tangents[i, i] = 1.0
    state: State = (list(x), tangents)
    for number in range(length.shape[1]):
        h = length[:, number]
        state = METHODS[method](field, to, state, time, h, stages(number))
        time = time + h
    return state


def condensed(slopes: Array, defects: Array) -> tuple[Array, Array]:
    """Carry derivatives and defects from sample to sample.

    Parameters
    ----------
    slopes : ndarray, shape (states, directions, samples - 1, segments)
        Of each one-sample map: by its start, then by the parameters.
    defects : ndarray, shape (states, samples - 1, segments)

    Returns
    -------
    spread : ndarray, shape (samples, segments, states, directions)
    shift : ndarray, shape (states, samples, segments)
    """
    n, count, steps, segments = slopes.shape
    by = np.ascontiguousarray(slopes.transpose(2, 3, 0, 1))
    left = defects.transpose(1, 2, 0)
    carried = np.zeros((steps + 1, segments, n, count + 1))
    carried[0, :, :, :n] = np.eye(n)
    for k in range(steps):
        np.matmul(by[k, :, :, :n], carried[k], out=carried[k + 1])
        carried[k + 1, :, :, n:count] += by[k, :, :, n:]
        carried[k + 1, :, :, count] += left[k]
    return carried[..., :count], carried[..., count].transpose(2, 0, 1)
