"""Steps of an ordinary differential equation with their sensitivities, all samples at once.

The steps between neighbouring samples start from known states, so none waits for another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxsr._deadline import ask
from jaxsr.models.corners import Corners
from jaxsr.models.directions import Directions, Stages, in_a_column
from jaxsr.models.field import Field, Point
from jaxsr.models.jumps import Jumps
from jaxsr.models.steps import METHODS
from jaxsr.models.switching import Crossings
from jaxsr.models.transitions import Taken, transition

Array = Any
LITTLE, LONG = 400, 64
"""Numbers carried from sample to sample below which a step costs its call, and samples from which
it is worth it to carry pieces of a segment side by side."""


def advanced(
    field: Field,
    to: Directions | None,
    method: str,
    x: Sequence[Array],
    time: Array,
    length: Array,
    stages: Callable[[int], Stages],
    jumps: Jumps | Crossings | Corners | None = None,
) -> tuple[list[Array], Array]:
    """Advance by all substeps between neighbouring samples.

    Parameters
    ----------
    to : Directions or None
        None: states alone, with derivatives in no direction.
    x : sequence of ndarray, shape (steps, segments)
        States at the earlier samples.
    time : ndarray
    length : ndarray, shape (steps, substeps, segments)
    stages : callable
        Number of a substep to its inputs.
    jumps : Jumps, Crossings or Corners, optional
        Of the states, where the model has events, of the rates, where it has switches, or
        rounded.

    Returns
    -------
    x : list of ndarray
        States at the later samples.
    slopes : ndarray, shape (states, directions, steps, segments)
    """
    states, taken, shape, begin = list(x), list[Taken](), np.shape(x[0]), time
    tableau, step = METHODS[method]
    jumping = np.zeros(shape, dtype=bool)
    for number in range(length.shape[1]):
        ask()
        h, own = length[:, number], stages(number)
        before = states
        states, rows = step(field, states, time, h, own, to is not None)
        taken.append(Taken(h, rows, own))
        if jumps is not None:
            here, there = Point(time, before, own.at(0.0)), Point(time + h, states, own.at(1.0))
            jumping |= jumps.crossed(field, here, there, h + np.zeros(shape)).any(axis=0)
        time = time + h
    if to is None:
        slopes = np.zeros((len(states), 0, *shape))
    else:
        slopes = transition(tableau, to, taken, shape)
    if jumps is None or not jumping.any():
        return states, slopes
    states = [np.array(state) for state in states]
    part = in_a_column(begin, length, stages, jumping)
    ends, by = jumps.through(
        field.column(jumping), to, method, [a[jumping][:, None] for a in x], *part
    )
    for state, end in zip(states, ends, strict=True):
        state[jumping] = end[:, 0]
    slopes[:, :, jumping] = by[..., 0]
    return states, slopes


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
    if steps >= LONG and segments * n * (count + 1) <= LITTLE:
        _in_pieces(by, left, carried)
        return carried[..., :count], carried[..., count].transpose(2, 0, 1)
    for k in range(steps):
        if k % LONG == 0:
            ask()
        np.matmul(by[k, :, :, :n], carried[k], out=carried[k + 1])
        carried[k + 1, :, :, n:count] += by[k, :, :, n:]
        carried[k + 1, :, :, count] += left[k]
    return carried[..., :count], carried[..., count].transpose(2, 0, 1)


def _in_pieces(by: Array, left: Array, carried: Array) -> None:
    """Carry along pieces of the segments side by side, then from piece to piece.

    The steps x -> A x + b of a piece make one such step: as many calls as twice the root of the
    number of samples, for twice the arithmetic.
    """
    steps, segments, n, count = by.shape
    length = max(int(np.sqrt(steps)), 1)
    pieces = -(-steps // length)
    own = np.zeros((pieces * length, segments, n, count + 1))
    own[:steps, ..., :count], own[:steps, ..., count] = by, left
    own = own.reshape(pieces, length, segments, n, count + 1)
    for k in range(1, length):
        moved = own[:, k, ..., :n] @ own[:, k - 1]
        moved[..., n:] += own[:, k, ..., n:]
        own[:, k] = moved
    start = np.empty((pieces, segments, n, count + 1))
    start[0] = carried[0]
    for p in range(pieces - 1):
        start[p + 1] = own[p, -1, ..., :n] @ start[p]
        start[p + 1, ..., n:] += own[p, -1, ..., n:]
    whole = own[..., :n] @ start[:, None]
    whole[..., n:] += own[..., n:]
    carried[1:] = whole.reshape(pieces * length, segments, n, count + 1)[:steps]
