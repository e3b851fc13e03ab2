"""Derivatives of Runge-Kutta steps by their starts and parameters, from the end backwards.

Differentiating stage after stage carries every direction through every stage. Backwards only the
states are carried; a parameter is met once a stage, where its force acts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxsr._deadline import ask
from jaxsr.models.directions import Directions, Stages
from jaxsr.models.field import Row, implicit
from jaxsr.models.stepping import factorised

Array = Any
CARRIED, MOST = 150_000, 8192
"""Numbers carried by one stage together, few enough to stay in a processor's cache, and samples."""


@dataclass(frozen=True)
class Tableau:
    """Coefficients of a diagonally implicit Runge-Kutta method; gamma is 0 where it is explicit.

    Stage s has the rate k_s = f(t + c_s h, x + h sum_r a_sr k_r + h gamma k_s), and the step ends
    at x + h sum_s b_s k_s.

    Attributes
    ----------
    shares : tuple of float
        c_s.
    stages : tuple of tuple of float
        a_sr, r < s.
    weights : tuple of float
        b_s.
    gamma : float
    """

    shares: tuple[float, ...]
    stages: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]
    gamma: float = 0.0


@dataclass(frozen=True, eq=False)
class Taken:
    """A step that was taken.

    Attributes
    ----------
    length : ndarray, shape (steps, segments)
    rows : sequence of sequence of mapping
        Jacobian of the rates at every stage.
    stages : Stages
        Inputs along the step.
    """

    length: Array
    rows: Sequence[Sequence[Row]]
    stages: Stages

    def of(self, states: Sequence[int]) -> Taken:
        """Return the same for some of the states, on whose rates no other one's derivative acts."""
        return Taken(self.length, [[rows[i] for i in states] for rows in self.rows], self.stages)

    def part(self, chosen: slice, steps: int) -> Taken:
        """Return the same for some of the samples."""
        if chosen.start == 0 and chosen.stop >= steps:
            return self

        def cut(value: Array) -> Array:
            whole = np.ndim(value) == 2 and value.shape[0] == steps
            return value[chosen] if whole else value

        rows = [[{n: cut(v) for n, v in row.items()} for row in stage] for stage in self.rows]
        values = self.stages.values[:, :, chosen]
        rates = {i: rate[:, chosen] for i, rate in self.stages.rates.items()}
        return Taken(cut(self.length), rows, Stages(values, rates))


def transition(
    tableau: Tableau, to: Directions, taken: Sequence[Taken], shape: tuple[int, int]
) -> Array:
    r"""Derivatives of the state after several steps by the state before them and by parameters.

    With J_s and P_s the derivatives of the rate of stage s by states and by parameters, V_s the
    derivative of the end by k_s, and F that by the state after the step,

    .. math:: V_s = h b_s F + h \sum_{r > s} a_{rs} M_r, \quad
        W_s = V_s (1 - h \gamma J_s)^{-1}, \quad M_s = W_s J_s,

    the derivative by the state before the step is F + \sum_s M_s, and that by the parameters
    grows by \sum_s W_s P_s.

    Parameters
    ----------
    taken : sequence of Taken
        In the order of time.
    shape : tuple of int
        Steps side by side, and segments.

    Returns
    -------
    ndarray, shape (states, directions, *shape)
    """
    n, (steps, segments) = len(to.states), shape
    result = np.empty((n, to.count, *shape))
    points = min(max(CARRIED // n**2, 1), MOST)
    size = max(-(-steps // max(round(steps * segments / points), 1)), 1)
    for first in range(0, steps, size):
        ask()
        here = slice(first, min(first + size, steps))
        by = np.zeros((to.count, n, here.stop - first, segments))  # of the end, by direction
        for number, step in enumerate(reversed(taken)):
            _before(tableau, to, step.part(here, steps), by, last=number == 0)
        result[:, :, here] = by.swapaxes(0, 1)
    return result


def _before(tableau: Tableau, to: Directions, step: Taken, by: Array, last: bool) -> None:
    """Turn derivatives by the state after a step into those by the state before it."""
    n, h, count = len(to.states), step.length, len(tableau.weights)
    after = by[:n]
    moved: list[Array] = [None] * count  # M_s
    pull, share, spare = np.empty_like(after), np.empty_like(after), np.empty_like(by[0])
    for s in reversed(range(count)):
        weight = h * tableau.weights[s]
        if last:
            pull[...] = 0.0
            for i in range(n):
                pull[i, i] = weight
        else:
            np.multiply(weight, after, out=pull)
        for r in range(s + 1, count):
            if a := tableau.stages[r][s]:
                pull += np.multiply(h * a, moved[r], out=share)
        own = pull  # V_s, and W_s
        if tableau.gamma:
            matrix = implicit(step.rows[s], to.states, h * tableau.gamma)
            transposed = [list(column) for column in zip(*matrix, strict=True)]
            own = factorised(transposed)(tuple(pull))
        moved[s] = _by_states(to, own, step.rows[s], spare)
        for column, row in zip(own, step.rows[s], strict=True):
            for k, value in to.by_parameters(row, step.stages, tableau.shares[s]):
                by[k] += np.multiply(column, value, out=spare)
    if last:
        for i in range(n):
            after[i, i] = 1.0
    for part in moved:
        after += part


def _by_states(to: Directions, pull: Sequence[Array], rows: Sequence[Row], spare: Array) -> Array:
    """Return M = W J, an array a state."""
    result = np.empty((len(to.states), *spare.shape))
    met = [False] * len(to.states)
    for own, row in zip(pull, rows, strict=True):
        for j, value in to.by_states(row):
            if met[j]:
                result[j] += np.multiply(own, value, out=spare)
            else:
                np.multiply(own, value, out=result[j])
                met[j] = True
    for j in range(len(to.states)):
        if not met[j]:
            result[j] = 0.0
    return result
