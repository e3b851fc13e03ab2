"""Fixed steps of ordinary differential equations, for many segments at once.

States come as a tuple of arrays, one array per state and one entry per segment, so that one
compiled scan advances all segments of all recordings together.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax

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
    jacobian = [
        jax.jvp(
            lambda y: field(t, y, step.u_start),
            (x,),
            (tuple(jax.numpy.full_like(a, float(i == j)) for i, a in enumerate(x)),),
        )[1]
        for j in range(count)
    ]
    matrix = [
        [float(i == j) - h * _GAMMA * jacobian[j][i] for j in range(count)] for i in range(count)
    ]
    solve = factorised(matrix)
    slope_u = tuple(b - a for a, b in zip(step.u_start, step.u_end, strict=True))
    h_of = jax.numpy.broadcast_to(h, jax.numpy.shape(t))
    f1, ft = jax.jvp(lambda s, u: field(s, x, u), (t, step.u_start), (h_of, slope_u))
    g, gh = _GAMMA, _GAMMA * h
    zero = tuple(0.0 * a for a in x)
    k1 = solve(_axpy(zero, (gh, f1), (g * 0.5 * h, ft)))
    k2 = solve(_axpy(zero, (gh, f1), (g * 4.0, k1), (g * 1.5 * h, ft)))
    f3 = field(t + h, _axpy(x, (2.0, k1)), step.u_end)
    k3 = solve(_axpy(zero, (gh, f3), (g, k1), (-g, k2)))
    f4 = field(t + h, _axpy(x, (2.0, k1), (1.0, k3)), step.u_end)
    k4 = solve(_axpy(zero, (gh, f4), (g, k1), (-g, k2), (-g * 8.0 / 3.0, k3)))
    return _axpy(x, (2.0, k1), (1.0, k3), (1.0, k4))


def factorised(
    matrix: list[list[Array]],
) -> Callable[[tuple[Array, ...]], tuple[Array, ...]]:
    """Factorise a small matrix of arrays and return its solver.

    Elimination is written out and without pivoting: the matrices met here are mass matrices
    (positive definite) and 1 - h*gamma*J, dominated by its diagonal.
    """
    count = len(matrix)
    lu = [list(row) for row in matrix]
    for k in range(count):
        for i in range(k + 1, count):
            lu[i][k] = lu[i][k] / lu[k][k]
            for j in range(k + 1, count):
                lu[i][j] = lu[i][j] - lu[i][k] * lu[k][j]

    def solve(b: tuple[Array, ...]) -> tuple[Array, ...]:
        y = list(b)
        for i in range(count):
            for j in range(i):
                y[i] = y[i] - lu[i][j] * y[j]
        for i in reversed(range(count)):
            for j in range(i + 1, count):
                y[i] = y[i] - lu[i][j] * y[j]
            y[i] = y[i] / lu[i][i]
        return tuple(y)

    return solve


METHODS = {"rk4": rk4, "rodas3": rodas3}
