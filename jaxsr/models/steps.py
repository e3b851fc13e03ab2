"""Runge-Kutta steps of a model's states, for many samples at once, with Jacobians by the way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxsr.models.directions import Stages
from jaxsr.models.field import Field, Point, Row
from jaxsr.models.transitions import Tableau

Array = Any
Stepped = tuple[list[Array], list[Sequence[Row]]]
"""States after a step, and the Jacobian of the rates at every stage."""

RK4 = Tableau(
    (0.0, 0.5, 0.5, 1.0),
    ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)),
    (1 / 6, 1 / 3, 1 / 3, 1 / 6),
)
_G = 0.43586652150845899942
SDIRK3 = Tableau(
    (_G, (1 + _G) / 2, 1.0),
    ((), ((1 - _G) / 2,), (-(6 * _G**2 - 16 * _G + 1) / 4, (6 * _G**2 - 20 * _G + 5) / 4)),
    (-(6 * _G**2 - 16 * _G + 1) / 4, (6 * _G**2 - 20 * _G + 5) / 4, _G),
    _G,
)
_NEWTON, _HARD = 4, 60
_SETTLED = 1e-9
"""Last step of a rate, in sizes of the rates, that ends the iteration."""


def _moved(start: Sequence[Array], *pairs: tuple[Any, Sequence[Array]]) -> list[Array]:
    result = list(start)
    for scale, other in pairs:
        result = [a + scale * b for a, b in zip(result, other, strict=True)]
    return result


def rk4(
    field: Field, x: list[Array], time: Array, h: Array, stages: Stages, slopes: bool
) -> Stepped:
    """Advance by the classical Runge-Kutta method of order four."""
    every: list[Sequence[Row]] = []

    def rates(share: float, own: list[Array]) -> list[Array]:
        here = Point(time + share * h, own, stages.at(share))
        if not slopes:
            return field.rates(here)
        k, rows = field.slopes(here)
        every.append(rows)
        return k

    k1 = rates(0.0, x)
    k2 = rates(0.5, _moved(x, (h / 2, k1)))
    k3 = rates(0.5, _moved(x, (h / 2, k2)))
    k4 = rates(1.0, _moved(x, (h, k3)))
    return _moved(x, (h / 6, k1), (h / 3, k2), (h / 3, k3), (h / 6, k4)), every


def sdirk3(
    field: Field, x: list[Array], time: Array, h: Array, stages: Stages, slopes: bool
) -> Stepped:
    """Advance by the L-stable singly diagonally implicit method of order three.

    References
    ----------
    Alexander, SIAM J. Numer. Anal. 14 (1977), Theorem 5.
    """
    del slopes  # Newton's method needs them anyway
    rates: list[list[Array]] = []
    every: list[Sequence[Row]] = []
    for weights, share in zip(SDIRK3.stages, SDIRK3.shares, strict=True):
        base = _moved(x, *((h * w, k) for w, k in zip(weights, rates, strict=True)))

        def at(k: list[Array], base: list[Array] = base, share: float = share) -> Point:
            return Point(time + share * h, _moved(base, (h * _G, k)), stages.at(share))

        k, rows = _stage(field, field.model.states, at, h, rates[-1] if rates else None)
        rates.append(k)
        every.append(rows)
    return _moved(x, *((h * w, k) for w, k in zip(SDIRK3.weights, rates, strict=True))), every


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
            reach = float(np.fmax.reduce(np.abs(own), axis=None, initial=0.0)) + 1e-300
            hard |= np.abs(s) > _SETTLED * reach
        if not hard.any():
            break
    return k, hard, rows


METHODS: dict[str, tuple[Tableau, Callable[..., Stepped]]] = {
    "rk4": (RK4, rk4),
    "rodas3": (SDIRK3, sdirk3),
}
"""By the names of `stepping.METHODS`: where that takes a stiff method, this takes its own."""
