"""Steps of an ordinary differential equation with their sensitivities, all samples at once.

The steps between neighbouring samples start from known states, so none waits for another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxsr._deadline import ask
from jaxsr._machine_code import compiled
from jaxsr.models.carrying import carry
from jaxsr.models.corners import Corners
from jaxsr.models.directions import Directions, Stages, in_a_column
from jaxsr.models.field import Field, Point
from jaxsr.models.following import followed
from jaxsr.models.jumps import Jumps
from jaxsr.models.parts import Part
from jaxsr.models.switching import Crossings

Array = Any
LONG = 512
"""Samples that derivatives are carried over between two looks at the clock."""


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
    shape, jumping, begin = np.shape(x[0]), np.zeros(np.shape(x[0]), dtype=bool), time
    parts = []
    for number in range(length.shape[1]):
        parts.append(Part(stages(number), begin, length[:, number]))
        begin = begin + length[:, number]
    along, slopes = followed(field, to, method, x, parts)
    for before, after, part in zip(along, along[1:], parts, strict=False):
        if jumps is not None:
            here = Point(part.begin, before, part.stages.at(0.0))
            there = Point(part.begin + part.length, after, part.stages.at(1.0))
            jumping |= jumps.crossed(field, here, there, part.length + np.zeros(shape)).any(axis=0)
    states = along[-1]
    if jumps is None or not jumping.any():
        return states, slopes
    states = [np.array(state) for state in states]
    column = in_a_column(time, length, stages, jumping)
    ends, by = jumps.through(
        field.column(jumping), to, method, [a[jumping][:, None] for a in x], *column
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
    left = np.ascontiguousarray(defects.transpose(1, 2, 0))  # one layout: compiled once
    carried = np.zeros((steps + 1, segments, n, count + 1))
    carried[0, :, :, :n] = np.eye(n)
    filled = compiled(carry) or _carry
    for first in range(0, steps, LONG):
        ask()
        here = slice(first, min(first + LONG, steps))
        filled(by[here], left[here], carried[here.start : here.stop + 1])
    return carried[..., :count], carried[..., count].transpose(2, 0, 1)


def _carry(by: Array, left: Array, carried: Array) -> None:
    """Do what `carry` does, a sample of all segments at once."""
    n, count = by.shape[2:]
    for k in range(len(by)):
        np.matmul(by[k, :, :, :n], carried[k], out=carried[k + 1])
        carried[k + 1, :, :, n:count] += by[k, :, :, n:]
        carried[k + 1, :, :, count] += left[k]
