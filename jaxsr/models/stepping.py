"""Fixed steps of ordinary differential equations, for many segments at once.

States come as a tuple of arrays, one array per state and one entry per segment, so that one
compiled scan advances all segments of all recordings together.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

Array = Any
Field = Callable[[Array, tuple[Array, ...], tuple[Array, ...]], tuple[Array, ...]]


class Step(NamedTuple):
    """One step: its start, its length, and the inputs at its start, middle and end."""

    time: Array
    length: Array
    u_start: tuple[Array, ...]
    u_middle: tuple[Array, ...]
    u_end: tuple[Array, ...]


def _axpy(x: tuple[Array, ...], *pairs: tuple[Any, tuple[Array, ...]]) -> tuple[Array, ...]:
    result = list(x)
    for scale, other in pairs:
        result = [a + scale * b for a, b in zip(result, other, strict=True)]
    return tuple(result)


def rk4(field: Field, x: tuple[Array, ...], step: Step) -> tuple[Array, ...]:
    """Advance by the classical Runge-Kutta method of order four."""
    t, h = step.time, step.length
    k1 = field(t, x, step.u_start)
    k2 = field(t + h / 2, _axpy(x, (h / 2, k1)), step.u_middle)
    k3 = field(t + h / 2, _axpy(x, (h / 2, k2)), step.u_middle)
    k4 = field(t + h, _axpy(x, (h, k3)), step.u_end)
    return _axpy(x, (h / 6, k1), (h / 3, k2), (h / 3, k3), (h / 6, k4))


_GAMMA = 0.5


def rodas3(field: Field, x: tuple[Array, ...], step: Step) -> tuple[Array, ...]:
    """Advance by the L-stable Rosenbrock method RODAS3 of order three.

    Stiff terms (steep friction near zero velocity) cost one small linear solve and no
    iteration.

    References
    ----------
    Sandu et al., "Benchmarking stiff ODE solvers for atmospheric chemistry problems II",
    Atmos. Environ. 31 (1997), Table 3. The stages are written for (1 - h*gamma*J) K = ...,
    so that a step of length zero changes nothing.
    """
    t, h = step.time, step.length
    count = len(x)
    f1, jacobian, ft = _slopes(field, x, step)
    matrix = [
        [float(i == j) - h * _GAMMA * jacobian[j][i] for j in range(count)] for i in range(count)
    ]
    solve = factorised(matrix)
    g, gh = _GAMMA, _GAMMA * h
    zero = tuple(0.0 * a for a in x)
    k1 = solve(_axpy(zero, (gh, f1), (g * 0.5 * h, ft)))
    k2 = solve(_axpy(zero, (gh, f1), (g * 4.0, k1), (g * 1.5 * h, ft)))
    f3 = field(t + h, _axpy(x, (2.0, k1)), step.u_end)
    k3 = solve(_axpy(zero, (gh, f3), (g, k1), (-g, k2)))
    f4 = field(t + h, _axpy(x, (2.0, k1), (1.0, k3)), step.u_end)
    k4 = solve(_axpy(zero, (gh, f4), (g, k1), (-g, k2), (-g * 8.0 / 3.0, k3)))
    return _axpy(x, (2.0, k1), (1.0, k3), (1.0, k4))


def _slopes(
    field: Field, x: tuple[Array, ...], step: Step
) -> tuple[tuple[Array, ...], list[tuple[Array, ...]], tuple[Array, ...]]:
    """Return f, its derivative by every state, and h times its derivative by time.

    All directions go through one vectorised pass, which keeps the compiled program small.
    """
    count = len(x)
    like = jnp.zeros_like(step.time + sum(x))
    time = jnp.concatenate([jnp.zeros((count, *like.shape)), (step.length + like)[None]])
    change = [b - a + like for a, b in zip(step.u_start, step.u_end, strict=True)]
    u = tuple(jnp.concatenate([jnp.zeros((count, *like.shape)), c[None]]) for c in change)
    unit = [jnp.zeros((count + 1, *like.shape)).at[i].set(1.0) for i in range(count)]
    start = tuple(a + like for a in x)
    inputs = tuple(a + like for a in step.u_start)

    def along(dt: Array, dx: tuple[Array, ...], du: tuple[Array, ...]) -> Any:
        point = (step.time + like, start, inputs)
        return jax.jvp(lambda s, y, w: field(s, y, w), point, (dt, dx, du))

    value, slopes = jax.vmap(along, out_axes=(None, 0))(time, tuple(unit), u)
    by_state = [tuple(a[j] for a in slopes) for j in range(count)]
    return value, by_state, tuple(a[count] for a in slopes)


def factorised(
    matrix: list[list[Array]],
) -> Callable[[tuple[Array, ...]], tuple[Array, ...]]:
    """Factorise a small matrix of arrays and return its solver.

    Elimination is written out and skips entries that are the number zero. A pivot that is the
    number zero gives way to the first row below that has another entry there: which entries are
    nothing is known before any array is, so that rows are not compared by size. The matrices met
    here are mass matrices, their rows in the order of `pivoted_rows`, and 1 - h*gamma*J, which
    is dominated by its diagonal. A singular matrix gives NaN.
    """
    count = len(matrix)
    lu = [list(row) for row in matrix]
    order = list(range(count))
    for k in range(count):
        chosen = next((i for i in range(k, count) if not nothing(lu[i][k])), None)
        if chosen is None:
            lu[k][k] = math.nan
            continue
        lu[k], lu[chosen] = lu[chosen], lu[k]
        order[k], order[chosen] = order[chosen], order[k]
        right = [j for j in range(k + 1, count) if not nothing(lu[k][j])]
        for i in range(k + 1, count):
            if nothing(lu[i][k]):
                continue
            if not _one(lu[k][k]):
                lu[i][k] = lu[i][k] / lu[k][k]
            for j in right:
                lu[i][j] = lu[i][j] - lu[i][k] * lu[k][j]
    lower = [[j for j in range(i) if not nothing(lu[i][j])] for i in range(count)]
    upper = [[j for j in range(i + 1, count) if not nothing(lu[i][j])] for i in range(count)]

    def solve(b: tuple[Array, ...]) -> tuple[Array, ...]:
        y = [b[i] for i in order]
        for i in range(count):
            for j in lower[i]:
                y[i] = y[i] - lu[i][j] * y[j]
        for i in reversed(range(count)):
            for j in upper[i]:
                y[i] = y[i] - lu[i][j] * y[j]
            if not _one(lu[i][i]):
                y[i] = y[i] / lu[i][i]
        return tuple(y)

    return solve


def nothing(entry: Array) -> bool:
    """Whether an entry is the number zero, known before any array is."""
    return isinstance(entry, float) and entry == 0.0


def _one(entry: Array) -> bool:
    return isinstance(entry, float) and entry == 1.0


METHODS = {"rk4": rk4, "rodas3": rodas3}
